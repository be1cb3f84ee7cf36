from __future__ import annotations

import pytest

from robot_health_monitor.core.values.faults import Fault, Faults
from robot_health_monitor.core.values.model import Level


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


def test_an_empty_text_ends_the_fault() -> None:
    faults = Faults()
    faults.report("log", "disk full")
    faults.report("log", "")
    assert faults.current() == {}


def test_a_text_of_several_lines_becomes_one() -> None:
    faults = Faults()
    faults.report("log", "No space left\n  on device\n")
    assert faults.current()["log"].text == "No space left on device"


def test_faults_beyond_the_limit_are_one_fault() -> None:
    faults = Faults()
    for number in range(200):
        faults.report(f"client {number}", "gone", Level.WARN)
    faults.report("outlet log", "disk\nfull")
    assert len(faults.current()) == 101
    assert faults.current()["other parts"] == Fault(
        Level.ERROR, "more than 100 faults, the last one of outlet log: disk full"
    )
    faults.report("client 5", "gone again")
    assert faults.current()["client 5"].text == "gone again"


def test_the_fault_of_other_parts_ends_with_any_other_one() -> None:
    faults = Faults()
    for number in range(101):
        faults.report(f"client {number}", "gone")
    faults.clear("client 100")  # not listed
    assert "other parts" in faults.current()
    faults.clear("client 0")
    assert len(faults.current()) == 99
    faults.report("client 100", "gone")
    assert faults.current()["client 100"].text == "gone"


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


def test_shared_faults_reach_nodes_that_are_added_later_too() -> None:
    shared, early, late = Faults(), Faults(), Faults()
    shared.add(early)
    shared.report("history", "disk full")
    shared.add(late)
    assert [each.current()["history"].text for each in (shared, early, late)] == ["disk full"] * 3
    shared.clear("history")
    assert [dict(each.current()) for each in (shared, early, late)] == [{}, {}, {}]


def test_an_empty_text_ends_a_fault() -> None:
    faults = Faults()
    faults.report("log", "disk full")
    faults.report("log", "")
    assert faults.current() == {}
