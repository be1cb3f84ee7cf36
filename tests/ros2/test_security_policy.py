"""The policy of `robot-health export sros2` is what the graph of ROS 2 shows, node by node, and nothing else."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping, Set, Tuple

import pytest

from robot_health_monitor.__main__ import main

ROOT = Path(__file__).resolve().parents[2]
THRESHOLDS = str(ROOT / "config" / "thresholds.yaml")

Names = Mapping[Tuple[str, str], Set[str]]
AT_TIMES = ("/_executor_probe", "/get_type_description")
"""Allowed, and used at the start only, or if a parameter says so."""
GETTERS = {
    ("topic", "publish"): "get_publisher_names_and_types_by_node",
    ("topic", "subscribe"): "get_subscriber_names_and_types_by_node",
    ("service", "reply"): "get_service_names_and_types_by_node",
    ("service", "request"): "get_client_names_and_types_by_node",
}


@pytest.fixture
def policy(capsys: pytest.CaptureFixture[str]) -> Callable[..., dict[str, Names]]:
    """Returns what a policy allows, by the full name of the node, with names resolved as sros2 does."""

    def read(*arguments: str) -> dict[str, Names]:
        assert main(["export", "sros2", *arguments]) == 0
        found: dict[str, Names] = {}
        for profile in ElementTree.fromstring(capsys.readouterr().out).iter("profile"):
            prefix = profile.attrib["ns"].rstrip("/") + "/"
            node = prefix + profile.attrib["node"]
            allowed: dict[tuple[str, str], set[str]] = {key: set() for key in GETTERS}
            for section in profile:
                for verb in section.attrib:
                    names = {resolved(str(element.text), node, prefix) for element in section}
                    allowed[section.tag[:-1], verb] |= names
            found[node] = allowed
        return found

    return read


def resolved(name: str, node: str, prefix: str) -> str:
    """As sros2/policy/templates/dds/permissions.xsl."""
    if name.startswith("/"):
        return name
    return node + name[1:] if name.startswith("~") else prefix + name


@pytest.fixture
def observer(ros_environment: Mapping[str, str]) -> Iterator[Any]:
    """A node of a new participant: an older one may have kept a node, with this name, of a process that has ended."""
    from harness.ros2 import Participant

    participant = Participant(int(ros_environment["ROS_DOMAIN_ID"]))
    node = participant.node("observer")
    yield node
    node.destroy_node()
    participant.close()


def used(observer: Any, node: str) -> Names:
    """Returns what a node uses, as another participant sees it; nothing while it is unknown."""
    namespace, _, name = node.rpartition("/")
    found: dict[tuple[str, str], set[str]] = {}
    for key, getter in GETTERS.items():
        try:
            pairs = getattr(observer, getter)(name, namespace or "/")
        except RuntimeError:
            pairs = []
        found[key] = {each for each, _ in pairs}
    return found


def without(allowed: Mapping[str, Names], *names: str) -> dict[str, Names]:
    """Returns a policy without names that are used at times only."""
    return {
        node: {key: {each for each in found if not each.endswith(names)} for key, found in permissions.items()}
        for node, permissions in allowed.items()
    }


def wait_for(ros: Any, observer: Any, expected: Mapping[str, Names]) -> None:
    seen: list[dict[str, Names]] = []

    def is_equal() -> bool:
        seen[:] = [{node: used(observer, node) for node in expected}]
        return seen[0] == expected

    try:
        ros.wait_until(is_equal)
    except AssertionError:
        assert seen[0] == expected


def test_three_processes_in_a_namespace(ros: Any, observer: Any, start: Any, policy: Any) -> None:
    allowed = policy(THRESHOLDS, "--namespace", "robot1")
    assert sorted(allowed) == ["/robot1/aggregator", "/robot1/alert_system", "/robot1/battery_sensor"]
    for executable in ("alert_system", "aggregator", "battery_sensor"):
        start(executable, "--ros-args", "-r", "__ns:=/robot1", "--params-file", THRESHOLDS)
    wait_for(ros, observer, without(allowed, "/clock", *AT_TIMES))


def test_one_process_with_this_computer_a_remapping_and_simulated_time(
    ros: Any, observer: Any, start: Any, policy: Any
) -> None:
    allowed = policy(THRESHOLDS, "--sensors", "host", "--remap", "battery_level:=/bms/level")
    arguments = ["-p", "sensors:=host", "-p", "use_sim_time:=true", "-r", "battery_level:=/bms/level"]
    start("health_monitor", "--ros-args", "--params-file", THRESHOLDS, *arguments)
    assert "/bms/level" in allowed["/battery_sensor"]["topic", "publish"]
    wait_for(ros, observer, without(allowed, *AT_TIMES))


def test_the_probe_of_the_executor_is_allowed(policy: Any) -> None:
    """It lives for an instant: the policy is compared with the name in the code of the adapter."""
    from robot_health_monitor.ros2.process import _PROBE_TOPIC

    assert _PROBE_TOPIC.startswith("~/")
    for node, permissions in policy(THRESHOLDS).items():
        assert f"{node}{_PROBE_TOPIC[1:]}" in permissions["topic", "publish"] & permissions["topic", "subscribe"]


def test_a_server_and_a_black_box(ros: Any, observer: Any, start: Any, policy: Any, tmp_path: Path) -> None:
    ops = tmp_path / "ops.yaml"
    ops.write_text(
        f"black_box: {{folder: {tmp_path / 'boxes'}, topics: [/joint_states]}}\n"
        "server: {port: 0, allow_publish: ['/cmd_*'], allow_call: [/dock], allow_offer: [/assist]}\n"
    )
    allowed = policy(THRESHOLDS, "--sensors", "none", "--ops", str(ops))
    bridge = allowed.pop("/rosbridge")
    assert list(allowed) == ["/alert_system"]
    assert "/joint_states" in allowed["/alert_system"]["topic", "subscribe"]
    start("alert_system", "--ros-args", "--params-file", THRESHOLDS, "-p", f"ops:={ops}")
    ros.listen("/joint_states", "std_msgs/String")  # a black box subscribes once the type is known
    wait_for(ros, observer, without(allowed, "/clock", *AT_TIMES))
    patterns = {"/cmd_*", "/dock", "/assist", "/*"}
    assert patterns <= set().union(*bridge.values())
    ros.wait_until(lambda: used(observer, "/rosbridge")["topic", "publish"])
    for key, names in used(observer, "/rosbridge").items():
        assert all(any(fnmatchcase(name, pattern) for pattern in bridge[key]) for name in names), key
