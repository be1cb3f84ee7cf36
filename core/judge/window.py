"""Statistics over a sliding window: amortised O(1) per sample, without drift, and read without side effects.

Theory of operation. Subtracting a sample that leaves from a running sum adds rounding errors, and after an infinity or
a huge outlier the sum is lost. So nothing is ever subtracted. The window is a queue of two parts (Tangwongsan et al.,
"Low-latency sliding-window aggregation in worst-case constant time", 2017, describe it as two stacks):

    oldest sample                                                     newest sample
    | front: one aggregate per sample, of it and all newer ones of the front | back: one running aggregate |

A new sample updates the back's aggregate. A sample that leaves drops its aggregate from the front. When the front is
empty, the whole back becomes the new front, in one pass. Each sample takes part in one such pass. The statistics
combine the front's current aggregate with the back's.

Times and values are arrays: 16 bytes per sample, where a deque of floats takes 64. Samples that have left stay at their
start until the front is empty.

Aggregates are computed when a statistic is read, which most signals need once per second or never. The results do not
depend on when that is: which samples are the front follows from the samples alone.

An aggregate holds minimum, maximum, and the sums of the distances, and squared distances, to a reference: a sample
that belongs to the aggregate, so that the sums lose few digits. Where squares would overflow, distances are scaled.
"""

from __future__ import annotations

import math
import sys
from array import array
from bisect import bisect_right
from dataclasses import dataclass
from itertools import accumulate
from operator import mul
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

from .least_squares import LineSums

Samples = Sequence[Tuple[float, float]]
"""(time in seconds, value), oldest first."""

_LARGEST = sys.float_info.max
_LARGEST_DISTANCE = 1e150
"""A million squares of it are still a double."""
_SCALE = 2.0**-600
"""Makes the distance between any two doubles smaller than `_LARGEST_DISTANCE`."""
_TIME_TOLERANCE_S = 1e-6
LEAST_OF_LINE = 3
"""Samples that a rate needs."""


@dataclass
class _Front:
    """Aggregates of the front: entry n is that of its newest n + 1 samples."""

    reference: float
    scaled: int
    """Sums and squares are scaled from this entry on."""
    sums: Sequence[float]
    squares: Sequence[float]
    smallest: Sequence[float]
    largest: Sequence[float]


