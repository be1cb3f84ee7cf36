"""Downsamples a signal in bounded memory, so that no extreme is lost: minimum and maximum per bucket of time."""

from __future__ import annotations

import math
from typing import Any, List, Tuple

import numpy as np


class Envelope:
    """A fixed number of buckets. When time passes their end, their width doubles and neighbours merge."""

    def __init__(self, start_s: float, span_s: float, buckets: int = 4096) -> None:
        """Starts empty.

        Args:
            start_s: begin of the first bucket, in s since 1970. Earlier samples go into the first bucket.
            span_s: expected time until the end, in s.
            buckets: how many; even.
        """
        self._start_s = start_s
        # The last sample of the span belongs to the last bucket.
        self._width_s = max(span_s, 1e-6) / buckets * (1.0 + 1e-9)
        self._low = np.full(buckets, math.inf)
        self._high = np.full(buckets, -math.inf)
        self._bad = np.zeros(buckets, dtype=bool)

    @property
    def width_s(self) -> float:
        """Width of a bucket, in s."""
        return self._width_s

    @property
    def start_s(self) -> float:
        """Begin of the first bucket, in s since 1970."""
        return self._start_s

    @property
    def columns(self) -> Tuple[List[int], List[float], List[float]]:
        """Number, smallest and largest value of each bucket that has valid samples, in the order of time."""
        places = np.flatnonzero(self._low <= self._high)
        return places.tolist(), self._low[places].tolist(), self._high[places].tolist()

    @property
    def bad_times_s(self) -> List[float]:
        """Middle of each bucket with bad samples, in s since 1970."""
        return [self._middle_s(at) for at in np.flatnonzero(self._bad).tolist()]

    def add(self, times_s: Any, values: Any) -> None:
        """Adds samples.

        Args:
            times_s: their times in s since 1970, an array of doubles.
            values: their values, an array of doubles of the same length; those that are not finite are left out.
        """
        good = np.isfinite(values)
        places, values = self._places(times_s[good]), values[good]
        if not len(places):
            return
        # Runs of samples in one bucket are reduced first: times rarely go back.
        starts = np.flatnonzero(np.diff(places, prepend=-1))
        np.minimum.at(self._low, places[starts], np.minimum.reduceat(values, starts))
        np.maximum.at(self._high, places[starts], np.maximum.reduceat(values, starts))

    def add_bad(self, times_s: Any) -> None:
        """Adds bad samples, which have no value; `times_s` as for `add`."""
        self._bad[self._places(times_s)] = True

    def _places(self, times_s: Any) -> Any:
        """Returns the bucket of each time; widens the buckets until there is one."""
        if not len(times_s):
            return np.empty(0, dtype=np.int64)
        since_s = times_s - self._start_s
        while float(since_s.max()) >= self._width_s * len(self._low):
            self._double()
        return np.clip((since_s / self._width_s).astype(np.int64), 0, len(self._low) - 1)

    def _double(self) -> None:
        half = len(self._low) // 2
        self._width_s *= 2.0
        for buckets, merge, empty in (
            (self._low, np.minimum, math.inf),
            (self._high, np.maximum, -math.inf),
            (self._bad, np.logical_or, False),
        ):
            buckets[:half] = merge(buckets[0::2], buckets[1::2])
            buckets[half:] = empty

    def _middle_s(self, place: int) -> float:
        return float(self._start_s + (place + 0.5) * self._width_s)
