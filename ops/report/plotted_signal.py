"""What a report keeps of one signal: its values in buckets of time that lose no extreme, and its levels."""

from __future__ import annotations

import math

from ...core.config import SignalConfig
from ...core.values import JsonObject, Level, Status, printable, with_degree_sign

MOST_LEVELS = 5000  # most changes of level in a plot


class PlottedSignal:
    """The values that the bounds of one signal apply to, and its levels, in bounded memory.

    Values are kept as minimum and maximum per bucket of time. Times are in s since 1970.
    """

    def __init__(self, config: SignalConfig, file: str, start_s: float, span_s: float, buckets: int = 4096) -> None:
        """Starts empty. The first bucket begins at `start_s` and takes earlier values too, the last one later values.

        `span_s` is the time until the end, in s; `file` names the configuration or the robot, if there are several.
        """
        self.config = config
        self.file = file
        self.start_s = start_s
        # Width of a bucket; the last sample of the span belongs to the last one.
        self.width_s = max(span_s, 1e-6) / buckets * (1.0 + 1e-9)
        self.levels: list[tuple[float, str]] = []
        """Begin of each announced level, OK from the first sample on; empty if they are unknown."""
        self._buckets = buckets
        self._ranges: dict[int, tuple[float, float]] = {}
        """Smallest and largest value of each bucket that has any, by its number."""
        self._bad: set[int] = set()
        """Numbers of the buckets with bad samples."""

    @property
    def columns(self) -> tuple[list[int], list[float], list[float]]:
        """Number, smallest and largest value of each bucket that has valid samples, in the order of time."""
        places = sorted(self._ranges)
        return places, [self._ranges[place][0] for place in places], [self._ranges[place][1] for place in places]

    @property
    def bad_times_s(self) -> list[float]:
        """Middle of each bucket with bad samples."""
        return [self.start_s + (place + 0.5) * self.width_s for place in sorted(self._bad)]

    def add(self, time_s: float, value: float | None) -> None:
        """Adds a good sample; the value is None while it is undefined."""
        self._begin(time_s)
        if value is not None:
            self._extend(self._place(time_s), value, value)

    def add_bad(self, time_s: float) -> None:
        """Adds a bad sample, which has no value."""
        self._begin(time_s)
        self._bad.add(self._place(time_s))

    def add_band(self, start_s: float, seconds: float, low: float, high: float) -> None:
        """Adds a range of values, for some seconds from its start on."""
        self._begin(start_s)
        steps = max(1, math.ceil(seconds / self.width_s))
        for step in range(steps):
            self._extend(self._place(start_s + (step + 0.5) * seconds / steps), low, high)

    def _begin(self, time_s: float) -> None:
        if not self.levels:
            self.add_level(time_s, Level.OK.name)

    def _place(self, time_s: float) -> int:
        """Returns the bucket of a time."""
        return min(max(int((time_s - self.start_s) / self.width_s), 0), self._buckets - 1)

    def _extend(self, place: int, low: float, high: float) -> None:
        if math.isfinite(low) and math.isfinite(high):
            known_low, known_high = self._ranges.get(place, (low, high))
            self._ranges[place] = min(low, known_low), max(high, known_high)

    def add_gap(self, begin_s: float, end_s: float) -> None:
        """Adds a time that is not recorded; samples before it must have been added."""
        if self.levels:
            level = self.levels[-1][1]
            self.add_level(begin_s, "")
            self.add_level(end_s, level)

    def add_level(self, wall_s: float, level: str) -> None:
        """Adds a change of the announced level."""
        if len(self.levels) < MOST_LEVELS:
            self.levels.append((wall_s, level))
        elif self.levels[-1][1]:
            self.levels.append((wall_s, ""))


def line_ahead(alert: str, wall_s: float, status: Status) -> JsonObject | None:
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