class Window:
    """The samples of the last `window_s` seconds, at most `window_samples` of them, and their statistics.

    A statistic is None while it is undefined: all of them without samples, `frequency_hz` also with one sample and
    `rate` with two, and both when no time has passed. `statistic`, for judging, also applies `window_min_s`.
    """

    __slots__ = (
        "_back", "_back_max", "_back_min", "_back_reference", "_back_scale", "_back_squares", "_back_sum", "_began_s",
        "_built", "_first", "_front", "_in_sums", "_sums", "_times", "_values", "window_min_s", "window_s",
        "window_samples",
    )  # fmt: skip

    _back_min: float
    _back_max: float
    _sums: Optional[LineSums]
    """Those of `rate`; None until it is read."""

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
        self._front = 0
        """How many samples of the front are left."""
        self._built: Optional[_Front] = None
        self._clear_back()

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
            if not self._front:
                self._flip()
                first = 0
            first += 1
            self._front -= 1
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
        return self._extremes()[0] if self._values else None

    def max(self) -> Optional[float]:
        """The largest value."""
        return self._extremes()[1] if self._values else None

    def mean(self) -> Optional[float]:
        """The arithmetic mean."""
        if not self._values:
            return None
        smallest, largest = self._extremes()
        if smallest == largest:
            return smallest
        mean, _, scale = self._moments()
        # Rounding must not carry it beyond the samples, nor beyond the doubles.
        return min(max(mean / scale, smallest), largest)

    def stddev(self) -> Optional[float]:
        """The population standard deviation."""
        if not self._values:
            return None
        smallest, largest = self._extremes()
        if smallest == largest:
            return 0.0
        _, variance, scale = self._moments()
        return min(math.sqrt(variance) / scale, _LARGEST)

    def rate(self) -> Optional[float]:
        """Slope of the least-squares line per second, as Prometheus's `deriv`; None also where it is no double."""
        times, values, sums = self._times, self._values, self._sums
        count, back = len(self), self._first + self._front
        if count < LEAST_OF_LINE:
            return None
        if sums is None or (sums.front and not self._front):  # its reference has left
            sums, self._in_sums = LineSums(), 0
            sums.flip(times[self._first : back], values[self._first : back])
            self._sums = sums
        sums.front = self._front
        for at in range(back + self._in_sums, len(values)):
            sums.add(values[at], times[at])
        self._in_sums = len(values) - back
        _, _, squares, products = sums.moments(count, times[-1])
        rate = products / squares if squares > 0.0 else math.nan
        return rate if math.isfinite(rate) else None

    def frequency_hz(self) -> Optional[float]:
        """Arrivals per second from the oldest to the newest sample."""
        times = self._times
        span_s = times[-1] - times[self._first] if times else 0.0
        if span_s <= 0.0:
            return None
        frequency = (len(self) - 1) / span_s
        return frequency if math.isfinite(frequency) else None

    def _flip(self) -> None:
        """Makes the back the front, which is empty."""
        del self._times[: self._first]
        del self._values[: self._first]
        self._first = 0
        self._front = len(self._times)
        self._built = None
        self._clear_back()

    def _clear_back(self) -> None:
        self._back = 0
        self._back_reference = math.nan
        self._back_scale = 1.0
        self._back_sum = 0.0
        self._back_squares = 0.0
        self._back_min = math.inf
        self._back_max = -math.inf
        self._sums = None
        self._in_sums = 0
        """How many samples of the back they hold."""

    def _extremes(self) -> Tuple[float, float]:
        """Returns the smallest and the largest value, and brings the aggregates up to date. Not without samples."""
        values, front = self._values, self._front
        new = len(values) - self._first - front - self._back
        if new == 1:
            self._add_to_back(values[-1])
        elif new:
            for value in values[-new:]:
                self._add_to_back(value)
        smallest, largest = self._back_min, self._back_max
        if front:
            built = self._built or self._build_front()
            front_min, front_max = built.smallest[front - 1], built.largest[front - 1]
            smallest = front_min if front_min < smallest else smallest
            largest = front_max if front_max > largest else largest
        return smallest, largest

    def _add_to_back(self, value: float) -> None:
        self._back += 1
        distance = value * self._back_scale - self._back_reference
        if not -_LARGEST_DISTANCE < distance < _LARGEST_DISTANCE:  # NaN: the back is empty
            distance = self._rescale_back(value)
        self._back_sum += distance
        self._back_squares += distance * distance
        if value < self._back_min:
            self._back_min = value
        if value > self._back_max:
            self._back_max = value

    def _rescale_back(self, value: float) -> float:
        """Makes the first sample the reference, and scales the aggregate before a distance too large to be squared.

        Returns the distance of `value`, scaled.
        """
        if math.isnan(self._back_reference):
            self._back_reference = value
            return 0.0
        if self._back_scale == 1.0:
            self._back_scale = _SCALE
            self._back_reference *= _SCALE
            self._back_sum *= _SCALE
            self._back_squares = self._back_squares * _SCALE * _SCALE
        return value * _SCALE - self._back_reference

    def _build_front(self) -> _Front:
        """Computes the front's aggregates: of every sample and all newer ones of the front."""
        newest_first = self._values[self._first : self._first + self._front]
        newest_first.reverse()
        reference = newest_first[0]
        distances = [value - reference for value in newest_first]
        sums = array("d", accumulate(distances))
        squares = array("d", accumulate(map(mul, distances, distances)))
        scaled = len(distances)
        if not -_LARGEST_DISTANCE < min(distances) <= max(distances) < _LARGEST_DISTANCE:
            scaled = next(at for at, each in enumerate(distances) if not -_LARGEST_DISTANCE < each < _LARGEST_DISTANCE)
            small = [value * _SCALE - reference * _SCALE for value in newest_first]
            sums[scaled:] = array("d", accumulate(small))[scaled:]
            squares[scaled:] = array("d", accumulate(map(mul, small, small)))[scaled:]
        smallest, largest = array("d", accumulate(newest_first, min)), array("d", accumulate(newest_first, max))
        self._built = _Front(reference, scaled, sums, squares, smallest, largest)
        return self._built

    def _moments(self) -> Tuple[float, float, float]:
        """Returns mean and variance of the values times a scale, and the scale; call `_extremes` before.

        Source: Chan, Golub and LeVeque, "Updating formulae and a pairwise algorithm", 1979.
        """
        front, back, built = self._front, self._back, self._built
        scale = back_scale = self._back_scale
        front_mean = front_squares = back_mean = back_squares = apart = 0.0
        if front and built:
            front_scale = _SCALE if front > built.scaled else 1.0
            scale = min(scale, front_scale)
            factor = scale / front_scale
            total = built.sums[front - 1] * factor
            front_mean = total / front
            front_squares = built.squares[front - 1] * factor * factor - total * front_mean
            back_reference = front_reference = built.reference * scale
            back_mean = front_mean
        if back:
            factor = scale / back_scale
            total = self._back_sum * factor
            back_mean = total / back
            back_squares = self._back_squares * factor * factor - total * back_mean
            back_reference = self._back_reference * factor
        count = front + back
        if front and back:
            # The references first: their difference is exact where they are close; sums with the means are not.
            apart = (front_reference - back_reference) + (front_mean - back_mean)
        squares = apart * apart * front * back / count
        if front_squares > 0.0:
            squares += front_squares
        if back_squares > 0.0:
            squares += back_squares
        return back_reference + back_mean + apart * front / count, squares / count, scale


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

    __slots__ = ("_from_s", "_now_s")

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
            if not self._front:
                self._flip()
            self._first += 1
            self._front -= 1

    def count_from(self, now_s: float) -> None:
        """Leaves the count undefined until `window_s` after `now_s`: what came before is not known."""
        self._now_s = self._from_s = now_s

    def leave_out(self, duration_s: float) -> None:
        """Leaves a duration out of the age of the samples: the robot could not be reached."""
        self._times = array("d", [time_s + duration_s for time_s in self._times])
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

    def statistics(self) -> Dict[str, float]:
        """Returns the statistics of the samples, none if there are none."""
        return super().statistics() if len(self) else {}


STATISTIC_OF_WINDOW: Mapping[str, Callable[[Window], Optional[float]]] = {
    "last": Window.last, "mean": Window.mean, "min": Window.min, "max": Window.max, "stddev": Window.stddev,
    "rate": Window.rate, "frequency_hz": Window.frequency_hz,
}  # fmt: skip
"""The statistics by their names in the configuration."""
