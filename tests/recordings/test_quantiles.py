"""Quantiles of streams: exact while they fit into a buffer, then within the documented error; always the same."""

from __future__ import annotations

import math
import random

import pytest

pytest.importorskip("numpy")

import numpy as np

from robot_health_monitor.recordings.quantiles import SIZE, Quantiles


def test_a_few_numbers_have_exact_quantiles() -> None:
    quantiles = Quantiles()
    quantiles.add(np.array([5.0, 1.0, 4.0]))
    quantiles.add(np.array([2.0, 3.0]))
    assert [quantiles.quantile(fraction) for fraction in (0.0, 0.2, 0.21, 0.5, 0.6, 1.0)] == [1, 1, 2, 3, 3, 5]
    assert (quantiles.count, quantiles.min, quantiles.max) == (5, 1.0, 5.0)


def test_without_numbers_there_is_no_quantile() -> None:
    quantiles = Quantiles()
    quantiles.add(np.empty(0))
    assert math.isnan(quantiles.quantile(0.5))


@pytest.mark.parametrize("order", ["rising", "falling", "shuffled", "in chunks of different sizes"])
def test_a_million_numbers_have_quantiles_within_0_02_percent_of_the_ranks(order: str) -> None:
    numbers = np.arange(1_000_000, dtype=np.float64)
    if order == "falling":
        numbers = numbers[::-1]
    elif order != "rising":
        np.random.RandomState(7).shuffle(numbers)
    quantiles, chance, place = Quantiles(), random.Random(1), 0
    while place < len(numbers):
        size = chance.randint(1, 3 * SIZE) if order.startswith("in") else 4096
        quantiles.add(numbers[place : place + size])
        place += size
    for fraction in (0.001, 0.01, 0.5, 0.95, 0.999):
        assert quantiles.quantile(fraction) == pytest.approx(fraction * 1e6, abs=200)
    assert (quantiles.min, quantiles.max) == (0.0, 999_999.0)


def test_memory_is_bounded() -> None:
    quantiles = Quantiles()
    for _ in range(300):
        quantiles.add(np.zeros(SIZE))
    assert sum(len(buffer) for buffer in quantiles._buffers) <= 10 * SIZE


def test_scaling_scales_every_quantile() -> None:
    quantiles = Quantiles()
    quantiles.add(np.arange(100.0))
    quantiles.scale(100.0)
    assert (quantiles.min, quantiles.quantile(0.5), quantiles.max) == (0.0, 4900.0, 9900.0)
