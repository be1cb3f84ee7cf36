"""What a field brings besides a number: elements, stamps, bad data."""

from __future__ import annotations

import math

import pytest

from robot_health_monitor.core.values.elements import (
    Age,
    BadDatum,
    Elements,
    Stamp,
    stamp_of,
    with_ages,
)


def test_a_stamp_is_its_time_in_seconds() -> None:
    stamp = stamp_of(1_700_000_000, 250_000_000)
    assert type(stamp) is Stamp
    assert stamp == 1_700_000_000.25


@pytest.mark.parametrize(
    ("seconds", "nanoseconds", "reason"),
    [
        (math.nan, 0, "not a time stamp: nan"),
        (0, math.nan, "not a time stamp: nan"),
        (math.inf, 0, "not a time stamp: inf"),
        (2**32, 0, "not a time stamp: 4294967296"),
        (10**400, 0, "not a time stamp: 1000000000000000000000000000000000000..."),
        (-1, 0, "not a time stamp: -1"),
        (None, 0, "not a time stamp: None"),
        ("now", 0, "not a time stamp: 'now'"),
        (True, 0, "not a time stamp: True"),
        (5, [], "not a time stamp: []"),
    ],
)
def test_a_stamp_that_is_no_time_is_a_bad_datum(seconds: object, nanoseconds: object, reason: str) -> None:
    stamp = stamp_of(seconds, nanoseconds)
    assert type(stamp) is BadDatum
    assert stamp == reason


def test_a_stamp_becomes_its_age_by_the_clock_of_stamps() -> None:
    age = with_ages(Stamp(1_700_000_000.0), lambda: 1_700_000_002.5)
    assert (type(age), age, age.remark) == (Age, 2.5, "")


@pytest.mark.parametrize(
    ("stamp_s", "remark"),
    [
        (1_700_000_000.5, "clocks differ"),
        (1_700_000_000.0, ""),
        (1_600_000_000.0, ""),
        (300.0, "the stamp does not count from 1970"),  # seconds since the start of the robot
    ],
)
def test_an_odd_age_says_what_is_wrong_with_the_clocks(stamp_s: float, remark: str) -> None:
    assert with_ages(Stamp(stamp_s), lambda: 1_700_000_000.0).remark == remark


def test_a_zero_stamp_is_no_time_stamp() -> None:
    assert with_ages(stamp_of(0, 0), lambda: 5.0) == "no time stamp"


def test_the_stamps_of_elements_become_ages_and_other_elements_stay() -> None:
    found = with_ages(Elements([("0", Stamp(5.0)), ("1", Stamp(0.0)), ("2", 7.0)]), lambda: 8.0)
    assert found == [("0", 3.0), ("1", "no time stamp"), ("2", 7.0)]
    assert [type(value) for _, value in found] == [Age, BadDatum, float]


@pytest.mark.parametrize("value", [5.0, 7, "text", None, Elements([("0", 5.0)])])
def test_other_values_need_no_clock(value: object) -> None:
    assert with_ages(value, lambda: 1 / 0) is value
