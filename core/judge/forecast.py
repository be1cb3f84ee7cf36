"""Forecast of a signal: least-squares lines through the window and its halves, O(1) per sample, without drift.

Theory of operation. Each half is a window too: a sample joins the newer half, joins the older one when it is half a
window old, and leaves the newer one after that.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from operator import itemgetter
from typing import Callable, Mapping, Optional, Tuple

from ..config.signal_config import SignalConfig
from ..values.model import Forecast
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

    __slots__ = ("_bounds", "_choose", "_newer", "_older", "_older_until_s", "forecast_s")

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
        super().clear()
        self._older, self._newer = (Window(self.window_s / 2.0, self.window_samples) for _ in range(2))
        self._older_until_s = -math.inf
        """Up to which time samples are in the older half, or have left it."""

    def add(self, value: float, now_s: float) -> None:
        """Adds a sample, as `Window.add`."""
        super().add(value, now_s)
        self._newer.add(value, now_s)
        times, middle_s = self._times, now_s - self.window_s / 2.0
        at = bisect_right(times, self._older_until_s, self._first)
        while times[at] <= middle_s:
            self._older.add(self._values[at], times[at])
            at += 1
        self._older_until_s = middle_s
        self._older.leave(times[self._first])

    def statistic(self, name: str) -> Optional[float]:
        """Returns a statistic to judge, as `Window.statistic`; the forecast is the most cautious prediction."""
        if name != "forecast":
            return super().statistic(name)
        line = self._line()
        return None if line is None else line[0]

    def forecast(self) -> Optional[Forecast]:
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

    def _line(self) -> Optional[_Line]:
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

    def lines(self) -> Optional[_Lines]:
        """Returns prediction and slope through all samples, the older half and the newer half; None: undefined.

        Each prediction is Prometheus's `predict_linear` (promql/functions.go).
        """
        older, newer = self._older, self._newer
        if len(older) < LEAST_SAMPLES or len(newer) < LEAST_SAMPLES:
            return None
        ahead_s, now_s = self.forecast_s, self._times[-1]
        lines = self.line(ahead_s), older.line(ahead_s, now_s), newer.line(ahead_s)
        # Where one overflows, or no time has passed, none is a prediction.
        return lines if math.isfinite(lines[0][0] + lines[1][0] + lines[2][0]) else None


def window_for(config: SignalConfig) -> Window:
    """Returns an empty window for the statistic of a signal."""
    limits = config.window_s, config.window_samples, config.window_min_s
    if config.statistic == "forecast" and config.forecast_s is not None:
        return ForecastWindow(*limits, config.forecast_s, config.bounds)
    if config.statistic == "count":
        return CountWindow(config.window_s, config.window_samples)
    return GapWindow(*limits) if config.statistic == "largest_gap_s" else Window(*limits)
