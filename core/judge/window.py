"""Statistics over a sliding window: amortised O(1) per sample, without drift, and read without side effects.

Theory of operation. Subtracting a sample that leaves from a running sum adds rounding errors, and after a huge outlier
the sum is lost. So nothing is ever subtracted. The window is a queue of two parts (Tangwongsan et al., "Low-latency
sliding-window aggregation in worst-case constant time", 2017, describe it as two stacks):

    oldest sample                                                     newest sample
    | front: one aggregate per sample, of it and all newer ones of the front | back: one running aggregate |

A new sample updates the back's aggregate. A sample that leaves drops its aggregate from the front. When the front is
empty, the whole back becomes the new front, in one pass. Each sample takes part in one such pass. The aggregates are
those of moments.py.

Times and values are arrays: 16 bytes per sample, where a deque of floats takes 64. Samples that have left stay at their
start until the front is empty.

Aggregates are computed when a statistic is read, which most signals need once per second or never. The results do not
depend on when that is: which samples are the front follows from the samples alone.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_right
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from .moments import Sums

Samples = Sequence[Tuple[float, float]]
"""(time in seconds, value), oldest first."""

_TIME_TOLERANCE_S = 1e-6
LEAST_OF_LINE = 3
"""Samples that a rate needs."""


class Window:
    """The samples of the last `window_s` seconds, at most `window_samples` of them, and their statistics.

    A statistic is None while it is undefined: all of them without samples, `frequency_hz` also with one sample and
    `rate` with two, both when no time has passed, and each where it, or a sum that it needs, is no double. `statistic`,
    for judging, also applies `window_min_s`.
    """

    __slots__ = (
        "_began_s", "_first", "_front", "_sums", "_times", "_values", "window_min_s", "window_s", "window_samples",
    )  # fmt: skip

    def __init__(self, window_s: float, window_samples: int, window_min_s: float = 0.0) -> None:
        """Creates an empty window; samples must come for `window_min_s` before any statistic but `last` is defined."""
        self.window_s = window_s
        self.window_samples = window_samples
        self.window_min_s = window_min_s
        self.clear()

    def clear(self) -> None:
        """Removes every sample."""
        self._times = array("d")
        self._values = array("d")
        self._first = 0
        """Index of the oldest sample; those before it have left."""
        self._began_s: Optional[float] = None
        self._front = 1
        """How many samples of the front are left; without samples, the first one will be the front."""
        self._sums: Optional[Sums] = None
        """The aggregates of the front and of the back, as far as they were read; None until they are."""

    def __len__(self) -> int:
        return len(self._values) - self._first

    def add(self, value: float, now_s: float) -> None:
        """Adds a finite number and its time in s, not before that of the previous one; drops those that are too old."""
        times = self._times
        times.append(now_s)
        self._values.append(value)
        if self._began_s is None:
            self._began_s = now_s
        oldest_s = now_s - self.window_s
        first = self._first
        while times[first] < oldest_s or len(times) - first > self.window_samples:
            first += 1
            self._front -= 1
            if not self._front:
                first = self._flip(first)
        self._first = first

    def leave(self, oldest_s: float) -> None:
        """Drops the samples that are older."""
        while len(self) and self._times[self._first] < oldest_s:
            self._first += 1
            self._front -= 1
            if not self._front:
                self._first = self._flip(self._first)

    def _flip(self, first: int) -> int:
        """Makes the back the front, which is used up; returns the index of the oldest sample."""
        del self._times[:first], self._values[:first]
        self._front, self._sums = len(self._times) or 1, None
        if not self._times:
            self._began_s = None
        return 0

    def begin_anew(self) -> None:
        """Counts `window_min_s` from the next sample on: there was a gap. The samples stay."""
        self._began_s = None

    def leave_out(self, duration_s: float) -> None:
        """Leaves a duration out of `window_min_s`: the robot could not be reached."""
        if duration_s > self.window_s:
            self.begin_anew()  # it holds nothing from before
        elif self._began_s is not None:
            self._began_s += duration_s

    def take_over(self, other: Window) -> None:
        """Adds the samples of another window, as far as they fit into this empty one."""
        for value, now_s in zip(other._values[other._first :], other._times[other._first :]):
            self.add(value, now_s)
        self._began_s = other._began_s

    @property
    def is_long_enough(self) -> bool:
        """Whether samples have come for `window_min_s`."""
        began_s = self._began_s
        return began_s is not None and self._times[-1] - began_s >= self.window_min_s - _TIME_TOLERANCE_S

    def statistic(self, name: str) -> Optional[float]:
        """Returns a statistic to judge by its name in the configuration, None while it is undefined."""
        if name != "last" and not self.is_long_enough:
            return None
        return STATISTIC_OF_WINDOW[name](self)

    def arrive(self, silence_s: float, now_s: float) -> None:
        """Notes the arrival of a sample, good or bad, after a silence; only a `GapWindow` keeps it."""

    def statistics(self) -> Dict[str, float]:
        """Returns every statistic that can be computed, to show, by its name in the configuration."""
        found = {name: statistic(self) for name, statistic in STATISTIC_OF_WINDOW.items()}
        return {name: value for name, value in found.items() if value is not None}

    def samples(self, limit: int, since_s: float = -math.inf) -> Samples:
        """Returns samples after a time.

        Of more samples than `limit`, which is at least 4, it returns the first, the last, and the smallest and largest
        of each of equal parts of the others.
        """
        begin = bisect_right(self._times, since_s, self._first)
        samples = list(zip(self._times[begin:], self._values[begin:]))
        if len(samples) <= limit:
            return samples
        inner, parts = len(samples) - 2, (limit - 2) // 2
        values = [value for _, value in samples]
        chosen: List[Tuple[float, float]] = [samples[0]]
        for part in range(parts):
            places = range(1 + part * inner // parts, 1 + (part + 1) * inner // parts)
            extremes = {min(places, key=values.__getitem__), max(places, key=values.__getitem__)}
            chosen.extend(samples[place] for place in sorted(extremes))
        return [*chosen, samples[-1]]

    def last_s(self) -> float:
        """The time of the newest value, in seconds; NaN without one."""
        return self._times[-1] if self._values else math.nan

    def last(self) -> Optional[float]:
        """The newest value."""
        return self._values[-1] if self._values else None

    def min(self) -> Optional[float]:
        """The smallest value."""
        return self._read().smallest(self._front) if self._values else None

    def max(self) -> Optional[float]:
        """The largest value."""
        return self._read().largest(self._front) if self._values else None

    def mean(self) -> Optional[float]:
        """The arithmetic mean."""
        if not self._values:
            return None
        sums, front = self._read(), self._front
        mean = sums.mean(front)
        # Rounding must not carry it beyond the samples.
        return min(max(mean, sums.smallest(front)), sums.largest(front)) if math.isfinite(mean) else None

    def stddev(self) -> Optional[float]:
        """The population standard deviation."""
        if not self._values:
            return None
        variance = self._read().variance(self._front)
        return math.sqrt(max(variance, 0.0)) if math.isfinite(variance) else None

    def rate(self) -> Optional[float]:
        """Slope of the least-squares line per second, as Prometheus's `deriv`."""
        if len(self) < LEAST_OF_LINE:
            return None
        _, slope = self.line(0.0)
        return slope if math.isfinite(slope) else None

    def frequency_hz(self) -> Optional[float]:
        """Arrivals per second from the oldest to the newest sample."""
        times = self._times
        span_s = times[-1] - times[self._first] if times else 0.0
        if span_s <= 0.0:
            return None
        frequency = (len(self) - 1) / span_s
        return frequency if math.isfinite(frequency) else None

    def line(self, ahead_s: float, now_s: Optional[float] = None) -> Tuple[float, float]:
        """Returns the value of the least-squares line `ahead_s` after `now_s`, and its slope per s; NaN: undefined.

        Without `now_s`, the time is that of the newest sample. Not without samples.
        """
        return self._read().line(self._front, self._times[-1] if now_s is None else now_s, ahead_s)

    def _read(self) -> Sums:
        """Returns the aggregates, up to date."""
        times, values, back, sums = self._times, self._values, self._first + self._front, self._sums
        if sums is None:
            sums = self._sums = Sums(times[self._first : back], values[self._first : back])
        for at in range(back + sums.in_back, len(values)):
            sums.add(times[at], values[at])
        return sums


