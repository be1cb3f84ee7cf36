"""The monitor without ROS: what it shows, and which clock it uses for what."""

from __future__ import annotations

from pathlib import Path
from typing import Any, List

import pytest

from robot_health_monitor.core import Level, Transition
from robot_health_monitor.core.outlets import Event
from robot_health_monitor.core.yaml_file import YamlFile, read_yaml
from robot_health_monitor.embedded import EmbeddedMonitor

pytest.importorskip("yaml")

START_S = 5000.0


def configuration(folder: Path, text: str) -> YamlFile:
    file = folder / "thresholds.yaml"
    file.write_text(text)
    return read_yaml(str(file))


def start(**options: Any) -> EmbeddedMonitor:
    return EmbeddedMonitor(clock=lambda: START_S, **options)


def run_until(monitor: EmbeddedMonitor, end_s: float) -> None:
    """Steps virtual time from timer to timer."""
    due_s = monitor.bus.next_due_s()
    while due_s is not None and due_s <= end_s:
        monitor.bus.run_due(due_s)
        due_s = monitor.bus.next_due_s()
    monitor.bus.run_due(end_s)


def test_a_system_health_that_is_published_every_ten_seconds_is_shown_all_the_time(tmp_path: Path) -> None:
    file = configuration(
        tmp_path,
        "alert_system: {ros__parameters: {signals: {cpu_usage: {}}}}\n"
        "aggregator: {ros__parameters: {publish_rate: 0.1}}\n",
    )
    monitor = start(file=file)
    assert monitor.system_health is None
    run_until(monitor, START_S + 11.0)
    for second in range(11, 60):
        run_until(monitor, START_S + second)
        assert monitor.system_health is not None, second


def test_a_system_health_that_is_no_longer_published_is_no_longer_shown() -> None:
    monitor = start(source="none")
    outside = monitor.bus.node("outside")
    outside.advertise("system_health", "std_msgs/Float32")
    outside.publish("system_health", {"data": 64.0})
    assert monitor.system_health == 64.0
    run_until(monitor, START_S + 3.0)
    assert monitor.system_health == 64.0
    run_until(monitor, START_S + 4.0)
    assert monitor.system_health is None


def test_durations_are_monotonic_and_stamps_are_wall_time() -> None:
    wall_s = [1_000.0]
    monitor = start(source="none", wall_time_s=lambda: wall_s[0])
    arrays: List[Any] = []
    monitor.bus.node("outside").subscribe("/diagnostics", "", lambda message, now_s: arrays.append((message, now_s)))
    run_until(monitor, START_S + 1.0)
    wall_s[0] = 1_700_000_000.5  # NTP sets the clock
    arrays.clear()
    run_until(monitor, START_S + 2.0)
    message, now_s = arrays[0]
    assert message["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 500_000_000}
    assert START_S <= now_s <= START_S + 2.0


def test_each_alert_reaches_the_outlet_once_and_is_not_logged_as_well() -> None:
    events: List[Event] = []
    monitor = start(source="none", outlet=events.append)
    outside = monitor.bus.node("outside")
    outside.advertise("battery_level", "std_msgs/Float32")
    outside.publish("battery_level", {"data": 15.0})
    transitions = [event for event in events if isinstance(event, Transition)]
    assert [(transition.signal, transition.to_level) for transition in transitions] == [("battery_level", Level.WARN)]
    assert not [line for line in monitor.bus.log_lines if "battery_level WARN: " in line.text]


def test_without_an_outlet_alerts_are_logged() -> None:
    monitor = start(source="none")
    outside = monitor.bus.node("outside")
    outside.advertise("battery_level", "std_msgs/Float32")
    outside.publish("battery_level", {"data": 15.0})
    assert len([line for line in monitor.bus.log_lines if "battery_level WARN: " in line.text]) == 1


def test_source_none_starts_no_battery_sensor() -> None:
    names = {node.name for node in start(source="none").bus.nodes}
    assert "/alert_system" in names and "/battery_sensor" not in names
