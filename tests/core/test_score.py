"""Scores by hand: 100 at the healthy end, 50 at WARN, 0 at ERROR."""

from __future__ import annotations

from typing import Any, Mapping

import pytest

from robot_health_monitor.core.config import DEFAULT_SIGNALS
from robot_health_monitor.core.score import health_score
from robot_health_monitor.core.signal_config import read_signal

BATTERY = DEFAULT_SIGNALS["battery_level"]  # valid 0..100, WARN below 20, ERROR below 10
TEMPERATURE = DEFAULT_SIGNALS["temperature"]  # valid -40..150, WARN above 80, ERROR above 95
BOTH = {"valid_min": 0.0, "valid_max": 30.0, "warn_below": 10.0, "warn_above": 20.0, "error_above": 25.0}


@pytest.mark.parametrize(
    ("settings", "value", "score"),
    [
        (BATTERY, 100.0, 100.0),
        (BATTERY, 60.0, 75.0),
        (BATTERY, 20.0, 50.0),
        (BATTERY, 15.0, 25.0),
        (BATTERY, 10.0, 0.0),
        (BATTERY, 0.0, 0.0),
        (TEMPERATURE, -40.0, 100.0),
        (TEMPERATURE, 20.0, 75.0),
        (TEMPERATURE, 80.0, 50.0),
        (TEMPERATURE, 87.5, 25.0),
        (TEMPERATURE, 95.0, 0.0),
        (TEMPERATURE, 150.0, 0.0),
        ({"warn_below": 20.0, "valid_min": 0.0}, 10.0, 25.0),  # no ERROR bound: 0 at the end of the range
        ({"warn_below": 20.0}, 1e9, 100.0),  # no healthy end: fine is fine
        ({"warn_below": 20.0}, 20.0, 100.0),
        ({"warn_below": 20.0}, 19.0, 50.0),  # neither ERROR bound nor end: it never gets worse than WARN
        ({"error_below": 10.0}, 0.0, 100.0),  # a side without a WARN bound
        ({}, 5.0, 100.0),
        (BOTH, 10.0, 50.0),
        (BOTH, 20.0, 50.0),
        (BOTH, 15.0, 62.5),  # 5 of 20 above WARN low: 62.5; 5 of 20 below WARN high: 62.5
        (BOTH, 22.5, 25.0),
        (BOTH, 5.0, 25.0),
    ],
)
def test_score(settings: Mapping[str, Any], value: float, score: float) -> None:
    assert health_score(value, read_signal("a", settings)) == pytest.approx(score)


def test_equal_warn_and_error_bounds_fall_from_50_to_0_at_once() -> None:
    signal = read_signal("a", {"warn_below": 10.0, "error_below": 10.0, "valid_max": 20.0})
    assert health_score(10.0, signal) == 50.0
    assert health_score(9.999, signal) == 0.0
