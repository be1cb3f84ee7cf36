"""Every event reaches every outlet, whatever another outlet does."""

from __future__ import annotations

from typing import List

from harness.transitions import transition

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.outlets import Event, Notice, Outlets, event_text

NOTICE = Notice(1.0, Severity.WARN, "time went back by 3 s")


class Outlet:
    """Keeps its events, or raises."""

    def __init__(self) -> None:
        self.events: List[Event] = []
        self.error = ""

    def __call__(self, event: Event) -> None:
        if self.error:
            raise OSError(self.error)
        self.events.append(event)


def test_people_read_a_transition_with_its_hint() -> None:
    assert event_text(NOTICE) == "time went back by 3 s"
    assert event_text(transition(text="battery STALE: silent")) == "battery STALE: silent"
    stale = transition(text="battery STALE: silent", hint="no publisher on /battery")
    assert event_text(stale) == "battery STALE: silent [no publisher on /battery]"


def test_every_outlet_receives_each_event_in_the_order_in_which_they_were_added() -> None:
    order: List[str] = []
    outlets = Outlets(Faults())
    for name in ("history", "log", "alerts"):
        outlets.add(name, lambda event, name=name: order.append(name))  # type: ignore[misc]
    outlets.emit(NOTICE)
    assert order == ["history", "log", "alerts"]


def test_an_outlet_that_raises_is_a_fault_and_the_others_receive_the_event() -> None:
    faults, before, broken, after = Faults(), Outlet(), Outlet(), Outlet()
    outlets = Outlets(faults)
    for name, outlet in (("before", before), ("log", broken), ("after", after)):
        outlets.add(name, outlet)
    broken.error = "No space left on device"
    outlets.emit(NOTICE)
    assert before.events == after.events == [NOTICE]
    assert faults.current() == {"outlet log": (Level.ERROR, "OSError: No space left on device")}


def test_the_next_success_of_an_outlet_clears_its_fault() -> None:
    faults, outlet = Faults(), Outlet()
    outlets = Outlets(faults)
    outlets.add("log", outlet)
    outlet.error = "No space left on device"
    outlets.emit(NOTICE)
    outlet.error = ""
    outlets.emit(NOTICE)
    assert faults.current() == {}
    assert outlet.events == [NOTICE]


def test_a_success_does_not_clear_the_fault_of_another_part() -> None:
    faults = Faults()
    faults.report("rosbridge", "port 9090 is in use")
    outlets = Outlets(faults)
    outlets.add("log", Outlet())
    outlets.emit(NOTICE)
    assert list(faults.current()) == ["rosbridge"]


def test_an_outlet_may_be_added_from_an_outlet() -> None:
    outlets, late = Outlets(Faults()), Outlet()
    outlets.add("first", lambda event: outlets.add("late", late))
    outlets.emit(NOTICE)
    outlets.emit(NOTICE)
    assert late.events == [NOTICE]
