"""What a history stores of a signal's samples: a summary per 10 s.

The periods are those of the wall clock, and a sample belongs to the period of its arrival. A summary may be
taken in parts, at the end of a run or when time goes back: each holds what was collected since the last one.
"""

from __future__ import annotations

import math
from typing import Callable, NamedTuple

from ..values import Level

PERIOD_S = 10.0
"""Length of a period, in s."""
_MOST_PERIODS = 360
"""Periods that wait to be read; older ones are dropped."""
_ROUNDING_S = 1e-3


class SampleSummary(NamedTuple):
    """The samples of one signal in one period, or in a part of it."""

    start_s: float
    """Begin of the period, in s since 1970: a multiple of 10."""
    least: float | None
    """Smallest value of the judged statistic, in its unit; None if it was never defined. Likewise the next three."""
    most: float | None
    """Largest value."""
    mean: float | None
    """Mean of the values, one per good sample."""
    last: float | None
    """Latest value."""
    good: int
    """Number of good samples."""
    bad: int
    """Number of bad samples."""
    level: Level
    """The worst level."""


NO_SAMPLES = SampleSummary(0.0, None, None, None, None, 0, 0, Level.OK)


class SampleCollector:
    """Collects the samples of one signal. Times (`now_s`) are the monitor's."""

    __slots__ = (
        "_bad", "_begin_s", "_count", "_end_s", "_good", "_last", "_least", "_level", "_mean", "_most", "_number",
        "_waiting", "_wall_offset_s",
    )  # fmt: skip

    def __init__(self, wall_offset_s: Callable[[], float] | None = None) -> None:
        """Starts without a period; `wall_offset_s` returns the wall time, in s since 1970, minus the monitor's time.

        Without it, there is one endless period.
        """
        self._wall_offset_s = wall_offset_s or (lambda: 0.0)
        self._waiting: list[SampleSummary] = []
        self._end_s = math.inf
        self._clear()
        if wall_offset_s is None:
            self._begin_s = -math.inf

    def _clear(self) -> None:
        """Leaves no period open."""
        self._begin_s = math.inf
        """Between this and `_end_s`, samples belong to the open period, the one of this number."""
        self._number = self._count = self._good = self._bad = 0
        self._least, self._most, self._mean = math.inf, -math.inf, 0.0
        self._last: float | None = None
        self._level: Level | None = None

    def note(self, value: float | None, now_s: float, *, good: bool = True) -> None:
        """Adds a sample, with the value of the judged statistic; None while it is undefined, or after a bad sample."""
        if not self._begin_s <= now_s < self._end_s:
            self._begin(now_s)
        if not good:
            self._bad += 1
            return
        self._good += 1
        if value is not None:
            self._last = value
            if value < self._least:
                self._least = value
            if value > self._most:
                self._most = value
            self._count += 1
            self._mean += value / self._count - self._mean / self._count  # a difference could overflow

    def note_level(self, level: Level, now_s: float) -> None:
        """Notes the level that is shown, while it is known."""
        if not self._begin_s <= now_s < self._end_s:
            self._begin(now_s)
        if self._level is None or level.severity > self._level.severity:
            self._level = level

    def take(self, now_s: float) -> list[SampleSummary]:
        """Returns the periods that have ended and were not taken yet, oldest first; at infinity the open one too."""
        if now_s >= self._end_s or now_s < self._begin_s or now_s == math.inf:
            self._close()
        taken, self._waiting = self._waiting, []
        return taken

    def _begin(self, now_s: float) -> None:
        self._close()
        offset_s = self._wall_offset_s()
        self._number = number = math.floor((now_s + offset_s) / PERIOD_S)
        self._begin_s, self._end_s = number * PERIOD_S - offset_s, (number + 1) * PERIOD_S - offset_s
        if not self._begin_s <= now_s < self._end_s:  # rounding
            self._begin_s, self._end_s = min(self._begin_s, now_s), max(self._end_s, now_s + _ROUNDING_S)

    def _close(self) -> None:
        if self._level is not None or self._good + self._bad:
            start_s, level = self._number * PERIOD_S, self._level or Level.OK
            values = self._least, self._most, self._mean, self._last
            summary = SampleSummary(start_s, *values, self._good, self._bad, level)
            if self._last is None:
                summary = summary._replace(least=None, most=None, mean=None)
            self._waiting.append(summary)
            del self._waiting[:-_MOST_PERIODS]
        self._clear()
