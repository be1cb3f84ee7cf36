"""Faults of the history reach every robot."""

from __future__ import annotations

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.ops.history.fault_reports import FaultReports


def test_a_robot_that_is_added_later_receives_the_present_faults() -> None:
    reports, early, late = FaultReports(), Faults(), Faults()
    reports.add(early)
    reports.add(early)
    reports.report("history", "the disk is full")
    reports.add(late)
    for faults in (early, late):
        assert {part: fault.text for part, fault in faults.current().items()} == {"history": "the disk is full"}
    reports.clear("history")
    assert not early.current() and not late.current()


def test_a_robot_that_has_ended_receives_nothing() -> None:
    reports, faults = FaultReports(), Faults()
    reports.add(faults)
    reports.remove(faults)
    reports.report("history", "the disk is full")
    assert not faults.current()
