"""Statistics over a sliding window: amortised O(1) per sample, without drift, and read without side effects.

Theory of operation. Times and values are arrays: 16 bytes per sample, where a deque of floats takes 64. Samples that
have left stay at their start until there are more of them than are left.

Subtracting a sample that leaves from a running sum of floats adds rounding errors, and after a huge outlier the sum is
lost. So the sums are exact: every double is a whole multiple of a power of two, and the integers of Python have any
number of digits. A sample that leaves leaves no trace, nothing overflows, and a mean is rounded once.

The smallest and the largest value come from a queue of candidates: a sample joins it once, and removes those before it
that it makes superfluous. (Lemire, "Streaming maximum-minimum filter using no more than three comparisons per element",
2006.)

Sums and candidates are brought up to date when a statistic is read, which most signals need once per second or never.
The results do not depend on when that is.
"""

from __future__ import annotations

import math
import operator
from array import array
from bisect import bisect_left, bisect_right
from typing import Callable, Sequence, Tuple

Samples = Sequence[Tuple[float, float]]
"""(time in seconds, value), oldest first."""

_TIME_TOLERANCE_S = 1e-6
STATISTICS_OF_SAMPLES = ("last", "mean", "min", "max", "stddev", "rate", "frequency_hz")
"""The statistics that every window has: methods of the same names."""
LEAST_OF_LINE = 3
"""Samples that a rate needs."""
_DIGITS = 53
"""Binary digits of a double."""
_VALUE = operator.itemgetter(1)


