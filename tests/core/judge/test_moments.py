"""Sums of a queue of samples, from which its means, its variance and its least-squares line follow."""

from __future__ import annotations

import math
import statistics
from fractions import Fraction
from typing import Sequence, Tuple

import pytest

from robot_health_monitor.core.judge.moments import Sums

Samples = Sequence[Tuple[float, float]]
"""(time in s, value)"""


def exact_line(samples: Samples, at_s: float) -> Tuple[Fraction, Fraction]:
    """Returns the value of the least-squares line at a time, and its slope, in exact arithmetic."""
    times, values = ([Fraction(each[place]) for each in samples] for place in (0, 1))
    mean_s, mean = sum(times) / len(times), sum(values) / len(values)
    squares = sum((each - mean_s) ** 2 for each in times)
    slope = sum((each - mean_s) * (value - mean) for each, value in zip(times, values)) / squares
    return mean + slope * (Fraction(at_s) - mean_s), slope


def test_a_queue_whose_samples_come_and_leave_has_the_sums_of_those_that_are_left() -> None:
    samples = [(1000.0 + 0.5 * step, 20.0 + (7 * step) % 5 - 0.25 * step) for step in range(30)]
    times, values = zip(*samples)
    sums = Sums(times[:12], values[:12])
    for at_s, value in samples[12:]:
        sums.add(at_s, value)
    for left in range(12):
        front, kept = 12 - left, values[left:]
        assert (sums.smallest(front), sums.largest(front)) == (min(kept), max(kept))
        assert sums.mean(front) == pytest.approx(statistics.fmean(kept))
        assert sums.variance(front) == pytest.approx(statistics.pvariance(kept))
        expected = exact_line(samples[left:], 1020.0)
        assert sums.line(front, times[-1], 1020.0 - times[-1]) == pytest.approx(tuple(map(float, expected)))


def test_distances_from_the_newest_sample_of_the_front_lose_no_digits() -> None:
    sums = Sums([10.0], [1e15 + 1.0])
    sums.add(11.0, 1e15 + 3.0)
    sums.add(12.0, 1e15 + 5.0)
    assert (sums.mean(1), sums.variance(1)) == (1e15 + 3.0, 8.0 / 3.0)
    assert sums.line(1, 12.0, 1.0) == (1e15 + 7.0, 2.0)


def test_without_time_between_samples_there_is_no_line() -> None:
    sums = Sums([5.0], [1.0])
    sums.add(5.0, 2.0)
    assert all(map(math.isnan, sums.line(1, 5.0, 1.0)))
