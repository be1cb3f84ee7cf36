"""Levels, their severity, and values that cannot be changed."""

from __future__ import annotations

import copy
import dataclasses
import json
import pickle

import pytest

from robot_health_monitor.core import Changes, Level, Report, Sample, Status, Transition


def transition(**changes: object) -> Transition:
    values = {
        "signal": "battery_level",
        "from_level": Level.OK,
        "to_level": Level.WARN,
        "value": 19.5,
        "statistic": "last",
        "bound": 20.0,
        "now_s": 312.0,
        "since_s": 0.0,
        "robot": "atlas",
        "fingerprint": "0123456789abcdef",
        "text": "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)",
        "status": Status("battery_level", Level.WARN, "19.5 % is below 20 %", "atlas", {"value": "19.5"}),
    }
    return Transition(**{**values, **changes})  # type: ignore[arg-type]


def test_levels_are_the_wire_values_of_diagnostic_status() -> None:
    # diagnostic_msgs/msg/DiagnosticStatus.msg: byte OK=0, byte WARN=1, byte ERROR=2, byte STALE=3
    assert [(level.name, int(level)) for level in Level] == [("OK", 0), ("WARN", 1), ("ERROR", 2), ("STALE", 3)]


def test_severity_puts_a_missing_signal_between_a_warning_and_an_error() -> None:
    assert sorted(Level, key=lambda level: level.severity) == [Level.OK, Level.WARN, Level.STALE, Level.ERROR]


@pytest.mark.parametrize(
    ("levels", "worst"),
    [
        ([], Level.OK),
        ([Level.OK, Level.OK], Level.OK),
        ([Level.STALE, Level.WARN], Level.STALE),
        ([Level.STALE, Level.ERROR], Level.ERROR),
        ([Level.ERROR, Level.STALE], Level.ERROR),
    ],
)
def test_worst_goes_by_severity_not_by_wire_value(levels: list, worst: Level) -> None:
    assert Level.worst(levels) is worst


def test_a_printed_transition_has_the_time_before_its_text() -> None:
    assert str(transition()) == "312.000 battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)"


@pytest.mark.parametrize(
    "value",
    [transition(), Status("a", Level.OK, "", "", {}), Report(Level.OK, {}, 0.0, ""), Sample("a", 1.0, 0.0)],
    ids=lambda value: type(value).__name__,
)
def test_values_are_frozen(value: object) -> None:
    name = value._fields[0] if isinstance(value, Sample) else dataclasses.fields(value)[0].name  # type: ignore[arg-type]
    with pytest.raises(AttributeError):
        setattr(value, name, "changed")


def test_mappings_inside_values_are_frozen_too_and_no_longer_the_callers() -> None:
    statistics = {"mean": 1.0}
    of_transition = transition(statistics=statistics)
    statistics["mean"] = 2.0

    assert of_transition.statistics == {"mean": 1.0}
    with pytest.raises(TypeError):
        of_transition.statistics["mean"] = 3.0  # type: ignore[index]
    with pytest.raises(TypeError):
        Status("a", Level.OK, "", "", {}).values["value"] = "1"  # type: ignore[index]
    with pytest.raises(TypeError):
        Report(Level.OK, {}, 0.0, "").statuses["a"] = Status("a", Level.OK, "", "", {})  # type: ignore[index]


def test_equal_transitions_are_equal() -> None:
    assert transition(statistics={"mean": 1.0}) == transition(statistics={"mean": 1.0})
    assert transition() != transition(now_s=313.0)


def test_no_changes_equal_an_empty_list_and_have_no_notices() -> None:
    assert Changes() == [] and not Changes()
    assert Changes().notices == ()


def test_a_call_without_a_transition_adds_nothing() -> None:
    changes = Changes()
    changes.add(None)
    assert changes == []


def test_changes_are_a_list_of_transitions() -> None:
    assert Changes([transition()]) == [transition()]
    assert isinstance(Changes(), list)


def test_transitions_and_reports_can_be_copied_pickled_and_taken_apart() -> None:
    seen = transition(statistics={"mean": 1.0})
    report = Report(Level.OK, {"a": Status("a", Level.OK, "", "", {"value": "1"})}, 0.0, "atlas")
    for value in (seen, report):
        assert copy.deepcopy(value) == pickle.loads(pickle.dumps(value)) == value
    assert dataclasses.asdict(seen)["statistics"] == {"mean": 1.0}
    assert json.loads(json.dumps(dataclasses.asdict(report)))["statuses"]["a"]["values"] == {"value": "1"}
    assert len({seen, transition(statistics={"mean": 1.0})}) == 1


@pytest.mark.parametrize("change", ["clear", "popitem"])
def test_no_method_changes_a_mapping_inside_a_value(change: str) -> None:
    statistics = transition(statistics={"mean": 1.0}).statistics
    with pytest.raises(TypeError):
        getattr(statistics, change)()
    assert statistics == {"mean": 1.0}