class Sums:
    """Exact sums of a range of numbers x, of their squares, and of their products with numbers y, if there are any.

    They count units, or the squares of these: the unit is the largest power of two, at most 1, of which every number
    so far is a multiple.
    """

    def __init__(self, xs: Sequence[float], ys: Sequence[float] | None = None) -> None:
        """Starts with an empty range; only the ends of the sequences may change."""
        self._xs, self._ys = xs, ys
        self._begin = self._end = self._x = self._y = self._squares = self._products = 0
        self._per_unit = 1
        """The reciprocal of the unit."""

    def cover(self, begin: int) -> Sums:
        """Makes the range begin there, not before it did, and end with the sequences; returns the sums."""
        end = len(self._xs)
        for at in range(self._end, end):
            self._add(at, 1)
        for at in range(self._begin, begin):
            self._add(at, -1)
        self._begin, self._end = begin, end
        return self

    def _add(self, at: int, sign: int) -> None:
        """Adds the numbers of an index, or subtracts them if `sign` is -1."""
        x = self._in_units(self._xs[at])
        if self._ys is not None:
            y = self._in_units(self._ys[at])
            x = self._in_units(self._xs[at])  # the unit may have become smaller
            self._y += sign * y
            self._products += sign * x * y
        self._x += sign * x
        self._squares += sign * x * x

    def _in_units(self, number: float) -> int:
        """Returns a number as a multiple of the unit, which becomes as small as it requires."""
        numerator, denominator = number.as_integer_ratio()
        if denominator > self._per_unit:
            finer = denominator // self._per_unit
            self._per_unit = denominator
            self._x *= finer
            self._y *= finer
            self._squares *= finer * finer
            self._products *= finer * finer
        return numerator * (self._per_unit // denominator)

    def mean(self) -> float | None:
        """Returns the mean of x; None of no numbers."""
        count = self._end - self._begin
        return self._x / (count * self._per_unit) if count else None

    def stddev(self) -> float | None:
        """Returns the population standard deviation of x; None of no numbers."""
        count = self._end - self._begin
        if not count:
            return None
        squares, total = count * self._squares - self._x * self._x, count * self._per_unit
        try:
            return math.sqrt(squares) / total
        except OverflowError:
            return math.isqrt(squares << 2 * _DIGITS) / (total << _DIGITS)

    def slope(self) -> float | None:
        """Returns the slope of the least-squares line of y over x; None if it is vertical or too steep for a double."""
        count = self._end - self._begin
        squares, products = count * self._squares - self._x * self._x, count * self._products - self._x * self._y
        try:
            return products / squares if squares else None
        except OverflowError:
            return None


class Window:
    """The samples of the last `window_s` seconds, at most `window_samples` of them, and their statistics.

    A statistic is None while it is undefined: all of them without samples, `frequency_hz` also with one sample and
    `rate` with two, and both when no time has passed. `statistic`, for judging, also applies `window_min_s`.
    """

    __slots__ = (
        "_began_s", "_first", "_largest", "_smallest", "_sums", "_sums_of_line", "_times", "_values", "window_min_s",
        "window_s", "window_samples",
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
        self._began_s: float | None = None
        self._first = 0
        """Index of the oldest sample; those before it have left."""
        self._discard()

    def _discard(self) -> None:
        """Frees the samples that have left, and what the statistics know of them."""
        del self._times[: self._first]
        del self._values[: self._first]
        self._first = 0
        self._sums: Sums | None = None
        self._sums_of_line: Sums | None = None
        self._smallest: list[int] = []
        """Indices of the samples that may be the smallest."""
        self._largest: list[int] = []

    def __len__(self) -> int:
        return len(self._values) - self._first

    def add(self, value: float, now_s: float) -> None:
        """Adds a finite number and its time in s, not before that of the previous one; drops those that are too old."""
        if 3 * self._first > 2 * len(self._times):
            self._discard()
        times, first, oldest_s = self._times, self._first, now_s - self.window_s
        times.append(now_s)
        self._values.append(value)
        if self._began_s is None:
            self._began_s = now_s
        least = len(times) - self.window_samples
        while first < least or times[first] < oldest_s:
            first += 1
        self._first = first

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

    def statistic(self, name: str) -> float | None:
        """Returns a statistic to judge by its name in the configuration, None while it is undefined."""
        if name not in ("last", "count") and not self.is_long_enough:
            return None
        value: float | None = getattr(self, name)()
        return value

    def statistics(self) -> dict[str, float]:
        """Returns every statistic that can be computed, to show, by its name in the configuration."""
        values = {name: getattr(self, name)() for name in STATISTICS_OF_SAMPLES} if len(self) else {}
        return {name: value for name, value in values.items() if value is not None}

    def samples(self, limit: int, since_s: float = -math.inf) -> Samples:
        """Returns samples after a time.

        Of more samples than `limit`, which is at least 4, it returns the first, the last, and the smallest and largest
        of each of equal parts of the others.
        """
        begin = bisect_right(self._times, since_s, self._first)
        samples = list(zip(self._times[begin:], self._values[begin:]))
        if len(samples) <= limit:
            return samples
        first, *inner, last = samples
        size = math.ceil(len(inner) / ((limit - 2) // 2))
        parts = (inner[at : at + size] for at in range(0, len(inner), size))
        extremes = ({min(part, key=_VALUE), max(part, key=_VALUE)} for part in parts)
        return [first, *(each for pair in extremes for each in sorted(pair)), last]

    def last_s(self) -> float:
        """The time of the newest value, in seconds; NaN without one."""
        return self._times[-1] if self._values else math.nan

    def last(self) -> float | None:
        """The newest value."""
        return self._values[-1] if self._values else None

    def min(self) -> float | None:
        """The smallest value."""
        return self._best(self._smallest, operator.lt)

    def max(self) -> float | None:
        """The largest value."""
        return self._best(self._largest, operator.gt)

    def _best(self, candidates: list[int], is_better: Callable[[float, float], bool]) -> float | None:
        """Returns the value of which no other one is better; keeps the indices of those that may become it."""
        values = self._values
        if not len(self):
            return None
        for at in range(candidates[-1] + 1 if candidates else self._first, len(values)):
            while candidates and not is_better(values[candidates[-1]], values[at]):
                candidates.pop()
            candidates.append(at)
        del candidates[: bisect_left(candidates, self._first)]
        return values[candidates[0]]

    def mean(self) -> float | None:
        """The arithmetic mean."""
        return self._sums_of_values().mean()

    def stddev(self) -> float | None:
        """The population standard deviation."""
        return self._sums_of_values().stddev()

    def _sums_of_values(self) -> Sums:
        self._sums = self._sums or Sums(self._values)
        return self._sums.cover(self._first)

    def rate(self) -> float | None:
        """Slope of the least-squares line per second, as Prometheus's `deriv`; None also where it is no double."""
        if len(self) < LEAST_OF_LINE:
            return None
        self._sums_of_line = self._sums_of_line or Sums(self._times, self._values)
        return self._sums_of_line.cover(self._first).slope()

    def frequency_hz(self) -> float | None:
        """Arrivals per second from the oldest to the newest sample."""
        times = self._times
        span_s = times[-1] - times[self._first] if times else 0.0
        if span_s <= 0.0:
            return None
        frequency = (len(self) - 1) / span_s
        return frequency if math.isfinite(frequency) else None


class GapWindow(Window):
    """A window that also measures the gaps between arrivals, those of bad samples included."""

    def clear(self) -> None:
        """Removes every sample and every arrival."""
        super().clear()
        self._gaps = Window(self.window_s, self.window_samples)
        self._arrived = False

    def arrive(self, silence_s: float, now_s: float) -> None:
        """Notes the arrival of a sample, good or bad; the silence before the first one is no gap."""
        if self._arrived:
            self._gaps.add(silence_s, now_s)
        self._arrived = True

    def take_over(self, other: Window) -> None:
        """Adds the samples of another window, as `Window.take_over`, and its gaps if it knows them."""
        super().take_over(other)
        if isinstance(other, GapWindow):
            self._gaps.take_over(other._gaps)
            self._arrived = other._arrived

    def largest_gap_s(self) -> float | None:
        """The longest time before an arrival, in seconds."""
        return self._gaps.max()


class CountWindow(Window):
    """A window whose samples also leave as time passes: `count` is how many lie within the last `window_s` as of now.

    It holds one sample more than `window_samples`: then there are at least that many.
    """

    def __init__(self, window_s: float, window_samples: int) -> None:
        """Creates an empty window, whose count is 0."""
        super().__init__(window_s, window_samples + 1)

    def clear(self) -> None:
        """Removes every sample."""
        super().clear()
        self._now_s = self._from_s = -math.inf

    def add(self, value: float, now_s: float) -> None:
        """Adds a sample, as `Window.add`."""
        super().add(value, now_s)
        self.advance(now_s)

    def advance(self, now_s: float) -> None:
        """Advances the time: what is `window_s` old leaves."""
        self._now_s = now_s
        while len(self) and now_s - self._times[self._first] >= self.window_s - _TIME_TOLERANCE_S:
            self._first += 1

    def count_from(self, now_s: float) -> None:
        """Leaves the count undefined until `window_s` after `now_s`: what came before is not known."""
        self._now_s = self._from_s = now_s

    def leave_out(self, duration_s: float) -> None:
        """Leaves a duration out of the age of the samples: the robot could not be reached."""
        self._times[:] = array("d", [time_s + duration_s for time_s in self._times])
        self._sums_of_line = None
        self._from_s += duration_s

    def take_over(self, other: Window) -> None:
        """Adds the samples of another window, as `Window.take_over`."""
        super().take_over(other)
        if isinstance(other, CountWindow):
            self._from_s = other._from_s

    def count(self) -> float | None:
        """The number of samples."""
        is_known = self._now_s - self._from_s >= self.window_s - _TIME_TOLERANCE_S or self._from_s == -math.inf
        return float(len(self)) if is_known else None
