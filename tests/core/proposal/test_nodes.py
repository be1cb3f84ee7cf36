"""The nodes that `init` proposes to watch, on the in-process middleware."""

from __future__ import annotations

from typing import Any, Sequence

import pytest
import yaml
from harness.whole_robot import send_frames, send_log

from robot_health_monitor.core.messages.definitions import parse_definition
from robot_health_monitor.core.messages.standard_messages import definition
from robot_health_monitor.core.nodes import AlertSystem, BatterySensor
from robot_health_monitor.core.port.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.port.middleware import NodeInfo
from robot_health_monitor.core.proposal.candidates import Candidates, Topic
from robot_health_monitor.core.proposal.nodes import Nodes
from robot_health_monitor.core.proposal.proposal import Proposed, propose
from robot_health_monitor.core.proposal.thresholds_file import thresholds_text
from robot_health_monitor.core.values.model import Transition


@pytest.fixture
def bus() -> LocalBus:
    bus = LocalBus(wall_time_s=lambda: 1.7e9 + bus.now_s)
    return bus


def driver(bus: LocalBus, name: str, *topics: str, statuses: Sequence[str] = ()) -> LocalMiddleware:
    """Starts a node that publishes each topic at 10 Hz, and its statuses at 1 Hz."""
    namespace, _, base = name.rpartition("/")
    node = bus.node(base, namespace=namespace)
    for topic in topics:
        node.advertise(topic, "std_msgs/String")
        node.create_timer(0.1, lambda now_s, topic=topic: node.publish(topic, {}))
    if statuses:
        status = [{"name": each, "level": 0, "message": "ok"} for each in statuses]
        node.advertise("/diagnostics", "diagnostic_msgs/DiagnosticArray")
        node.create_timer(1.0, lambda now_s: node.publish("/diagnostics", {"status": status}))
    return node


def listened(bus: LocalBus, namespace: str = "", lasts_s: float = 60.0) -> Proposed:
    """Returns what is proposed after listening."""
    candidates, nodes, listener = Candidates(namespace), Nodes(), bus.node("listener")
    nodes.begin(listener)
    end_s = bus.now_s + lasts_s
    while bus.now_s < end_s:
        graph = bus.graph()
        new = {topic: kind for topic, kind in graph.topics.items() if topic not in candidates.topics}
        candidates.add(Topic(name, kind, parse_definition(kind, definition(kind), "msg")) for name, kind in new.items())
        candidates.listen(listener, new)
        nodes.take({name: info for name, info in graph.nodes.items() if name != "/listener"})
        bus.run_until(bus.now_s + 2.0)
    listener.close()
    proposed = propose(candidates)
    nodes.add_to(proposed, candidates)
    return proposed


def settings(proposed: Proposed) -> dict[str, dict[str, Any]]:
    return {signal.name: signal.settings for signal in proposed.signals}


def watched(bus: LocalBus, proposed: Proposed) -> list[str]:
    """Starts the monitor with what is proposed; returns the lines of its alerts."""
    lines: list[str] = []
    tree = yaml.safe_load(thresholds_text([], {}, proposed))["alert_system"]["ros__parameters"]

    def hear(event: Any) -> None:
        assert isinstance(event, Transition), event
        lines.append(event.text)

    AlertSystem(bus.node("alert_system", parameters=tree), {"test": hear}, log_alerts=False)
    return lines


def test_a_node_that_publishes_what_is_watched_is_watched(bus: LocalBus) -> None:
    driver(bus, "laser", "scan", "intensities")
    driver(bus, "idle")
    proposed = listened(bus)
    assert settings(proposed)["laser_node"] == {"node": "laser", "for_s": 3.0, "depends_on": ["/intensities", "/scan"]}
    assert "idle_node" not in settings(proposed)
    assert proposed.not_watched == {"nodes": "/idle publish nothing that is watched"}


@pytest.mark.newest_python
def test_a_node_that_dies_is_one_alert_the_silence_of_its_topics(bus: LocalBus) -> None:
    laser = driver(bus, "laser", "scan", "intensities")
    lines = watched(bus, listened(bus))
    bus.run_until(bus.now_s + 600.0)
    assert lines == []
    laser.close()
    bus.run_until(bus.now_s + 60.0)
    assert len(lines) == 1, lines
    assert lines[0].startswith("/intensities STALE: no message for 2 s (limit 1 s), nor on 1 other topic: /scan")


def test_a_node_that_serves_an_action_depends_on_its_other_topics(bus: LocalBus) -> None:
    """The states of goals are published when they change: they are never silent."""
    dock = driver(bus, "dock", "scan")
    dock.advertise("/dock/status", "actionlib_msgs/GoalStatusArray")
    proposed = listened(bus)
    assert settings(proposed)["dock_node"] == {"node": "dock", "for_s": 3.0, "depends_on": ["/scan"]}
    assert [signal.note for signal in proposed.signals if signal.name == "dock_node"] == [
        "publishes /dock/status, /scan"
    ]


