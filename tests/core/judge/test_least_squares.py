"""Sums of a queue of samples, from which the slope of the least-squares line follows."""

from __future__ import annotations

from fractions import Fraction
from typing import Sequence, Tuple

import pytest

from robot_health_monitor.core.judge.least_squares import LineSums

Samples = Sequence[Tuple[float, float]]
"""(time in s, value)"""


def exact_moments(samples: Samples, now_s: float) -> tuple[Fraction, ...]:
    """Returns the moments in exact arithmetic."""
    times = [Fraction(at_s) - Fraction(now_s) for at_s, _ in samples]
    values = [Fraction(value) for _, value in samples]
    mean_s, mean = sum(times) / len(times), sum(values) / len(values)
    squares = sum((at_s - mean_s) ** 2 for at_s in times)
    products = sum((at_s - mean_s) * (value - mean) for at_s, value in zip(times, values))
    return Fraction(mean_s), Fraction(mean), Fraction(squares), Fraction(products)


def test_a_queue_whose_samples_come_and_leave_has_the_moments_of_those_that_are_left() -> None:
    sums = LineSums()
    samples = [(1000.0 + 0.5 * step, 20.0 + (7 * step) % 5 - 0.25 * step) for step in range(30)]
    sums.flip(*zip(*samples[:12]))
    for at_s, value in samples[12:]:
        sums.add(value, at_s)
    for left in range(12):
        sums.front = 12 - left
        kept, now_s = samples[left:], samples[-1][0]
        expected = [float(moment) for moment in exact_moments(kept, now_s)]
        assert sums.moments(len(kept), now_s) == pytest.approx(expected)


def test_without_a_front_the_first_sample_is_the_reference() -> None:
    sums = LineSums()
    for at_s, value in ((10.0, 1e15 + 1.0), (11.0, 1e15 + 3.0), (12.0, 1e15 + 5.0)):
        sums.add(value, at_s)
    assert sums.moments(3, 12.0) == (-1.0, 1e15 + 3.0, 2.0, 4.0)
