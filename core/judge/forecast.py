"""Forecast of a signal: least-squares lines through the window and its halves, O(1) per sample, without drift.

Theory of operation. Each of the three ranges of samples is a queue: samples join it at its end and leave it at its
begin. So that nothing is ever subtracted from a sum, a queue has two parts: a sample joins the back and leaves the
front, which knows the sums of each of its samples and all newer ones of the front. When the front is used up, one pass
makes all samples the front, so that the cost per sample is constant on average. Sums are those of the distances to a
reference, a sample of the queue, so that they lose few digits.
"""

from __future__ import annotations

import math
from array import array
from itertools import accumulate
from operator import mul
from typing import Mapping, Sequence, Tuple

from ..config import SignalConfig
from ..values import Forecast
from .window import CountWindow, GapWindow, Window

__all__ = ["LEAST_SAMPLES", "ForecastWindow", "window_for"]

LEAST_SAMPLES = 5
"""Samples that each half needs."""

_LONGEST = 10.0
"""Longest time to a bound that is stated, in lengths of the forecast."""

_Line = Tuple[float, float]
"""A prediction, and the slope per s."""


class LineOfRange:
    """The least-squares line through a range of samples whose begin and end only move on."""

    __slots__ = (
        "_end", "_front_end", "_product", "_products", "_reference", "_reference_s", "_square", "_squares", "_sum_s",
        "_sums_s", "_times", "_total", "_totals", "_values",
    )  # fmt: skip

    def __init__(self, times: Sequence[float], values: Sequence[float]) -> None:
        """Knows no sample of these yet, to which more may be appended."""
        self._times, self._values = times, values
        self._front_end = self._end = 0
        """Where the front ends and the back begins, and where the back ends."""

    def _flip(self, begin: int, end: int) -> None:
        """Makes all samples the front; the newest is the reference."""
        times, values = self._times[begin:end], self._values[begin:end]
        self._front_end = self._end = end
        self._sum_s = self._total = self._square = self._product = 0.0
        self._reference_s, self._reference = times[-1], values[-1]
        distances_s = [at_s - self._reference_s for at_s in reversed(times)]
        distances = [value - self._reference for value in reversed(values)]
        # An array of a list is made in less time than one of what is iterated.
        self._sums_s = array("d", list(accumulate(distances_s)))
        self._totals = array("d", list(accumulate(distances)))
        self._squares = array("d", list(accumulate(map(mul, distances_s, distances_s))))
        self._products = array("d", list(accumulate(map(mul, distances_s, distances))))

    def line(self, begin: int, end: int, at_s: float) -> _Line | None:
        """Returns the line of a range that lies not before the last one; None if it has too few samples.

        The prediction is that for a time: Prometheus's `predict_linear` (promql/functions.go).
        """
        count = end - begin
        if count < LEAST_SAMPLES:
            return None
        if begin >= self._front_end:  # at once, since the reference has left
            self._flip(begin, end)
        reference_s, reference = self._reference_s, self._reference
        new = self._end
        while new < end:
            distance_s, distance = self._times[new] - reference_s, self._values[new] - reference
            self._sum_s += distance_s
            self._total += distance
            self._square += distance_s * distance_s
            self._product += distance_s * distance
            self._end = new = new + 1
        at = self._front_end - begin - 1
        sum_s = self._sum_s + self._sums_s[at]
        mean_s, mean = sum_s / count, (self._total + self._totals[at]) / count
        squares = self._square + self._squares[at] - sum_s * mean_s
        if squares <= 0.0:
            return None
        slope = (self._product + self._products[at] - sum_s * mean) / squares
        return reference + mean + slope * (at_s - reference_s - mean_s), slope


class ForecastWindow(Window):
    """A window that also forecasts its values. Both halves hold a sample that is exactly half a window old."""

    def __init__(
        self,
        window_s: float,
        window_samples: int,
        window_min_s: float,
        forecast_s: float,
        bounds: Mapping[str, float],
    ) -> None:
        """Creates an empty window.

        Args:
            window_s: as of `Window`, like the next two.
            window_samples: see there.
            window_min_s: see there.
            forecast_s: time from the newest sample to the horizon, in s.
            bounds: those of the signal by their names, all below or all above.
        """
        self.forecast_s = forecast_s
        self._bounds = tuple(bounds.values())
        self._sign = 0.0
        """1 where low values are bad, so that the largest prediction is the most cautious; -1 where high values are.

        0 without bounds: the line of the window counts.
        """
        if bounds:
            self._sign = 1.0 if any(name.endswith("below") for name in bounds) else -1.0
        super().__init__(window_s, window_samples, window_min_s)

    def _discard(self) -> None:
        super()._discard()
        self._ranges = [LineOfRange(self._times, self._values) for _ in range(3)]
        self._newer = self._older_end = 0
        """Where the newer half begins, and where the older half ends: after a sample exactly between them."""

    def forecast(self) -> float | None:
        """The most cautious prediction."""
        line = self._line()
        return None if line is None else line[0]

    def outlook(self) -> Forecast | None:
        """Returns the forecast and its line; None while it is undefined."""
        line = self._line() if self.is_long_enough else None
        if line is None:
            return None
        value, slope_per_s = line
        times_s = [(self.forecast_s + (bound - value) / slope_per_s, bound) for bound in self._bounds if slope_per_s]
        longest_s = _LONGEST * self.forecast_s
        ahead = (each for each in times_s if 0.0 < each[0] <= longest_s)
        time_to_bound_s, bound = min(ahead, default=(None, None))
        return Forecast(value, slope_per_s, self.forecast_s, time_to_bound_s, bound)

    def _line(self) -> _Line | None:
        """Returns the line that gives the forecast; None while it is undefined. Not without samples.

        The forecast never contradicts the present: while the line of the window goes towards the bounds, the latest
        value takes the place of a prediction that is further from them.
        """
        lines = self.lines()
        if lines is None:
            return None
        sign, line, latest = self._sign, lines[0], self._values[-1]
        goes_to_bounds = line[1] * sign < 0.0
        for each in lines:
            if (each[0] - line[0]) * sign > 0.0:
                line = each
        return (latest, 0.0) if goes_to_bounds and (line[0] - latest) * sign > 0.0 else line

    def lines(self) -> Sequence[_Line] | None:
        """Returns the lines through all samples, the older half and the newer half; None if they are undefined."""
        times, first, end = self._times, self._first, len(self._times)
        now_s = times[-1]
        cut_s, at_s = now_s - self.window_s / 2.0, now_s + self.forecast_s
        while times[self._newer] < cut_s:
            self._newer += 1
        while times[self._older_end] <= cut_s:
            self._older_end += 1
        if self._newer < first:
            self._newer = first
        all_samples, older, newer = self._ranges
        new = newer.line(self._newer, end, at_s)
        old = older.line(first, self._older_end, at_s)
        both = all_samples.line(first, end, at_s)
        # Where one overflows, none is a prediction.
        if both is None or old is None or new is None or not math.isfinite(both[0] + old[0] + new[0]):
            return None
        return both, old, new


def window_for(config: SignalConfig) -> Window:
    """Returns an empty window for the statistic of a signal."""
    limits = config.window_s, config.window_samples, config.window_min_s
    if config.statistic == "forecast" and config.forecast_s is not None:
        return ForecastWindow(*limits, config.forecast_s, config.bounds)
    if config.statistic == "count":
        return CountWindow(config.window_s, config.window_samples)
    return GapWindow(*limits) if config.statistic == "largest_gap_s" else Window(*limits)