def test_a_node_that_dies_beside_another_one_of_its_topic_is_an_alert(bus: LocalBus) -> None:
    left = driver(bus, "left", "odom")
    driver(bus, "right", "odom")
    proposed = listened(bus)
    assert settings(proposed)["left_node"] == {"node": "left"}
    lines = watched(bus, proposed)
    bus.run_until(bus.now_s + 20.0)
    left.close()
    bus.run_until(bus.now_s + 4.0)
    assert [line.partition(" (")[0] for line in lines] == ["left_node ERROR: node /left is not there"]


@pytest.mark.parametrize(
    "name",
    [
        "rosbag2_player",
        "play_1700000000123456789",
        "talker_12345_1700000000123",
        "_ros2cli_77",
        "rqt_gui_py_node_9",
        "rviz",
    ],
)
def test_tools_and_anonymous_nodes_are_listed_and_not_watched(bus: LocalBus, name: str) -> None:
    driver(bus, name, "scan")
    proposed = listened(bus)
    assert list(settings(proposed)) == ["scan_rate"]
    reason = "a tool, or an anonymous node: these come and go"
    assert proposed.not_watched == {f"node /{name}": reason}


def test_a_node_that_comes_and_goes_is_not_watched(bus: LocalBus) -> None:
    driver(bus, "laser", "scan")
    guest = bus.node("guest")
    guest.advertise("scan", "std_msgs/String")
    bus.node("robot").create_timer(30.0, lambda now_s: guest.close())
    proposed = listened(bus)
    assert "laser_node" in settings(proposed)
    assert proposed.not_watched["node /guest"] == "not there all the time"


def test_the_nodes_of_this_package_are_not_watched(bus: LocalBus) -> None:
    driver(bus, "laser", "scan", statuses=["laser: scan"])
    BatterySensor(bus.node("battery_sensor", parameters={"sensors": "simulated"}))
    AlertSystem(bus.node("alert_system"), {})
    proposed = listened(bus)
    assert {name for name in settings(proposed) if name.endswith("_node")} == {"laser_node"}
    own = {topic for topic, reason in proposed.not_watched.items() if reason == "published by this monitor"}
    assert own == {"/alerts", "/battery_level", "/cpu_usage", "/temperature", "/_simulated_sensors"}


def test_what_a_driver_publishes_depends_on_its_own_status(bus: LocalBus) -> None:
    driver(bus, "laser", "scan", statuses=["laser: scan"])
    driver(bus, "base/motors", "odom", statuses=["motors: left", "motors: right"])
    driver(bus, "camera", "image")
    proposed = listened(bus)
    assert settings(proposed)["scan_rate"]["depends_on"] == ["diagnostics[laser: scan]"]
    assert "depends_on" not in settings(proposed)["image_rate"]
    text = thresholds_text([], {}, proposed)
    guess = "# depends_on: ['diagnostics[motors: left]', 'diagnostics[motors: right]'] "
    assert f"        {guess}# a guess: its driver's own statuses\n" in text
    watched(bus, proposed)  # names that do not exist would be errors


def test_of_two_nodes_with_the_name_in_a_status_none_is_certain(bus: LocalBus) -> None:
    driver(bus, "left/laser", "left", statuses=["laser: scan"])
    driver(bus, "right/laser", "right")
    assert not [each for each in settings(listened(bus)).values() if "diagnostics[laser: scan]" in str(each)]


def test_in_a_namespace_names_are_relative(bus: LocalBus) -> None:
    driver(bus, "robot1/laser", "scan")
    found = settings(listened(bus, "robot1"))
    assert found["laser_node"] == {"node": "laser", "for_s": 3.0, "depends_on": ["/scan"]}


def lifecycle_node(bus: LocalBus, name: str) -> dict[str, int]:
    state = {"id": 3}
    bus.node(name).advertise_service(
        f"/{name}/get_state", "lifecycle_msgs/GetState", lambda request: {"current_state": dict(state)}
    )
    return state


def test_a_lifecycle_node_that_is_active_is_watched(bus: LocalBus) -> None:
    driver(bus, "laser", "scan")
    state = lifecycle_node(bus, "planner")
    lifecycle_node(bus, "docking")["id"] = 2
    proposed = listened(bus)
    assert settings(proposed)["planner_lifecycle"] == {"lifecycle": "planner"}
    assert "docking_lifecycle" not in settings(proposed)
    assert proposed.not_watched["nodes"] == "/docking publish nothing that is watched"
    lines = watched(bus, proposed)
    bus.run_until(bus.now_s + 600.0)
    assert lines == []
    state["id"] = 2
    bus.run_until(bus.now_s + 2.0)
    assert [line.partition(" (")[0] for line in lines] == [
        "planner_lifecycle ERROR: /planner is inactive, expected active"
    ]


