"""`depends_on`: what follows from a known cause is judged and shown, but not announced."""

from __future__ import annotations

from typing import Any, Mapping

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.config.monitor_config import MonitorConfig
from robot_health_monitor.core.values.errors import ConfigError

MOTOR = {"error_above": 80.0, "stale_after_s": 0.0}
SPEED = {"warn_below": 0.1, "depends_on": ["motor"], "stale_after_s": 0.0, "for_s": 5.0}


def configured(**signals: Mapping[str, Any]) -> MonitorConfig:
    return load_config({"signals": signals})


class Robot:
    """A monitor with signals; times are in seconds."""

    def __init__(self, **signals: Mapping[str, Any]) -> None:
        self.monitor = Monitor(configured(**signals), "atlas")
        self.monitor.expect_sources()
        self.monitor.tick(0.0)

    def at(self, now_s: float, **values: float) -> list[str]:
        """Brings samples, then a tick; returns the lines."""
        changes = [each for name, value in values.items() for each in self.monitor.observe(Sample(name, value, now_s))]
        return list(map(str, [*changes, *self.monitor.tick(now_s)]))

    def shown(self, signal: str) -> str:
        status = self.monitor.report(0.0).statuses[signal]
        return f"{status.level.name} {status.cause} {status.affects or ''}".strip()


def healthy() -> Robot:
    robot = Robot(motor=MOTOR, speed=SPEED)
    robot.at(0.0, motor=50.0, speed=1.0)
    assert robot.at(20.0, motor=50.0, speed=1.0) == []
    return robot


def test_what_a_known_cause_brings_about_is_shown_but_not_announced() -> None:
    robot = healthy()
    assert robot.at(30.0, motor=90.0) == ["30.000 motor ERROR: 90 is above 80 (was OK for 30 s)"]
    assert robot.at(31.0, speed=0.0) == []
    assert robot.at(40.0) == []
    assert (robot.shown("speed"), robot.shown("motor")) == ("WARN motor", "ERROR  1")


def test_what_is_still_worse_when_it_has_settled_is_announced() -> None:
    robot = healthy()
    robot.at(30.0, motor=90.0)
    robot.at(31.0, speed=0.0)
    assert robot.at(70.0, motor=50.0) == ["70.000 motor OK: 50 is no longer above 80 (was ERROR for 40 s)"]
    assert robot.shown("speed") == "WARN"
    assert robot.at(74.9) == []
    assert robot.at(75.0) == ["75.000 speed WARN: 0 is below 0.1 (was caused by motor for 40 s)"]


def test_what_ended_with_its_cause_is_never_announced() -> None:
    robot = healthy()
    robot.at(30.0, motor=90.0)
    robot.at(31.0, speed=0.0)
    robot.at(40.0)
    robot.at(70.0, motor=50.0)
    assert robot.at(71.0, speed=1.0) == []
    assert robot.at(100.0, speed=1.0) == []
    robot.at(101.0, speed=0.0)
    assert robot.at(106.0) == ["106.000 speed WARN: 0 is below 0.1 (was OK for 106 s)"]


def test_what_gets_better_is_announced_in_spite_of_a_cause() -> None:
    robot = Robot(motor=MOTOR, speed={**SPEED, "for_s": 0.0})
    robot.at(0.0, motor=50.0, speed=1.0)
    robot.at(10.0, speed=0.0)
    robot.at(11.0, motor=90.0)
    assert robot.at(12.0, speed=1.0) == ["12.000 speed OK: 1 is no longer below 0.1 (was WARN for 2 s)"]
    assert robot.at(13.0, speed=0.0) == []


def test_of_one_tick_only_the_cause_is_announced() -> None:
    """The signal that depends on the other is configured first, and both become STALE at the same tick."""
    robot = Robot(speed={"topic": "/a", "depends_on": ["motor"]}, motor={"topic": "/b", "stale_after_s": 4.0})
    robot.at(0.0, motor=50.0, speed=1.0)
    assert [line.split()[1] for line in robot.at(6.0)] == ["/a"]


def test_a_cause_of_a_cause_is_a_cause_and_the_nearest_is_named() -> None:
    robot = Robot(power=MOTOR, motor={**MOTOR, "depends_on": ["power"]}, speed=SPEED)
    robot.at(0.0, power=1.0, motor=50.0, speed=1.0)
    robot.at(20.0, power=90.0)
    robot.at(21.0, speed=0.0)
    robot.at(30.0)
    assert (robot.shown("speed"), robot.shown("motor"), robot.shown("power")) == ("WARN power", "OK power", "ERROR  1")
    robot.at(31.0, motor=90.0)
    assert (robot.shown("speed"), robot.shown("motor"), robot.shown("power")) == (
        "WARN motor",
        "ERROR power 1",
        "ERROR  2",
    )


