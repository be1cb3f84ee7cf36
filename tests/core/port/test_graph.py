"""Signals of the robot's graph on the in-process bus; the lines are those of docs/rules.md."""

from __future__ import annotations

from typing import Any

import pytest

from robot_health_monitor.core.config.monitor_config import load_config
from robot_health_monitor.core.judge.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.model import Sample, Transition

FLOAT32 = "std_msgs/Float32"


class Robot:
    """A bus with an alert_system that watches `signals`; `lines` are its alerts."""

    def __init__(self, signals: dict[str, Any]) -> None:
        self.bus = LocalBus(0.0)
        self.lines: list[str] = []
        node = self.bus.node("alert_system", parameters={"signals": signals})
        self.system = AlertSystem(node, {"test": self._note}, log_alerts=False)

    def _note(self, event: Any) -> None:
        if isinstance(event, Transition):
            self.lines.append(event.text)


def test_the_lines_of_nodes() -> None:
    robot = Robot(
        {
            "lidar": {"node": "lidar"},
            "one": {"node": "/lidar", "error_above": 1},
            "two": {"node": "/lidar*", "error_below": 2},
        }
    )
    first = robot.bus.node("lidar")
    robot.bus.run_until(2.0)
    assert robot.lines == ["two ERROR: 1 node matches /lidar*, below 2 (was unknown for 0 s)"]
    second = robot.bus.node("lidar")
    robot.bus.run_until(3.0)
    assert robot.lines[1:] == [
        "one ERROR: 2 nodes are named /lidar, above 1 (was OK for 2 s)",
        "two OK: 2 nodes match /lidar* (was ERROR for 2 s)",
    ]
    first.close()
    second.close()
    robot.bus.run_until(4.0)
    assert "lidar ERROR: node /lidar is not there (was OK for 3 s)" in robot.lines
    robot.bus.node("lidar")
    robot.bus.run_until(5.0)
    assert "lidar OK: node /lidar is there (was ERROR for 1 s)" in robot.lines


def test_the_lines_of_endpoints_without_those_of_the_monitor() -> None:
    robot = Robot({"scan_out": {"publishers": "/scan"}, "few": {"publishers": "/scan", "warn_above": 1}})
    robot.system._middleware.advertise("/scan", FLOAT32)
    driver, other = robot.bus.node("driver"), robot.bus.node("other")
    driver.advertise("/scan", FLOAT32)
    other.advertise("/scan", FLOAT32)
    robot.bus.run_until(1.0)
    assert robot.lines == ["few WARN: 2 publishers on /scan, above 1 (was unknown for 0 s)"]
    driver.close()
    other.close()
    robot.bus.run_until(2.0)
    assert "scan_out ERROR: no publisher on /scan (was OK for 1 s)" in robot.lines


def test_the_lines_of_a_lifecycle_node() -> None:
    robot = Robot({"nav": {"lifecycle": "/controller_server"}})
    state = 2
    node = robot.bus.node("controller_server")
    node.advertise_service("~get_state", "lifecycle_msgs/GetState", lambda _: {"current_state": {"id": state}})
    robot.bus.run_until(1.0)
    state = 3
    robot.bus.run_until(2.0)
    node.close()
    robot.bus.run_until(3.0)
    assert robot.lines == [
        "nav ERROR: /controller_server is inactive, expected active (was unknown for 0 s)",
        "nav OK: /controller_server is active (was ERROR for 1 s)",
        "nav ERROR: /controller_server is not there (was OK for 1 s)",
    ]


def test_a_node_without_get_state_is_not_known() -> None:
    robot = Robot({"nav": {"lifecycle": "/driver"}})
    robot.bus.node("driver")
    robot.bus.run_until(11.0)
    assert robot.lines == []
    robot.bus.run_until(12.0)
    assert robot.lines == ["nav STALE: no sample since the start 11 s ago (limit 10 s) (was unknown for 11 s)"]


def test_nothing_at_the_start_is_not_known_until_the_startup_grace_has_passed() -> None:
    monitor = Monitor(load_config({"signals": {"lidar": {"node": "/lidar"}}}))
    for now_s in range(10):
        assert not monitor.observe(Sample("lidar", 0.0, float(now_s)))
        assert not monitor.tick(float(now_s))
    assert monitor.levels()["lidar"][1] == "waiting"
    (transition,) = monitor.tick(10.0)
    assert transition.text == "lidar ERROR: node /lidar is not there (was unknown for 10 s)"


def test_a_live_change_is_followed() -> None:
    robot = Robot({"lidar": {"node": "/lidar"}})
    robot.bus.node("camera")
    robot.system._middleware.set_parameters({"signals": {"camera": {"node": "/camera"}}})  # type: ignore[attr-defined]
    robot.bus.run_until(2.0)
    assert robot.system.monitor.report(2.0).statuses["camera"].message == "node /camera is there"
    robot.system._middleware.set_parameters({"signals": {"x": {"topic": "/x"}}})  # type: ignore[attr-defined]
    assert robot.system.watched._graph_timer is None


@pytest.mark.parametrize(
    ("signal", "key"),
    [
        ({"node": "/a", "topic": "/a"}, "node"),
        ({"node": "/a", "publishers": "/a"}, "publishers"),
        ({"node": "/a", "field": "value"}, "field"),
        ({"lifecycle": "/a", "error_below": 3}, "error_below"),
        ({"lifecycle": "/a*"}, "lifecycle"),
        ({"action": "/a?"}, "action"),
        ({"node": ""}, "node"),
        ({"publishers": "/a b"}, "publishers"),
        ({"subscribers": "/é"}, "subscribers"),
    ],
)
def test_what_contradicts_is_a_configuration_error(signal: dict[str, Any], key: str) -> None:
    with pytest.raises(ConfigError, match=f"signals.a.{key}: "):
        load_config({"signals": {"a": signal}})


def test_a_value_that_is_no_number_is_a_bad_sample_of_a_count() -> None:
    """Arrays have no truth value."""
    numpy = pytest.importorskip("numpy")
    monitor = Monitor(load_config({"signals": {"a": {"node": "/a"}}}))
    for value in (numpy.array([1.0, 2.0]), "0", None):
        monitor.observe(Sample("a", value, 0.0))
    assert monitor.status("a", 0.0).level.name == "ERROR"  # three bad samples, docs/rules.md