def test_where_the_graph_is_not_known_the_file_says_so(bus: LocalBus) -> None:
    from robot_health_monitor.core.port.mapping_node import MappingNode

    class Blind:
        graph_name, knows_graph = MappingNode.graph_name, MappingNode.knows_graph

    nodes = Nodes()
    nodes.begin(Blind())  # type: ignore[arg-type]
    nodes.take({"/laser": NodeInfo(["/scan"], [], [])})
    driver(bus, "laser", "scan")
    proposed = listened(bus)
    proposed.signals = [each for each in proposed.signals if "node" not in each.given]
    nodes.add_to(proposed, Candidates())
    assert proposed.not_watched["nodes"] == "the robot's graph is not known here"


@pytest.mark.newest_python
def test_a_frame_that_stops_while_others_go_on_is_an_alert(bus: LocalBus) -> None:
    node, stopped = bus.node("localization"), set()
    send_frames(node, {"odom": 0.02, "base_link": -0.5, "late": 7200.0}, stopped)
    proposed = listened(bus)
    found = settings(proposed)
    assert found["tf_odom"] == {
        "topic": "tf", "type": "tf2_msgs/TFMessage", "field": 'transforms["odom"].header.stamp', "unit": "s",
        "warn_above": 1.0, "for_s": 3.0, "stale_after_s": 1.0,
    }  # fmt: skip
    for frame in ("base_link", "late"):  # stamps that are no delays: only their silence is watched
        assert not {"warn_above", "for_s"} & set(found[f"tf_{frame}"])
        assert found[f"tf_{frame}"]["stale_after_s"] == 1.0
    lines = watched(bus, proposed)
    bus.run_until(bus.now_s + 600.0)
    assert lines == []
    stopped.add("odom")
    bus.run_until(bus.now_s + 5.0)
    assert [line.partition(" (")[0] for line in lines] == ["tf_odom STALE: no sample for 2 s"]


def test_static_frames_are_not_watched(bus: LocalBus) -> None:
    node = bus.node("state_publisher")
    node.advertise("/tf_static", "tf2_msgs/TFMessage", latched=True)
    driver(bus, "laser", "scan")
    proposed = listened(bus)
    assert not [name for name in settings(proposed) if name.startswith("tf_")]
    assert proposed.not_watched["/tf_static"] == "no message"


def test_frames_with_names_that_look_the_same_have_names_of_their_own(bus: LocalBus) -> None:
    send_frames(bus.node("localization"), {"base link": 0.0, "base_link": 0.0}, set())
    fields = {name: each["field"] for name, each in settings(listened(bus)).items() if "field" in each}
    assert (fields["tf_base_link"], fields["tf_base_link_2"]) == (
        'transforms["base link"].header.stamp', 'transforms["base_link"].header.stamp'
    )  # fmt: skip


def errors_of(proposed: Proposed) -> dict[str, Any]:
    return settings(proposed).get("rosout_errors", {})


@pytest.mark.newest_python
def test_errors_in_the_log_are_counted_with_a_bound_above_what_was_seen(bus: LocalBus) -> None:
    """An error each 5 s: 12 in a minute."""
    driver(bus, "laser", "scan")
    send_log(bus.node("base"), 5.0)
    proposed = listened(bus)
    expected = {
        "topic": "rosout", "type": "rosgraph_msgs/Log", "field": "", "statistic": "count", "window_s": 60.0,
        "where": 'level >= ERROR and name != "*alert_system"', "warn_above": 36.0,
    }  # fmt: skip
    assert errors_of(proposed) == expected
    lines = watched(bus, proposed)
    bus.run_until(bus.now_s + 600.0)
    assert lines == []
    send_log(bus.node("broken"), 1.0)
    bus.run_until(bus.now_s + 60.0)
    assert [line.partition(" (")[0] for line in lines] == ["rosout_errors WARN: 37 in 60 s is above 36"]


def test_a_log_without_errors_has_a_bound_of_5(bus: LocalBus) -> None:
    driver(bus, "laser", "scan")
    send_log(bus.node("base"), 1e6)
    proposed = listened(bus)
    assert errors_of(proposed)["warn_above"] == 5.0
    assert "base_node" not in settings(proposed)  # every node publishes the log


def test_of_a_short_time_the_bound_is_that_of_a_minute(bus: LocalBus) -> None:
    """An error each 2 s: 30 in a minute, and three times that."""
    driver(bus, "laser", "scan")
    send_log(bus.node("base"), 2.0)
    assert 80.0 <= errors_of(listened(bus, lasts_s=20.0))["warn_above"] <= 100.0


def test_a_log_that_only_this_monitor_writes_is_not_watched(bus: LocalBus) -> None:
    driver(bus, "laser", "scan", statuses=["laser: scan"])
    system = bus.node("alert_system")
    AlertSystem(system, {})
    send_log(system)
    proposed = listened(bus)
    assert errors_of(proposed) == {}
    assert proposed.not_watched["/rosout"] == "published by this monitor"


def test_a_log_alone_is_nothing_to_watch(bus: LocalBus) -> None:
    send_log(bus.node("base"))
    assert listened(bus).signals == []
