"""Plots as text."""

from __future__ import annotations

import math
import time
from typing import Iterator

import pytest

from robot_health_monitor.text_plot import text_plot


@pytest.fixture(autouse=True)
def _utc(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def test_a_falling_value_crosses_its_bound() -> None:
    samples = [(1000.0 + second, 31.0 - second) for second in range(12)]
    assert text_plot(samples, 25.0, 16) == [
        "31 |*",
        "   | *",
        "   |  *",
        "   |   *",
        "   |    *",
        "   |     *",
        "25 |------*-----",
        "   |       *",
        "   |        *",
        "   |         *",
        "   |          *",
        "20 |           *",
        "   +------------",
        "    00:16:40",
    ]


def test_the_axis_shows_begin_and_end() -> None:
    assert text_plot([(1000.0, 1.0), (1011.0, 2.0)], None, 23)[-1] == "   00:16:40    00:16:51"


def test_a_peak_of_one_sample_is_never_lost() -> None:
    samples = [(float(n), 100.0 if n == 777 else 0.0) for n in range(10_000)]
    lines = text_plot(samples, None, 30)
    assert lines[0] == "100 |  *"


def test_values_that_are_no_numbers_are_marked() -> None:
    assert text_plot([(0.0, 1.0), (1.0, math.nan), (2.0, 2.0)], None, 14)[12] == "  +-----x-----"
    assert text_plot([(0.0, math.nan)], None, 80) == ["no samples that are numbers"]


@pytest.mark.parametrize("values", [(5.0, 5.0), (-1.7e308, 1.7e308), (5e-324, 0.0), (1e15, 1e15 + 1)])
def test_any_range_can_be_plotted(values: tuple[float, float]) -> None:
    lines = text_plot([(0.0, values[0]), (1.0, values[1])], 3.0, 40)
    assert len(lines) == 14
    assert sum(line.count("*") for line in lines) >= 2


def test_one_sample_and_times_out_of_range_can_be_plotted() -> None:
    assert len(text_plot([(1e300, 1.0)], None, 40)) == 14
    assert len(text_plot([(5.0, 1.0), (4.0, 2.0)], None, 1)) == 14
