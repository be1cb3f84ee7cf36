"""Statuses and transitions as diagnostic_msgs messages."""

from __future__ import annotations

from robot_health_monitor.core import Level, Monitor, Sample, Status, Transition, load_config
from robot_health_monitor.core.diagnostics import ARRAY_TYPE, STATUS_TYPE, alert_message, array_message, status_message


def transition() -> Transition:
    monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0, "unit": "%"}}}), "atlas")
    monitor.observe(Sample("battery_level", 50.0, 100.0))
    return monitor.observe(Sample("battery_level", 19.5, 104.0))[0]


def test_types_are_those_of_diagnostic_msgs() -> None:
    assert (STATUS_TYPE, ARRAY_TYPE) == ("diagnostic_msgs/DiagnosticStatus", "diagnostic_msgs/DiagnosticArray")


def test_a_status_is_named_by_its_node_and_signal_and_keyed_by_the_robot() -> None:
    status = Status("battery_level", Level.STALE, "no sample for 6 s", "atlas", {"value": "19.5", "unit": "%"})
    assert status_message(status, "alert_system") == {
        "level": 3,
        "name": "alert_system: battery_level",
        "message": "no sample for 6 s",
        "hardware_id": "atlas",
        "values": [{"key": "value", "value": "19.5"}, {"key": "unit", "value": "%"}],
    }


def test_a_level_is_a_plain_int() -> None:
    message = status_message(Status("a", Level.WARN, "", "", {}), "n")
    assert type(message["level"]) is int


def test_an_array_holds_every_status_in_order() -> None:
    statuses = [Status(name, Level.OK, "", "", {}) for name in ("b", "a")]
    assert [each["name"] for each in array_message(statuses, "n")["status"]] == ["n: b", "n: a"]


def test_an_alert_carries_the_line_that_is_logged_and_where_it_came_from() -> None:
    message = alert_message(transition(), "alert_system")
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
            "fingerprint": transition().fingerprint,
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
