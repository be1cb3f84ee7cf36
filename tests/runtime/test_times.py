"""Texts of wall times."""

from __future__ import annotations

import math
from datetime import timedelta, timezone

import pytest

from robot_health_monitor.runtime.times import iso_time, local_time, utc_text


def test_times_are_iso_8601_in_utc() -> None:
    assert iso_time(0.0) == "1970-01-01T00:00:00.000Z"
    assert iso_time(1_795_324_032.25) == "2026-11-22T05:07:12.250Z"
    for impossible in (float("nan"), float("inf"), 1e300, -1e18):
        assert iso_time(impossible) is None


@pytest.mark.parametrize(
    ("wall_s", "text"),
    [
        (0.0, "1970-01-01T00:00:00.000Z"),
        (0.9996, "1970-01-01T00:00:01.000Z"),
        (-5.0, "1970-01-01T00:00:00.000Z"),
        (math.inf, "9999-12-31T23:59:59.000Z"),
    ],
)
def test_any_time_becomes_a_valid_timestamp(wall_s: float, text: str) -> None:
    assert utc_text(wall_s) == text


def test_a_local_time_has_the_form_and_the_zone_that_are_given() -> None:
    india = timezone(timedelta(hours=5, minutes=30))
    assert local_time(1_795_324_032.25, zone=india) == "2026-11-22 10:37:12"
    assert local_time(1_795_324_032.25, "%H:%M %z", india) == "10:37 +0530"


@pytest.mark.parametrize("wall_s", [math.inf, 1e300, -1e18, math.nan])
def test_where_there_is_no_such_date_the_seconds_are_shown(wall_s: float) -> None:
    assert local_time(wall_s) == f"{wall_s:.0f} s"
