"""Events become lines: what JSON has no number for, what a log says twice, where an installed file is."""

from __future__ import annotations

import json
from typing import Any

import pytest

from robot_health_monitor.core import Level, Status, Transition
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.installed_files import find_installed
from robot_health_monitor.output.lines import Events, json_line, plain_line


def transition(value: Any = 19.5, to_level: Level = Level.WARN, **fields: Any) -> Transition:
    known = {
        "signal": "battery_level",
        "from_level": Level.OK,
        "to_level": to_level,
        "value": value,
        "statistic": "last",
        "bound": 20.0,
        "now_s": 1000.0,
        "since_s": 688.0,
        "robot": "atlas",
        "fingerprint": "0123456789abcdef",
        "text": "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)",
        "status": Status("battery_level", to_level, "19.5 % is below 20 %", "atlas", {}),
    }
    return Transition(**{**known, **fields})


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
        (b"\x01", "b'\\x01'"),
        (10**400, 10**400),
    ],
)
def test_any_value_becomes_valid_json(value: Any, written: Any) -> None:
    line = json_line(transition(value))
    assert "\n" not in line
    assert json.loads(line, parse_constant=strictly)["value"] == written


def test_a_transition_takes_the_place_of_its_log_line() -> None:
    events = Events()
    before = LogLine(1.0, "/alert_system", Severity.INFO, "watching")
    events.on_log(before)
    events.on_log(LogLine(2.0, "/alert_system", Severity.WARN, transition().text))
    events.on_transition(transition())
    assert events.take() == [before, transition()]
    assert events.take() == []


def test_a_transition_whose_log_line_was_too_quiet_is_kept() -> None:
    events = Events(Severity.ERROR)
    earlier = LogLine(1.0, "/battery_sensor", Severity.ERROR, transition().text)
    events.on_log(earlier)
    events.on_log(LogLine(2.0, "/alert_system", Severity.WARN, transition().text))
    events.on_transition(transition())
    assert events.take() == [earlier, transition()]


def test_only_transitions_away_from_ok_count_as_alerts() -> None:
    events = Events()
    for level in (Level.WARN, Level.ERROR, Level.STALE, Level.OK):
        events.on_transition(transition(to_level=level))
    assert events.alerts == 3


def test_a_log_line_names_severity_and_node() -> None:
    line = LogLine(0.0, "/robot1/alert_system", Severity.INFO, "watching")
    assert plain_line(line, "at") == "at [INFO] alert_system: watching"


def test_a_file_that_is_nowhere_is_not_found() -> None:
    assert find_installed("config/no_such_file.yaml") is None
