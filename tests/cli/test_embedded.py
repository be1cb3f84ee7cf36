"""The monitor without ROS: what it shows, and which clock it uses for what."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from robot_health_monitor.cli.embedded import EmbeddedMonitor
from robot_health_monitor.core import Level, Transition
from robot_health_monitor.core.config.yaml_file import YamlFile, read_yaml
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.values.errors import ConfigError

pytest.importorskip("yaml")

START_S = 5000.0


def configuration(folder: Path, text: str) -> YamlFile:
    file = folder / "thresholds.yaml"
    file.write_text(text)
    return read_yaml(str(file))


class Clock:
    """Virtual time."""

    def __init__(self) -> None:
        self.now_s = START_S

    def __call__(self) -> float:
        return self.now_s

    def run_until(self, monitor: EmbeddedMonitor, end_s: float) -> None:
        """Steps from timer to timer."""
        due_s = monitor.bus.next_due_s()
        while due_s is not None and due_s <= end_s:
            self.now_s = due_s
            monitor.bus.run_due(due_s)
            due_s = monitor.bus.next_due_s()
        self.now_s = end_s
        monitor.bus.run_due(end_s)


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_durations_are_monotonic_and_stamps_are_wall_time(clock: Clock) -> None:
    wall_s = [1_000.0]
    monitor = EmbeddedMonitor(clock=clock, source="none", wall_time_s=lambda: wall_s[0])
    arrays: list[Any] = []
    monitor.bus.node("outside").subscribe("/diagnostics", "", lambda message, now_s: arrays.append((message, now_s)))
    clock.run_until(monitor, START_S + 1.0)
    wall_s[0] = 1_700_000_000.5  # NTP sets the clock
    arrays.clear()
    clock.run_until(monitor, START_S + 2.0)
    message, now_s = arrays[0]
    stamp = message["header"]["stamp"]
    assert (stamp["secs"], stamp["nsecs"]) == (1_700_000_000, 500_000_000)
    assert START_S <= now_s <= START_S + 2.0


def test_each_alert_reaches_the_outlet_once_and_is_not_logged_as_well(clock: Clock) -> None:
    events: list[Event] = []
    monitor = EmbeddedMonitor(clock=clock, source="none", outlet=events.append)
    outside = monitor.bus.node("outside")
    outside.advertise("battery_level", "std_msgs/Float32")
    outside.publish("battery_level", {"data": 15.0})
    transitions = [event for event in events if isinstance(event, Transition)]
    assert [(transition.signal, transition.to_level) for transition in transitions] == [("battery_level", Level.WARN)]
    assert not [line for line in monitor.bus.log_lines if "battery_level WARN: " in line.text]


def test_without_an_outlet_alerts_are_logged(clock: Clock) -> None:
    monitor = EmbeddedMonitor(clock=clock, source="none")
    outside = monitor.bus.node("outside")
    outside.advertise("battery_level", "std_msgs/Float32")
    outside.publish("battery_level", {"data": 15.0})
    assert len([line for line in monitor.bus.log_lines if "battery_level WARN: " in line.text]) == 1


def test_source_none_starts_no_battery_sensor(clock: Clock) -> None:
    names = {node.name for node in EmbeddedMonitor(clock=clock, source="none").bus.nodes}
    assert "/alert_system" in names and "/battery_sensor" not in names


def test_source_none_averages_only_inputs_that_are_configured(clock: Clock, tmp_path: Path) -> None:
    names = {node.name for node in EmbeddedMonitor(clock=clock, source="none").bus.nodes}
    assert "/aggregator" not in names
    nodes = "alert_system: {ros__parameters: {}}\naggregator: {ros__parameters: {inputs: [a]}}\n"
    file = configuration(tmp_path, nodes)
    names = {node.name for node in EmbeddedMonitor(file, clock=clock, source="none").bus.nodes}
    assert "/aggregator" in names


def test_a_message_between_two_timers_has_its_own_time(clock: Clock) -> None:
    monitor = EmbeddedMonitor(clock=clock, source="none")
    times: list[float] = []
    monitor.bus.node("inside").subscribe("topic", "std_msgs/Float32", lambda message, now_s: times.append(now_s))
    outside = monitor.bus.node("outside")
    outside.advertise("topic", "std_msgs/Float32")
    for clock.now_s in (START_S + 0.1, START_S + 0.2):
        outside.publish("topic", {"data": 1.0})
    assert times == [START_S + 0.1, START_S + 0.2]


def test_two_sections_for_one_node_are_refused(clock: Clock, tmp_path: Path) -> None:
    file = configuration(
        tmp_path,
        "alert_system: {ros__parameters: {signals: {cpu_usage: {}}}}\n"
        "aggregator: {ros__parameters: {}}\n"
        "robot2: {aggregator: {ros__parameters: {}}}\n",
    )
    with pytest.raises(ConfigError, match=r"thresholds.yaml:3: robot2.aggregator: expected one section for aggregator"):
        EmbeddedMonitor(clock=clock, file=file)
