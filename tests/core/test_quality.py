"""Valid numbers, bad data, and counts."""

from __future__ import annotations

import math
from typing import Any

import pytest

from robot_health_monitor.core.quality import Quality, as_float
from robot_health_monitor.core.signal_config import read_signal


def quality(**settings: Any) -> Quality:
    return Quality(read_signal("battery", settings))


@pytest.mark.parametrize(
    ("value", "number"), [(19.5, 19.5), (True, 1.0), (20, 20.0), (-0.0, 0.0), (1.7e308, 1.7e308), (5e-324, 5e-324)]
)
def test_real_numbers_are_good(value: object, number: float) -> None:
    judged = quality()
    assert judged.judge(value) == number
    assert (judged.good_samples, judged.bad_samples, judged.latest) == (1, 0, value)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, None, "19.5", [1.0], 10**400, 1 + 2j])
def test_what_is_no_finite_real_number_is_bad_and_counted(value: object) -> None:
    judged = quality()
    assert math.isnan(judged.judge(value))
    assert (judged.good_samples, judged.bad_samples, judged.seen) == (0, 1, True)
    assert judged.latest is value


@pytest.mark.parametrize(("value", "good"), [(0.0, True), (100.0, True), (-0.001, False), (100.001, False)])
def test_the_ends_of_the_valid_range_are_valid(value: float, good: bool) -> None:
    assert math.isnan(quality(valid_min=0.0, valid_max=100.0).judge(value)) is not good


def test_a_placeholder_is_bad_and_scale_converts_the_rest() -> None:
    judged = quality(scale=100.0, placeholders=[-1.0])
    assert math.isnan(judged.judge(-1.0))
    assert judged.judge(0.25) == 25.0


def test_a_new_configuration_keeps_the_counts() -> None:
    judged = quality()
    judged.judge(5.0)
    judged.configure(read_signal("battery", {"valid_max": 1.0}))
    assert math.isnan(judged.judge(5.0))
    assert (judged.good_samples, judged.bad_samples) == (1, 1)


def test_a_number_whose_conversion_raises_is_no_number() -> None:
    class Broken(float):
        def __float__(self) -> float:
            raise RuntimeError

    assert math.isnan(as_float(Broken(1.0)))
