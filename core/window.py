"""Statistics over a sliding window, in O(1) per sample (amortised), without drift.

Mean and standard deviation come from running sums of `value - reference`. Subtracting what leaves a sum adds a
rounding error each time, so the sums carry an estimate of that error; when it could matter they are made anew from
the window, with the mean as the new reference. That happens when the data moved far from the reference, and costs the
window's length each time that it moved by about its own spread: constant per sample, on the average.

Minimum and maximum come from two monotonic queues (Lemire, "Streaming maximum-minimum filter using no more than three
comparisons per element", 2006).
"""

from __future__ import annotations

import math
import sys
from collections import deque
from typing import Callable, Deque, Dict, Mapping, Optional

_EPSILON = sys.float_info.epsilon
_TOLERANCE = 1e-11
"""Relative error of the variance beyond which the sums are made anew."""


class Window:
    """The samples of the last `window_s` seconds, at most `window_samples` of them, and their statistics.

    A statistic is None while it is undefined: all of them without samples, `rate` and `frequency_hz` also with one
    sample or when no time has passed, and any whose value is no finite number.
    """

    __slots__ = (
        "_additions",
        "_largest_squares",
        "_maxima",
        "_minima",
        "_reference",
        "_squares",
        "_sum",
        "_times",
        "_values",
        "window_s",
        "window_samples",
    )

    _reference: float
    _sum: float
    _squares: float
    _largest_squares: float
    _additions: int

    def __init__(self, window_s: float, window_samples: int) -> None:
        """Makes an empty window.

        Args:
            window_s: a sample stays while it is not older than this before the newest one, in seconds.
            window_samples: the most samples it keeps; the oldest ones go first.
        """
        self.window_s = window_s
        self.window_samples = window_samples
        self.clear()

    def clear(self) -> None:
        """Forgets every sample."""
        self._times: Deque[float] = deque()
        self._values: Deque[float] = deque()
        self._minima: Deque[float] = deque()
        self._maxima: Deque[float] = deque()
        self._restart_sums(0.0)

    def __len__(self) -> int:
        return len(self._values)

    def add(self, value: float, now_s: float) -> None:
        """Takes a sample in and drops those that are too old.

        Args:
            value: a finite number.
            now_s: its time in seconds, not before that of the sample before.
        """
        times, values = self._times, self._values
        if not values:
            self._restart_sums(value)
        difference = value - self._reference
        self._sum += difference
        squares = self._squares = self._squares + difference * difference
        if not squares <= self._largest_squares:
            self._largest_squares = squares
        self._additions += 1
        times.append(now_s)
        values.append(value)

        minima, maxima = self._minima, self._maxima
        while minima and minima[-1] > value:
            minima.pop()
        minima.append(value)
        while maxima and maxima[-1] < value:
            maxima.pop()
        maxima.append(value)

        oldest_s = now_s - self.window_s
        while times[0] < oldest_s or len(times) > self.window_samples:
            times.popleft()
            left = values.popleft()
            difference = left - self._reference
            self._sum -= difference
            self._squares -= difference * difference
            if minima[0] == left:
                minima.popleft()
            if maxima[0] == left:
                maxima.popleft()

    def resize(self, window_s: float, window_samples: int) -> None:
        """Changes the window's limits and keeps the samples that still fit."""
        kept = list(zip(self._values, self._times))
        self.window_s = window_s
        self.window_samples = window_samples
        self.clear()
        for value, now_s in kept:
            self.add(value, now_s)

    def last(self) -> Optional[float]:
        """The newest value."""
        return self._values[-1] if self._values else None

    def min(self) -> Optional[float]:
        """The smallest value."""
        return self._minima[0] if self._minima else None

    def max(self) -> Optional[float]:
        """The largest value."""
        return self._maxima[0] if self._maxima else None

    def mean(self) -> Optional[float]:
        """The arithmetic mean."""
        if not self._values:
            return None
        if self._minima[0] == self._maxima[0]:
            return self._minima[0]
        self._settle_sums()
        mean = self._reference + self._sum / len(self._values)
        return mean if math.isfinite(mean) else self._exact_mean()

    def stddev(self) -> Optional[float]:
        """The population standard deviation."""
        if not self._values:
            return None
        if self._minima[0] == self._maxima[0]:
            return 0.0
        variance = self._settle_sums() / len(self._values)
        return math.sqrt(max(0.0, variance)) if math.isfinite(variance) else None

    def rate(self) -> Optional[float]:
        """Change per second from the oldest to the newest sample."""
        return self._per_second(self._values[-1] - self._values[0]) if self._values else None

    def frequency_hz(self) -> Optional[float]:
        """Arrivals per second from the oldest to the newest sample."""
        times = self._times
        span_s = times[-1] - times[0] if times else 0.0
        if span_s <= 0.0:
            return None
        frequency = (len(times) - 1) / span_s  # not by _per_second: it is asked per message
        return frequency if math.isfinite(frequency) else None

    def statistics(self) -> Dict[str, float]:
        """Returns every defined statistic by its name in the configuration."""
        found = {name: statistic(self) for name, statistic in STATISTIC_OF_WINDOW.items()}
        return {name: value for name, value in found.items() if value is not None}

    def _per_second(self, amount: float) -> Optional[float]:
        span_s = self._times[-1] - self._times[0]
        if span_s <= 0.0:
            return None
        result = amount / span_s
        return result if math.isfinite(result) else None

    def _settle_sums(self) -> float:
        """Makes the sums trustworthy and returns the sum of squared differences from the mean."""
        centred = self._squares - self._sum * self._sum / len(self._values)
        if _EPSILON * self._additions * self._largest_squares <= _TOLERANCE * centred:
            return centred
        self._restart_sums(self._exact_mean())
        differences = [value - self._reference for value in self._values]
        self._sum = sum(differences)
        self._squares = self._largest_squares = sum(difference * difference for difference in differences)
        return self._squares - self._sum * self._sum / len(self._values)

    def _restart_sums(self, reference: float) -> None:
        self._reference = reference
        self._sum = 0.0
        self._squares = 0.0
        self._largest_squares = 0.0
        self._additions = 0

    def _exact_mean(self) -> float:
        count = len(self._values)
        try:
            return math.fsum(self._values) / count
        except OverflowError:
            return math.fsum(value / count for value in self._values)


STATISTIC_OF_WINDOW: Mapping[str, Callable[[Window], Optional[float]]] = {
    "last": Window.last,
    "mean": Window.mean,
    "min": Window.min,
    "max": Window.max,
    "stddev": Window.stddev,
    "rate": Window.rate,
    "frequency_hz": Window.frequency_hz,
}
"""The statistics by their names in the configuration."""
