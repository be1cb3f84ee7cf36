"""What a report keeps of one signal: its values in buckets of time that lose no extreme, and its levels."""

from __future__ import annotations

import math
from typing import Any, List, Mapping, Optional, Tuple

import numpy as np

from ...core.config.signal_config import SignalConfig
from ...core.values.formatting import printable, with_degree_sign
from ...core.values.model import Level, Status

MOST_LEVELS = 5000  # most changes of level in a plot


class Envelope:
    """Downsamples a signal to minimum and maximum per bucket of time, so that no extreme is lost.

    The number of buckets is fixed. When time passes their end, their width doubles and neighbours merge.
    """

    def __init__(self, start_s: float, span_s: float, buckets: int = 4096) -> None:
        """Starts empty, with an even number of buckets; `span_s` is the expected time until the end, in s.

        The first bucket begins at `start_s`, in s since 1970, and takes earlier samples, too.
        """
        self.start_s = start_s
        # Width of a bucket; the last sample of the span belongs to the last one.
        self.width_s = max(span_s, 1e-6) / buckets * (1.0 + 1e-9)
        self._low = np.full(buckets, math.inf)
        self._high = np.full(buckets, -math.inf)
        self._bad = np.zeros(buckets, dtype=bool)

    @property
    def columns(self) -> Tuple[List[int], List[float], List[float]]:
        """Number, smallest and largest value of each bucket that has valid samples, in the order of time."""
        places = np.flatnonzero(self._low <= self._high)
        return places.tolist(), self._low[places].tolist(), self._high[places].tolist()

    @property
    def bad_times_s(self) -> List[float]:
        """Middle of each bucket with bad samples, in s since 1970."""
        return [self.start_s + (at + 0.5) * self.width_s for at in np.flatnonzero(self._bad).tolist()]

    def add(self, times_s: Any, values: Any) -> None:
        """Adds samples: arrays of doubles, times in s since 1970; values that are not finite are left out."""
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
        since_s = times_s - self.start_s
        while float(since_s.max()) >= self.width_s * len(self._low):
            self._double()
        return np.clip((since_s / self.width_s).astype(np.int64), 0, len(self._low) - 1)

    def _double(self) -> None:
        half = len(self._low) // 2
        self.width_s *= 2.0
        for buckets, merge, empty in (
            (self._low, np.minimum, math.inf),
            (self._high, np.maximum, -math.inf),
            (self._bad, np.logical_or, False),
        ):
            buckets[:half] = merge(buckets[0::2], buckets[1::2])
            buckets[half:] = empty


class PlottedSignal(Envelope):
    """What the report keeps of one signal, in bounded memory: the values that the bounds apply to, and the levels."""

    def __init__(self, config: SignalConfig, file: str, start_s: float, span_s: float, buckets: int) -> None:
        """Starts empty, as `Envelope`; `file` names the configuration or the robot, if there are several."""
        super().__init__(start_s, span_s, buckets)
        self.config = config
        self.file = file
        self.levels: List[Tuple[float, str]] = []  # begin of each announced level, since 1970; empty: unknown
        self._first_s = math.inf

    def add_samples(self, times_s: Any, values: Any, bad_times_s: Any) -> None:
        """Adds samples: `add` for those with a value, `add_bad` for bad ones."""
        for times in (times_s, bad_times_s):
            if len(times):
                self._first_s = min(self._first_s, float(times[0]))
        self.add(times_s, values)
        self.add_bad(bad_times_s)

    def add_bands(self, starts_s: Any, seconds: Any, low: Any, high: Any) -> None:
        """Adds ranges of values, each for some seconds from its start on; arrays of doubles."""
        if not len(starts_s):
            return
        self._first_s = min(self._first_s, float(starts_s[0]))
        counts = np.maximum(np.ceil(seconds / self.width_s), 1.0).astype(np.int64)
        steps = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        times_s = np.repeat(starts_s, counts) + (steps + 0.5) * np.repeat(seconds / counts, counts)
        self.add(times_s, np.repeat(low, counts))
        self.add(times_s, np.repeat(high, counts))

    def add_gap(self, begin_s: float, end_s: float) -> None:
        """Adds a time that is not recorded, in s since 1970; samples before it must have been added."""
        if self.levels or self._first_s < begin_s:
            level = self.levels[-1][1] if self.levels else Level.OK.name
            self.add_level(begin_s, "")
            self.add_level(end_s, level)

    def add_level(self, wall_s: float, level: str) -> None:
        """Adds a change of the announced level, at a time in s since 1970."""
        if len(self.levels) < MOST_LEVELS:
            self.levels.append((wall_s, level))
        elif self.levels[-1][1]:
            self.levels.append((wall_s, ""))

    @property
    def shown_levels(self) -> List[Tuple[float, str]]:
        """The levels, with OK from the first sample until the first of them."""
        first_s = self._first_s
        if first_s == math.inf or (self.levels and self.levels[0][0] <= first_s):
            return self.levels
        return [(first_s, Level.OK.name), *self.levels]


def line_ahead(alert: str, wall_s: float, status: Status) -> Optional[Mapping[str, Any]]:
    """Returns the line of a forecast as the plot takes it: from the latest value on; None without a forecast.

    `alert` is the id of the alert that it gave, `wall_s` the time of its newest sample, in s since 1970.
    """
    if status.forecast is None or "last" not in status.values:
        return None
    value, _, horizon_s, meets_s, bound = status.forecast
    return {
        "id": alert,
        "from": [round(wall_s, 3), float(status.values["last"])],
        "to": [round(wall_s + horizon_s, 3), value],
        "meets": None if meets_s is None or meets_s > horizon_s else [round(wall_s + meets_s, 3), bound],
        "text": printable(with_degree_sign(status.outlook)),
    }
