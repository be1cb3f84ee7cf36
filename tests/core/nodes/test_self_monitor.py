"""What alert_system reports of itself; test_alert_system.py has its effect on the outlets."""

from __future__ import annotations

import pytest

from robot_health_monitor.core.nodes.outlets import Event, Notice
from robot_health_monitor.core.nodes.self_monitor import SelfMonitor
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.model import Level


class Watch:
    """A SelfMonitor on a bus in virtual time."""

    def __init__(self) -> None:
        self.bus = LocalBus(100.0)
        self.node = self.bus.node("alert_system")
        self.events: list[Event] = []
        self.monitor = SelfMonitor(self.node, "robot1", self.events.append)

    def check_at(self, steady_s: float, samples: int = 0) -> None:
        self.bus.run_due(steady_s)
        self.monitor.note_tick(steady_s)
        self.monitor.check(samples)


@pytest.fixture
def watch() -> Watch:
    return Watch()


def test_a_fault_that_gets_worse_is_announced_again_and_one_that_gets_better_is_not(watch: Watch) -> None:
    for second, level in enumerate((Level.WARN, Level.ERROR, Level.WARN, Level.ERROR)):
        watch.node.faults.report("disk", "nearly full", level)
        watch.check_at(101.0 + second)
    assert watch.events == [
        Notice(101.0, Severity.WARN, "disk: nearly full", "disk"),
        Notice(102.0, Severity.ERROR, "disk: nearly full", "disk"),
    ]


def test_a_fault_ends_when_its_part_has_worked_for_3_s(watch: Watch) -> None:
    watch.node.faults.report("disk", "full")
    watch.check_at(101.0)
    watch.node.faults.clear("disk")
    for second in (102.0, 103.0, 104.0):
        watch.check_at(second)
    assert len(watch.events) == 1
    watch.check_at(105.0)
    assert watch.events[1:] == [Notice(105.0, Severity.INFO, "disk works again", "disk")]


def test_the_rate_of_samples_is_that_since_the_previous_check(watch: Watch) -> None:
    watch.check_at(102.0, samples=50)
    assert watch.monitor.status().values["samples_per_s"] == "25"
    watch.check_at(102.0, samples=50)  # no time has passed
    assert watch.monitor.status().values["samples_per_s"] == "25"


def test_a_tick_that_does_not_come_is_late_and_5_s_are_a_fault(watch: Watch) -> None:
    watch.check_at(101.0)
    watch.bus.run_due(106.5)
    watch.monitor.check(0)
    assert watch.monitor.status().values["tick_late_s"] == "4.500"
    assert watch.events == []
    watch.bus.run_due(107.5)
    watch.monitor.check(0)
    assert [event.text for event in watch.events] == ["tick: 5.5 s late (period 1 s): overloaded or suspended"]
    assert watch.monitor.status().level is Level.WARN


def test_a_tick_that_could_not_come_is_not_late(watch: Watch) -> None:
    watch.check_at(101.0)
    watch.bus.run_due(107.5)
    watch.monitor.skip(6.0)
    watch.monitor.check(0)
    assert watch.monitor.status().values["tick_late_s"] == "0.000"
    assert watch.events == []


def test_the_level_is_that_of_the_worst_fault(watch: Watch) -> None:
    assert watch.monitor.status().level is Level.OK
    watch.node.faults.report("clock", "silent", Level.WARN)
    watch.node.faults.report("disk", "full")
    watch.node.faults.report("log", "slow", Level.WARN)
    status = watch.monitor.status()
    assert (status.name, status.level, status.message, status.hardware_id) == (
        "monitor",
        Level.ERROR,
        "disk: full",
        "robot1",
    )
    assert [key for key in status.values if key.startswith("fault: ")] == ["fault: clock", "fault: disk", "fault: log"]


def test_the_age_of_the_tick_grows_until_the_next_one(watch: Watch) -> None:
    watch.check_at(101.0)
    assert watch.monitor.tick_age_s == 0.0
    watch.bus.run_due(107.5)
    assert watch.monitor.tick_age_s == 6.5
    watch.monitor.note_tick(107.5)
    watch.monitor.check(0)
    assert watch.monitor.tick_age_s == 0.0


def test_a_paused_simulator_does_not_age_the_tick_but_a_node_that_stops_does() -> None:
    bus = LocalBus(100.0)
    monitor = SelfMonitor(bus.node("alert_system", use_sim_time=True), "robot1", lambda event: None)
    bus.run_due(120.0)
    monitor.check(0)
    assert monitor.tick_age_s == 0.0
    bus.run_due(131.0)  # no check since 120 s
    assert monitor.tick_age_s == 10.0
