"""Every event reaches every outlet, whatever another outlet does; transitions as JSON, statuses as messages."""

from __future__ import annotations

import json
from typing import Any

import pytest
from harness.transitions import transition

from robot_health_monitor.core import Level, Monitor, Sample, Status, Transition, load_config
from robot_health_monitor.core.nodes.outlets import (
    Event,
    Notice,
    Outlets,
    alert_message,
    array_message,
    event_text,
    json_line,
    status_message,
)
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.faults import Faults

NOTICE = Notice(1.0, Severity.WARN, "time went back by 3 s")


class Outlet:
    """Keeps its events, or raises."""

    def __init__(self) -> None:
        self.events: list[Event] = []
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
    order: list[str] = []
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


def strictly(constant: str) -> None:
    raise AssertionError(f"{constant} is no JSON")


def test_json_has_every_field_and_levels_by_name() -> None:
    assert json.loads(json_line(transition(statistics={"mean": 21.0}))) == {
        "signal": "battery_level",
        "from_level": "OK",
        "to_level": "WARN",
        "value": 19.5,
        "statistic": "last",
        "bound": 20.0,
        "now_s": 1000.0,
        "since_s": 688.0,
        "robot": "atlas",
        "fingerprint": "0123456789abcdef",
        "text": "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)",
        "statistics": {"mean": 21.0},
        "repeat": False,
        "hint": "",
        "cause": "",
        "affects": 0,
        "black_box": "",
    }


@pytest.mark.parametrize(
    ("value", "written"),
    [
        (float("nan"), None),
        (float("inf"), None),
        (float("-inf"), None),
        (None, None),
        ("charging", "charging"),
        (True, True),
        ([1.0, float("nan")], [1.0, None]),
        ({"data": float("nan")}, {"data": None}),
        (b"\x01", "AQ=="),
        (10**400, 10**400),
        (1 + 2j, "(1+2j)"),
    ],
)
def test_any_value_becomes_valid_json(value: Any, written: Any) -> None:
    line = json_line(transition(value))
    assert "\n" not in line
    assert json.loads(line, parse_constant=strictly)["value"] == written


def test_an_integer_that_python_refuses_to_print_becomes_valid_json() -> None:
    written = json.loads(json_line(transition(10**5000)))["value"]
    assert isinstance(written, str) and len(written) <= 40


@pytest.mark.parametrize("value", ["x" * 1_000_000, [0.0] * 100_000, {"data": ["x"] * 10_000}])
def test_a_huge_value_that_is_no_number_is_shortened(value: Any) -> None:
    """It would go to the terminal and to every target of notifications."""
    line = json_line(transition(value))
    assert json.loads(line)["value"] == repr(value)[:37] + "..."
    assert len(line) < 1_000


def test_a_value_of_2000_characters_is_written_in_full() -> None:
    value = "x" * 1998
    assert json.loads(json_line(transition(value)))["value"] == value
    assert json.loads(json_line(transition(value + "x")))["value"] != value + "x"


def alert() -> Transition:
    monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0, "unit": "%"}}}), "atlas")
    monitor.observe(Sample("battery_level", 50.0, 100.0))
    return monitor.observe(Sample("battery_level", 19.5, 104.0))[0]


def test_a_status_is_named_by_its_node_and_signal_and_keyed_by_the_robot() -> None:
    status = Status("battery_level", Level.STALE, "no sample for 6 s", "atlas", {"value": "19.5", "unit": "%"})
    assert status_message(status, "alert_system") == {
        "level": 3,
        "name": "alert_system: battery_level",
        "message": "no sample for 6 s",
        "hardware_id": "atlas",
        "values": [
            {"key": "value", "value": "19.5"},
            {"key": "unit", "value": "%"},
            {
                "key": "fingerprint",
                "value": "a5be2b021a24d9aa",
            },  # printf 'atlas\0alert_system: battery_level' | sha256sum
        ],
    }


def test_a_level_is_a_plain_int() -> None:
    message = status_message(Status("a", Level.WARN, "", "", {}), "n")
    assert type(message["level"]) is int


def test_an_array_holds_every_status_in_order() -> None:
    statuses = [Status(name, Level.OK, "", "", {}) for name in ("b", "a")]
    assert [each["name"] for each in array_message(statuses, "n")["status"]] == ["n: b", "n: a"]


def test_an_alert_carries_the_line_that_is_logged_and_where_it_came_from() -> None:
    message = alert_message(alert(), "alert_system")
    assert message["name"] == "alert_system: battery_level"
    assert message["level"] == 1
    assert message["message"] == "battery_level WARN: 19.5 % is below 20 % (was OK for 4 s)"
    assert message["hardware_id"] == "atlas"
    values = {each["key"]: each["value"] for each in message["values"]}
    assert (
        values.items()
        >= {
            "from_level": "OK",
            "to_level": "WARN",
            "value": "19.5",
            "statistic": "last",
            "bound": "20.0",
            "now_s": "104.0",
            "since_s": "100.0",
            "fingerprint": alert().fingerprint,
        }.items()
    )


def test_an_alert_without_value_and_bound_has_empty_texts_for_them() -> None:
    monitor = Monitor(load_config({"signals": {"a": {"startup_grace_s": 1.0}}}))
    monitor.tick(0.0)
    (stale,) = monitor.tick(2.0)
    values = {each["key"]: each["value"] for each in alert_message(stale, "n")["values"]}
    assert (values["value"], values["bound"]) == ("", "")


class Torn:
    def __str__(self) -> str:
        raise RuntimeError("no text")

    __repr__ = __str__


def test_an_alert_of_any_datum_can_be_written() -> None:
    monitor = Monitor(load_config({"signals": {"a": {}}}))
    (invalid,) = monitor.observe(Sample("a", Torn(), 0.0))
    values = {each["key"]: each["value"] for each in alert_message(invalid, "n")["values"]}
    assert values["value"] == "a Torn"


def test_a_text_of_a_megabyte_where_a_number_belongs_is_shortened_in_an_alert() -> None:
    monitor = Monitor(load_config({"signals": {"a": {}}}))
    (invalid,) = monitor.observe(Sample("a", "x" * 1_000_000, 0.0))
    values = {each["key"]: each["value"] for each in alert_message(invalid, "n")["values"]}
    assert values["value"] == "'" + "x" * 36 + "..."