class GapWindow(Window):
    """A window that also measures the gaps between arrivals, those of bad samples included."""

    __slots__ = ("_arrived", "_gaps")

    def clear(self) -> None:
        """Removes every sample and every arrival."""
        super().clear()
        self._gaps = Window(self.window_s, self.window_samples)
        self._arrived = False

    def arrive(self, silence_s: float, now_s: float) -> None:
        """Notes an arrival; the silence before the first one is no gap."""
        if self._arrived:
            self._gaps.add(silence_s, now_s)
        self._arrived = True

    def take_over(self, other: Window) -> None:
        """Adds the samples of another window, as `Window.take_over`, and its gaps if it knows them."""
        super().take_over(other)
        if isinstance(other, GapWindow):
            self._gaps.take_over(other._gaps)
            self._arrived = other._arrived

    def statistic(self, name: str) -> Optional[float]:
        """Returns a statistic to judge, as `Window.statistic`."""
        if name != "largest_gap_s":
            return super().statistic(name)
        return self._gaps.max() if self.is_long_enough else None


class CountWindow(Window):
    """A window whose samples also leave as time passes: `count` is how many lie within the last `window_s` as of now.

    It holds one sample more than `window_samples`: then there are at least that many.
    """

    __slots__ = ("_from_s", "_latest", "_now_s")

    def __init__(self, window_s: float, window_samples: int) -> None:
        """Creates an empty window, whose count is 0."""
        super().__init__(window_s, window_samples + 1)

    def clear(self) -> None:
        """Removes every sample."""
        super().clear()
        self._now_s = self._from_s = -math.inf
        self._latest: Optional[float] = None

    def add(self, value: float, now_s: float) -> None:
        """Adds a sample, as `Window.add`."""
        super().add(value, now_s)
        self._latest = value
        self.advance(now_s)

    def last(self) -> Optional[float]:
        """The newest value, also when it has left."""
        return self._latest

    def advance(self, now_s: float) -> None:
        """Advances the time: what is `window_s` old leaves."""
        self._now_s = now_s
        self.leave(now_s - self.window_s + _TIME_TOLERANCE_S)

    def count_from(self, now_s: float) -> None:
        """Leaves the count undefined until `window_s` after `now_s`: what came before is not known."""
        self._now_s = self._from_s = now_s

    def leave_out(self, duration_s: float) -> None:
        """Leaves a duration out of the age of the samples: the robot could not be reached."""
        self._times, self._sums = array("d", [time_s + duration_s for time_s in self._times]), None
        self._from_s += duration_s

    def take_over(self, other: Window) -> None:
        """Adds the samples of another window, as `Window.take_over`."""
        super().take_over(other)
        if isinstance(other, CountWindow):
            self._from_s = other._from_s

    def statistic(self, name: str) -> Optional[float]:
        """Returns the count, as `Window.statistic`."""
        is_known = self._now_s - self._from_s >= self.window_s - _TIME_TOLERANCE_S or self._from_s == -math.inf
        return float(len(self)) if is_known else None


STATISTIC_OF_WINDOW: Mapping[str, Callable[[Window], Optional[float]]] = {
    "last": Window.last, "mean": Window.mean, "min": Window.min, "max": Window.max, "stddev": Window.stddev,
    "rate": Window.rate, "frequency_hz": Window.frequency_hz,
}  # fmt: skip
"""The statistics by their names in the configuration."""
