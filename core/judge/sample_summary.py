"""What a history stores of a signal's samples: a summary per 10 s.

The periods are those of the wall clock, and a sample belongs to the period of its arrival. A summary may be
taken in parts, at the end of a run or when time goes back: each holds what was collected since the last one.
"""

from __future__ import annotations

import math
from typing import List, NamedTuple, Optional

from ..values.model import Level

PERIOD_S = 10.0
"""Length of a period, in s."""
_MOST_PERIODS = 360
"""Periods that wait to be read; older ones are dropped."""
_ROUNDING_S = 1e-3


class SampleSummary(NamedTuple):
    """The samples of one signal in one period, or in a part of it."""

    start_s: float
    """Begin of the period, in s since 1970: a multiple of 10."""
    least: Optional[float]
    """Smallest value of the judged statistic, in its unit; None: it was never defined. Likewise the next three."""
    most: Optional[float]
    """Largest value."""
    mean: Optional[float]
    """Mean of the values, one per good sample."""
    last: Optional[float]
    """Latest value."""
    good: int
    """Number of good samples."""
    bad: int
    """Number of bad samples."""
    level: Level
    """The worst level."""


class _Period:
    """The samples since a period was read last."""

    __slots__ = ("bad", "count", "good", "largest", "last", "level", "mean", "number", "smallest")

    def __init__(self, number: int) -> None:
        self.number = number
        self.smallest = math.inf
        self.largest = -math.inf
        self.mean = 0.0
        self.last: Optional[float] = None
        self.count = self.good = self.bad = 0
        self.level: Optional[Level] = None

    def summary(self) -> Optional[SampleSummary]:
        """Returns what was observed; None: nothing, not even a level."""
        if self.level is None and not self.good + self.bad:
            return None
        start_s, level = self.number * PERIOD_S, self.level or Level.OK
        if self.last is None:
            return SampleSummary(start_s, None, None, None, None, self.good, self.bad, level)
        return SampleSummary(start_s, self.smallest, self.largest, self.mean, self.last, self.good, self.bad, level)


class WallClock:
    """What wall time is, by the monitor's clock; one for all signals of a monitor."""

    __slots__ = ("offset_s",)

    def __init__(self, offset_s: float) -> None:
        """`offset_s`: wall time, in s since 1970, minus the monitor's time."""
        self.offset_s = offset_s


class SampleCollector:
    """Collects the samples of one signal. Times (`now_s`) are the monitor's."""

    __slots__ = ("_begin_s", "_clock", "_end_s", "_open", "_waiting")

    def __init__(self, clock: WallClock) -> None:
        """Starts without a period; the owner of `clock` corrects it when the wall clock is set."""
        self._clock = clock
        self._waiting: List[SampleSummary] = []
        self._open = _Period(0)
        self._begin_s = self._end_s = math.inf
        """Between which times samples belong to the open period."""

    def note(self, value: Optional[float], now_s: float, *, good: bool = True) -> None:
        """Adds a sample, with the value of the judged statistic; None while it is undefined, or after a bad sample."""
        if not self._begin_s <= now_s < self._end_s:
            self._begin(now_s)
        period = self._open
        if not good:
            period.bad += 1
            return
        period.good += 1
        if value is not None:
            period.last = value
            if value < period.smallest:
                period.smallest = value
            if value > period.largest:
                period.largest = value
            period.count += 1
            period.mean += value / period.count - period.mean / period.count  # a difference could overflow

    def note_level(self, level: Level, now_s: float) -> None:
        """Notes the level that is shown, while it is known."""
        if not self._begin_s <= now_s < self._end_s:
            self._begin(now_s)
        if self._open.level is None or level.severity > self._open.level.severity:
            self._open.level = level

    def take(self, now_s: float) -> List[SampleSummary]:
        """Returns the periods that have ended and were not taken yet, oldest first; at infinity the open one too."""
        if now_s >= self._end_s or now_s < self._begin_s or now_s == math.inf:
            self._close()
        taken, self._waiting = self._waiting, []
        return taken

    def _begin(self, now_s: float) -> None:
        self._close()
        offset_s = self._clock.offset_s
        number = math.floor((now_s + offset_s) / PERIOD_S)
        self._open = _Period(number)
        self._begin_s, self._end_s = number * PERIOD_S - offset_s, (number + 1) * PERIOD_S - offset_s
        if not self._begin_s <= now_s < self._end_s:  # rounding
            self._begin_s, self._end_s = min(self._begin_s, now_s), max(self._end_s, now_s + _ROUNDING_S)

    def _close(self) -> None:
        summary = self._open.summary()
        self._open = _Period(0)
        self._begin_s = math.inf
        if summary is not None:
            self._waiting.append(summary)
            del self._waiting[:-_MOST_PERIODS]
