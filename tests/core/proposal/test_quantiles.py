"""Quantiles of streams, by hand."""

from __future__ import annotations

import math
import random

import pytest

from robot_health_monitor.core.proposal.quantiles import SIZE, Quantiles


def test_a_few_numbers_have_exact_quantiles() -> None:
    quantiles = Quantiles()
    for number in (5.0, 1.0, 4.0, 2.0, 3.0):
        quantiles.add(number)
    assert [quantiles.quantile(fraction) for fraction in (0.0, 0.2, 0.21, 0.5, 0.6, 1.0)] == [1, 1, 2, 3, 3, 5]
    assert (quantiles.count, quantiles.min, quantiles.max) == (5, 1.0, 5.0)


def test_without_numbers_there_is_no_quantile() -> None:
    quantiles = Quantiles()
    assert math.isnan(quantiles.quantile(0.5))


@pytest.mark.newest_python
@pytest.mark.parametrize("order", ["rising", "falling", "shuffled"])
def test_quantiles_of_a_million_numbers_are_as_exact_as_those_of_a_random_sample(order: str) -> None:
    numbers = [float(number) for number in range(1_000_000)]
    if order == "falling":
        numbers.reverse()
    elif order == "shuffled":
        random.Random(7).shuffle(numbers)
    quantiles = Quantiles()
    for number in numbers:
        quantiles.add(number)
    for fraction in (0.001, 0.01, 0.5, 0.95, 0.999):
        deviation = math.sqrt(fraction * (1.0 - fraction) / SIZE)
        assert quantiles.quantile(fraction) == pytest.approx(fraction * 1e6, abs=4e6 * deviation)
    assert (quantiles.min, quantiles.max) == (0.0, 999_999.0)


def test_as_many_numbers_as_are_kept_have_exact_quantiles() -> None:
    quantiles = Quantiles()
    for number in range(SIZE, 0, -1):
        quantiles.add(float(number))
    assert quantiles.quantile(0.5) == SIZE / 2


@pytest.mark.newest_python
def test_memory_is_bounded() -> None:
    quantiles = Quantiles()
    for _ in range(50 * SIZE):
        quantiles.add(0.0)
    assert len(quantiles._sample) == SIZE


def test_scaling_scales_every_quantile() -> None:
    quantiles = Quantiles()
    for number in range(100):
        quantiles.add(float(number))
    quantiles.scale(100.0)
    assert (quantiles.min, quantiles.quantile(0.5), quantiles.max) == (0.0, 4900.0, 9900.0)
