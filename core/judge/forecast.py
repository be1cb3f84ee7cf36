"""Forecast of a signal: least-squares lines through the window and its halves, O(1) per sample, without drift.

Theory of operation. Each half of the window has the sums of least_squares.py: a sample joins the newer half, moves to
the older one when it is more than half a window old, and leaves. The line through all samples comes from the sums of
both halves.
"""

from __future__ import annotations

import math
from operator import itemgetter
from typing import Callable, Mapping, Tuple

from ..config import SignalConfig
from ..values import Forecast
from .least_squares import LineSums, Moments, merged
from .window import CountWindow, GapWindow, Window

__all__ = ["LEAST_SAMPLES", "ForecastWindow", "window_for"]

LEAST_SAMPLES = 5
"""Samples that each half needs."""

_LONGEST = 10.0
"""Longest time to a bound that is stated, in lengths of the forecast."""

_Line = Tuple[float, float]
"""A prediction, and the slope per s."""
_Lines = Tuple[_Line, _Line, _Line]
"""Through all samples, the older half and the newer half."""


class ForecastWindow(Window):
    """A window that also forecasts its values. Both halves hold a sample that is exactly half a window old."""

    __slots__ = ("_bounds", "_choose", "_middle", "_newer", "_older", "_older_count", "forecast_s")

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
        # Where low values are bad, the largest is the most cautious. Without bounds, the line of the window counts.
        self._choose: Callable[[_Lines], _Line] = itemgetter(0)
        if bounds:
            self._choose = max if any(name.endswith("below") for name in bounds) else min
        super().__init__(window_s, window_samples, window_min_s)

    def clear(self) -> None:
        """Removes every sample."""
        self._older, self._newer = LineSums(), LineSums()
        self._middle = self._first = 0
        """Index of the oldest sample of the newer half."""
        super().clear()
        self._older_count = 0

    def add(self, value: float, now_s: float) -> None:
        """Adds a sample, as `Window.add`."""
        super().add(value, now_s)
        times, values, older, newer, middle = self._times, self._values, self._older, self._newer, self._middle
        newer.add(value, now_s)
        middle_s = now_s - self.window_s / 2.0
        first, last_middle = self._first, middle
        while times[middle] < middle_s or middle < first:
            older.add(values[middle], times[middle])
            middle += 1
        self._middle = middle
        # A half whose front is used up is flipped at once, since its reference has left.
        moved = middle - last_middle
        if moved:
            if moved < newer.front:
                newer.front -= moved
            else:
                newer.flip(times[middle:], values[middle:])
        left = self._older_count + moved - (middle - first)
        if left:
            if left < older.front:
                older.front -= left
            else:
                older.flip(times[first:middle], values[first:middle])
        self._older_count = middle - first

    def statistic(self, name: str) -> float | None:
        """Returns a statistic to judge, as `Window.statistic`; the forecast is the most cautious prediction."""
        if name != "forecast":
            return super().statistic(name)
        line = self._line()
        return None if line is None else line[0]

    def forecast(self) -> Forecast | None:
        """Returns the forecast and its line; None while it is undefined."""
        line = self._line()
        if line is None:
            return None
        value, slope_per_s = line
        times_s = [(self.forecast_s + (bound - value) / slope_per_s, bound) for bound in self._bounds if slope_per_s]
        longest_s = _LONGEST * self.forecast_s
        ahead = (each for each in times_s if 0.0 < each[0] <= longest_s)
        time_to_bound_s, bound = min(ahead, default=(None, None))
        return Forecast(value, slope_per_s, self.forecast_s, time_to_bound_s, bound)

    def _line(self) -> _Line | None:
        """Returns the line that gives the forecast; None while it is undefined.

        The forecast never contradicts the present: while the line of the window goes towards the bounds, the latest
        value takes the place of a prediction that is further from them.
        """
        lines = self.lines() if self.is_long_enough else None
        if lines is None:
            return None
        line, (_, slope_per_s), latest = self._choose(lines), lines[0], self._values[-1]
        if self._choose is min:
            contradicts = slope_per_s > 0.0 and line[0] < latest
        else:
            contradicts = self._choose is max and slope_per_s < 0.0 and line[0] > latest
        return (latest, 0.0) if contradicts else line

    def lines(self) -> _Lines | None:
        """Returns prediction and slope through all samples, the older half and the newer half; None if undefined.

        Each prediction is Prometheus's `predict_linear` (promql/functions.go).
        """
        times, older, newer = self._times, self._older, self._newer
        n, m, middle = self._older_count, len(times) - self._middle, self._middle
        if m < LEAST_SAMPLES or not n:
            return None
        now_s = times[-1]
        old, new = older.moments(n, now_s), newer.moments(m, now_s)
        both = merged(old, n, new, m)
        cut_s = now_s - self.window_s / 2.0
        if times[middle] == cut_s:
            count, cut_mean = self._samples_at(cut_s)
            old = merged(old, n, (cut_s - now_s, cut_mean, 0.0, 0.0), count)
            n += count
        if n < LEAST_SAMPLES or old[2] <= 0.0 or new[2] <= 0.0:
            return None
        lines = self._line_of(both), self._line_of(old), self._line_of(new)
        # Where one overflows, none is a prediction.
        return lines if math.isfinite(lines[0][0] + lines[1][0] + lines[2][0]) else None

    def _line_of(self, moments: Moments) -> _Line:
        mean_s, mean, squares, products = moments
        slope = products / squares
        return mean + slope * (self.forecast_s - mean_s), slope

    def _samples_at(self, at_s: float) -> tuple[int, float]:
        """Returns how many samples of the newer half have the time of its oldest, and their mean."""
        times, middle = self._times, self._middle
        end = middle
        while end < len(times) and times[end] == at_s:
            end += 1
        values = self._values[middle:end]
        return len(values), sum(values) / len(values)

    def _discard(self) -> None:
        self._middle -= self._first
        super()._discard()


def window_for(config: SignalConfig) -> Window:
    """Returns an empty window for the statistic of a signal."""
    limits = config.window_s, config.window_samples, config.window_min_s
    if config.statistic == "forecast" and config.forecast_s is not None:
        return ForecastWindow(*limits, config.forecast_s, config.bounds)
    if config.statistic == "count":
        return CountWindow(config.window_s, config.window_samples)
    return GapWindow(*limits) if config.statistic == "largest_gap_s" else Window(*limits)
