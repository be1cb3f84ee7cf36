"""The parameters of a node on the parameter server of a real master."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.faults import Faults

NODE = "/alert_system"
BOUND = f"{NODE}/ros__parameters/signals/fan/warn_below"


class Node:
    """The parameters of a node, as its process uses them."""

    def __init__(self, master: Any) -> None:
        from robot_health_monitor.ros1.master import Master
        from robot_health_monitor.ros1.parameters import NodeParameters

        self.server = Master("/tests")
        self.parameters = NodeParameters(self.server, NODE)
        self.faults = Faults()
        self.log_lines: list[tuple[Severity, str]] = []

    def start(self) -> None:
        self.parameters.given()
        self.parameters.keep()

    def reload(self) -> dict[str, Any]:
        return dict(
            self.parameters.reload(accept_numbers, self.faults, lambda *line: self.log_lines.append(line))  # type: ignore[arg-type]
        )


def accept_numbers(tree: Any) -> str:
    signals = tree["signals"]
    bound = signals["fan"]["warn_below"] if isinstance(signals, dict) else None
    if not isinstance(bound, (int, float)):
        raise ConfigError(f"expected a number, got {bound!r}", ("signals", "fan", "warn_below"))
    return f"warn_below: {bound}"


@pytest.fixture
def node(master: Any, parameters: Any, monkeypatch: pytest.MonkeyPatch) -> Node:
    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    parameters(BOUND, 900)
    return Node(master)


def test_arguments_of_the_launch_file_go_over_the_file(node: Node, parameters: Any) -> None:
    parameters(f"{NODE}/ros__parameters/log_level", "DEBUG")
    parameters(f"{NODE}/log_level", "WARN")
    parameters(f"{NODE}/publish_rate", 5.0)
    assert node.parameters.given() == {
        "log_level": "WARN",
        "publish_rate": 5.0,
        "signals": {"fan": {"warn_below": 900}},
    }


def test_a_parameter_in_both_places_is_an_error_that_names_both(node: Node, parameters: Any) -> None:
    node.start()
    parameters(f"{NODE}/signals/fan/warn_below", 800)
    response = node.reload()
    assert response == {
        "success": False,
        "message": "signals.fan.warn_below: is set twice: /alert_system/signals/fan/warn_below and "
        "/alert_system/ros__parameters/signals/fan/warn_below; delete one of them",
    }
    parameters(BOUND, 700)  # the refusal has removed the other one
    assert node.reload() == {"success": True, "message": "warn_below: 700"}


def test_every_parameter_in_both_places_is_named(node: Node, parameters: Any) -> None:
    parameters(f"{NODE}/signals/fan", {"warn_below": 1, "unit": "rpm"})
    parameters(f"{NODE}/ros__parameters/signals/fan/unit", "rpm")
    with pytest.raises(ConfigError) as refused:
        node.parameters.given()
    assert {error.path for error in refused.value.all} == {("signals", "fan", "unit"), ("signals", "fan", "warn_below")}


def test_an_accepted_change_is_one_info_line(node: Node, parameters: Any) -> None:
    node.start()
    parameters(BOUND, 800)
    assert node.reload() == {"success": True, "message": "warn_below: 800"}
    assert node.log_lines == [(Severity.INFO, "parameters changed: warn_below: 800")]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (BOUND, "low"),
        (f"{NODE}/ros__parameters/signals/fan", {"warn_below": "low", "unit": "rpm"}),
        (f"{NODE}/ros__parameters/signals/fan", {"warn_below": {"a": 1}}),
        (f"{NODE}/ros__parameters/signals", {"fan": {"warn_below": "low"}, "pump": {"warn_above": 1.0}}),
        (f"{NODE}/ros__parameters/signals", 7),
        (f"{NODE}/ros__parameters", "text"),
        (NODE, 7),
    ],
)
def test_a_refusal_writes_the_old_values_back(node: Node, parameters: Any, name: str, value: object) -> None:
    parameters(f"{NODE}/log_level", "INFO")
    node.start()
    before = node.server.parameter(NODE, None)
    parameters(name, value)
    assert node.reload()["success"] is False
    assert node.server.parameter(NODE, None) == before
    (text,) = [text for severity, text in node.log_lines if severity == Severity.WARN]
    assert text.startswith("the old parameters stay in force: ")
    assert node.reload() == {"success": True, "message": "warn_below: 900"}
    assert node.faults.current() == {}


def test_what_was_deleted_comes_back_with_a_refusal(node: Node, parameters: Any) -> None:
    parameters(f"{NODE}/ros__parameters/signals/fan/unit", "rpm")
    node.start()
    node.server._call("deleteParam", f"{NODE}/ros__parameters/signals/fan/unit")
    parameters(BOUND, "low")
    assert node.reload()["success"] is False
    assert node.server.parameter(f"{NODE}/ros__parameters", {}) == {
        "signals": {"fan": {"warn_below": 900, "unit": "rpm"}}
    }


def test_a_node_that_is_started_again_can_go_back_to_the_last_good_parameters(
    node: Node, parameters: Any, master: Any
) -> None:
    node.start()
    parameters(BOUND, 800)
    assert node.reload()["success"] is True
    parameters(BOUND, "low")  # and no reload before the node is killed
    again = Node(master)
    assert again.parameters.given() == {"signals": {"fan": {"warn_below": "low"}}}
    assert again.parameters.put_back() is True
    assert again.parameters.read() == {"signals": {"fan": {"warn_below": 800}}}
    assert again.parameters.put_back() is False  # these are the last good ones


def test_a_reload_that_comes_while_the_node_starts_is_put_back_and_not_kept(node: Node, parameters: Any) -> None:
    node.parameters.given()
    parameters(BOUND, "low")
    assert node.reload()["success"] is False
    assert node.server.parameter(BOUND, None) == 900
    node.parameters.keep()
    in_force = {"ros__parameters": {"signals": {"fan": {"warn_below": 900}}}}
    assert node.server.parameter(f"{NODE}/last_accepted", None) == in_force


def test_a_node_that_went_back_keeps_what_it_went_back_to(node: Node, parameters: Any, master: Any) -> None:
    node.start()
    parameters(BOUND, "low")
    again = Node(master)
    again.parameters.given()
    assert again.parameters.put_back() is True
    again.parameters.keep()
    in_force = {"ros__parameters": {"signals": {"fan": {"warn_below": 900}}}}
    assert again.server.parameter(f"{NODE}/last_accepted", None) == in_force


def test_a_first_start_has_nothing_to_go_back_to(node: Node) -> None:
    node.parameters.given()
    assert node.parameters.put_back() is False


def test_a_node_that_reads_no_parameters_keeps_none(node: Node) -> None:
    node.parameters.keep()
    assert node.server.parameter(f"{NODE}/last_accepted", None) is None


def test_a_master_that_is_gone_refuses_nothing_and_changes_nothing(
    node: Node, free_port: int, start_master: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    master = start_master(free_port)
    monkeypatch.setenv("ROS_MASTER_URI", master.uri)
    lost = Node(master)
    lost.parameters.given()
    master.end()
    response = lost.reload()
    assert response["success"] is False and "does not answer" in response["message"]