def test_a_waiting_cause_is_a_cause() -> None:
    robot = Robot(motor=MOTOR, speed={**SPEED, "for_s": 0.0})
    assert robot.at(1.0, speed=0.0) == []
    assert robot.shown("speed") == "WARN motor"
    assert robot.at(10.0, motor=50.0) == ["10.000 speed WARN: 0 is below 0.1 (was caused by motor for 10 s)"]


def test_the_topic_of_a_signal_is_a_cause_while_it_is_silent() -> None:
    robot = Robot(scan={"topic": "/scan"}, map_age={**SPEED, "depends_on": ["/scan"], "for_s": 0.0})
    robot.at(0.0, scan=1.0, map_age=1.0)
    assert robot.at(5.5) == ["5.500 scan STALE: no sample for 5.5 s (limit 5 s) (was OK for 5.5 s)"]
    assert robot.at(7.0, map_age=0.0) == []
    assert robot.shown("map_age") == "WARN /scan"


def test_the_link_is_a_cause_and_what_depends_on_it_settles() -> None:
    robot = Robot(speed={**SPEED, "depends_on": ["link"], "for_s": 7.0, "keep_firing_for_s": 0.0})
    robot.at(0.0, speed=1.0)
    robot.monitor.set_link(False, "refused", 10.0)
    robot.monitor.set_link(True, "", 12.0)
    robot.at(13.0, speed=0.0)
    assert robot.at(21.0) == []  # firing since 20 s, but the alert of the link is open until 22 s
    assert robot.at(22.0) == ["22.000 link OK: up (was ERROR for 12 s)"]
    assert robot.at(28.9) == []
    assert robot.at(29.0) == ["29.000 speed WARN: 0 is below 0.1 (was caused by link for 12 s)"]


def test_an_element_may_be_a_cause_and_have_one() -> None:
    drivers = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'}
    robot = Robot(drivers=drivers, speed={**SPEED, "depends_on": ["drivers[motor]"], "for_s": 0.0})
    assert robot.at(0.0, speed=1.0) == []
    from robot_health_monitor.core.values.elements import DriverStatus, Elements

    robot.monitor.observe(Sample("drivers", Elements([("motor", DriverStatus(2, "hot"))]), 1.0))
    assert robot.at(2.0, speed=0.0) == []
    assert robot.shown("speed") == "WARN drivers[motor]"


@pytest.mark.parametrize(
    ("signals", "problem"),
    [
        ({"a": {"depends_on": ["b"]}}, "expected names of other signals (link) or their topics, got 'b'"),
        ({"a": {"depends_on": ["a"]}}, "expected names of other signals (link) or their topics, got 'a'"),
        (
            {"a": {"topic": "/t", "depends_on": ["/t"]}},
            "expected names of other signals (link) or their topics, got '/t'",
        ),
        (
            {"a": {"depends_on": ["b"]}, "b": {"depends_on": ["a"]}},
            "no circle, but b and a depend on one another",
        ),
        (
            {"a": {"topic": "/t", "field": "x[*]", "depends_on": ["a[1]"]}},
            "names of other signals (link) or their topics, got 'a[1]'",
        ),
    ],
)
def test_unknown_names_and_circles_are_configuration_errors(signals: dict[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        configured(**signals)
    assert problem in "\n".join(str(each) for each in raised.value.all)


@pytest.mark.parametrize(
    ("text", "expected"), [("x" * 501, "printable text of at most 500 characters"), ("two\nlines", "printable text")]
)
def test_advice_is_one_line(text: str, expected: str) -> None:
    with pytest.raises(ConfigError, match=f"what_to_do: expected {expected}"):
        configured(a={"what_to_do": text})


def test_advice_is_in_the_status() -> None:
    robot = Robot(a={"what_to_do": "check the cable of the left wheel"})
    status = robot.monitor.report(0.0).statuses["a"]
    assert status.what_to_do == status.values["what_to_do"] == "check the cable of the left wheel"
    assert status.level is Level.STALE


def test_after_a_restart_within_settling_the_first_moment_with_a_cause_still_counts() -> None:
    robot = healthy()
    robot.at(30.0, motor=90.0)
    robot.at(31.0, speed=0.0)
    robot.at(60.0, motor=50.0)
    monitor = robot.monitor
    states = {name: monitor.snapshot(name, 62.0, 1e9) for name in monitor.saved_signals()}
    robot.monitor = Monitor(monitor.config, "atlas")
    robot.monitor.expect_sources()
    assert robot.monitor.restore(states, 100.0, 1e9) == []
    assert robot.at(101.0, motor=50.0, speed=0.0) == []
    assert robot.at(105.0) == []
    assert robot.at(106.0) == ["106.000 speed WARN: 0 is below 0.1 (was caused by motor for 33 s)"]
