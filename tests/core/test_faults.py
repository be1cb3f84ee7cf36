from __future__ import annotations

import pytest

from robot_health_monitor.core.faults import Fault, Faults
from robot_health_monitor.core.model import Level


def test_a_fault_is_current_until_it_is_cleared() -> None:
    faults = Faults()
    assert faults.current() == {}
    faults.report("rosbridge", "port 9090 is in use")
    faults.report("clock", "no message on /clock", Level.WARN)
    assert faults.current() == {
        "rosbridge": Fault(Level.ERROR, "port 9090 is in use"),
        "clock": Fault(Level.WARN, "no message on /clock"),
    }
    faults.clear("rosbridge")
    faults.clear("rosbridge")
    assert list(faults.current()) == ["clock"]


def test_a_later_report_replaces_that_of_the_same_part() -> None:
    faults = Faults()
    faults.report("log", "disk nearly full", Level.WARN)
    faults.report("log", "disk full")
    assert faults.current() == {"log": Fault(Level.ERROR, "disk full")}


def test_a_text_of_several_lines_becomes_one() -> None:
    faults = Faults()
    faults.report("log", "No space left\n  on device\n")
    assert faults.current()["log"].text == "No space left on device"


def test_the_number_of_parts_is_bounded_and_known_parts_stay_reportable() -> None:
    faults = Faults()
    for number in range(200):
        faults.report(f"client {number}", "gone")
    assert len(faults.current()) == 100
    faults.report("client 5", "gone again")
    assert faults.current()["client 5"].text == "gone again"


def test_what_was_read_does_not_change_later() -> None:
    faults = Faults()
    before = faults.current()
    faults.report("log", "disk full")
    assert before == {}


def test_a_guarded_call_that_raises_is_a_fault_until_the_next_success() -> None:
    faults, calls = Faults(), []  # type: ignore[var-annotated]
    faults.guard("disk", calls.index, 7)
    assert faults.current() == {"disk": Fault(Level.ERROR, "ValueError: 7 is not in list")}
    faults.guard("disk", calls.append, 7)
    assert faults.current() == {} and calls == [7]


def test_a_guarded_call_lets_an_interrupt_through() -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Faults().guard("disk", interrupt)
