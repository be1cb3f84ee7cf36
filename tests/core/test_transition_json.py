"""Transitions as JSON: every field, valid JSON for any value."""

from __future__ import annotations

import json
from typing import Any

import pytest
from harness.transitions import transition

from robot_health_monitor.core.transition_json import json_line


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
