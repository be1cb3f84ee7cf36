"""Figures of a soak test, and whether a series is flat."""

from __future__ import annotations

import itertools
import statistics
from typing import NamedTuple, Sequence

_PAIRED = 300
"""Most points that are compared with one another."""


class Figure(NamedTuple):
    """One measured quantity."""

    name: str
    start: float
    end: float
    growth: float
    """Growth over the whole run, as the second half predicts it: the first half is warm-up."""
    allowed: float
    """Largest growth that counts as flat."""
    unit: str

    @property
    def is_met(self) -> bool:
        """Whether the quantity is flat."""
        return self.growth <= self.allowed


def flat(name: str, series: Sequence[tuple[float, float]], allowed: float, unit: str) -> Figure:
    """Returns the figure of a series of (time, value).

    The slope is that of Theil and Sen, the median of the slopes of all pairs, which ignores single outliers.
    """
    second_half = series[len(series) // 2 :]
    points = second_half[:: -(-len(second_half) // _PAIRED)]
    slopes = [(b - a) / (time_b - time_a) for (time_a, a), (time_b, b) in itertools.combinations(points, 2)]
    slope = statistics.median(slopes) if slopes else 0.0
    return Figure(name, series[0][1], series[-1][1], slope * (series[-1][0] - series[0][0]), allowed, unit)


def count(name: str, number: float, least: float) -> Figure:
    """Returns the figure of something that must have happened at least so often."""
    return Figure(name, 0, number, least - number, 0, "")


def table(figures: Sequence[Figure]) -> str:
    """Returns the figures as lines of text."""
    lines: list[str] = [f"{'':<36}{'start':>12}{'end':>12}{'growth':>10}{'allowed':>10}"]
    for name, start, end, growth, allowed, unit in figures:
        measured = f"{growth:>10.2f}{allowed:>10.2f}" if unit else f"{'':>20}"
        verdict = "" if growth <= allowed else "   NOT MET"
        lines.append(f"{name:<36}{start:>12.2f}{end:>12.2f}{measured} {unit}{verdict}")
    return "\n".join(lines)
