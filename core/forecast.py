"""Forecast of a signal: least-squares lines through the window and its halves, O(1) per sample, without drift.

Theory of operation. Each half of the window is a queue of two parts, as in window.py, so that nothing is ever
subtracted from a sum: a sample joins the newer half, moves to the older one when it is more than half a window old, and
leaves. Sums are those of the distances to a reference, a sample of that half, so that they lose few digits. The line
through all samples comes from the sums of both halves. One pass over a half takes place when its front is used up, so
the cost per sample is constant on average.
"""

from __future__ import annotations

import math
from array import array
from itertools import accumulate
from operator import itemgetter, mul
from typing import Callable, Mapping, Optional, Sequence, Tuple

from .model import Forecast
from .signal_config import SignalConfig
from .window import GapWindow, Window

__all__ = ["LEAST_SAMPLES", "ForecastWindow", "window_for"]

LEAST_SAMPLES = 5
"""Samples that each half needs."""

_LONGEST = 10.0
"""Longest time to a bound that is stated, in lengths of the forecast."""

_Line = Tuple[float, float]
"""A prediction, and the slope per s."""
_Lines = Tuple[_Line, _Line, _Line]
"""Through all samples, the older half and the newer half."""


class _Half:
    """The sums of a half: of each sample of its front and all newer ones of the front, and of its back."""

    __slots__ = (
        "front",
        "product",
        "products",
        "reference",
        "reference_s",
        "square",
        "squares",
        "sum_s",
        "sums_s",
        "total",
        "totals",
    )

    def __init__(self) -> None:
        self.flip((), ())

    def flip(self, times: Sequence[float], values: Sequence[float]) -> None:
        """Makes all samples the front; the newest is the reference."""
        self.front = len(times)
        self.sum_s = self.total = self.square = self.product = 0.0
        self.reference_s, self.reference = (times[-1], values[-1]) if times else (math.nan, math.nan)
        distances_s = [at_s - self.reference_s for at_s in reversed(times)]
        distances = [value - self.reference for value in reversed(values)]
        self.sums_s = array("d", accumulate(distances_s))
        self.totals = array("d", accumulate(distances))
        self.squares = array("d", accumulate(map(mul, distances_s, distances_s)))
        self.products = array("d", accumulate(map(mul, distances_s, distances)))

    def add(self, value: float, at_s: float) -> None:
        """Adds a sample to the back."""
        distance_s, distance = at_s - self.reference_s, value - self.reference
        if distance_s != distance_s:
            self.reference_s, self.reference = at_s, value
            return
        self.sum_s += distance_s
        self.total += distance
        self.square += distance_s * distance_s
        self.product += distance_s * distance

    def moments(self, count: int, now_s: float) -> Tuple[float, float, float, float]:
        """Returns the means of time, relative to `now_s`, and value, and the sums of squared and multiplied distances.

        Distances are those from the means; the products are those of time and value.

        Args:
            count: the number of samples of the half, at least 1.
            now_s: a time in s.
        """
        sum_s, total, square, product = self.sum_s, self.total, self.square, self.product
        if self.front:
            at = self.front - 1
            sum_s += self.sums_s[at]
            total += self.totals[at]
            square += self.squares[at]
            product += self.products[at]
        mean_s, mean = sum_s / count, total / count
        return (
            self.reference_s - now_s + mean_s,
            self.reference + mean,
            square - sum_s * mean_s,
            product - sum_s * mean,
        )


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
        super().clear()
        self._older, self._newer = _Half(), _Half()
        self._middle = 0
        """Index of the oldest sample of the newer half."""
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

    def statistic(self, name: str) -> Optional[float]:
        """Returns a statistic to judge, as `Window.statistic`; the forecast is the most cautious prediction."""
        if name != "forecast":
            return super().statistic(name)
        lines = self.lines() if self.is_long_enough else None
        return None if lines is None else self._choose(lines)[0]

    def forecast(self) -> Optional[Forecast]:
        """Returns the forecast and its line; None while it is undefined."""
        lines = self.lines() if self.is_long_enough else None
        if lines is None:
            return None
        value, slope_per_s = self._choose(lines)
        times_s = [(self.forecast_s + (bound - value) / slope_per_s, bound) for bound in self._bounds if slope_per_s]
        longest_s = _LONGEST * self.forecast_s
        ahead = (each for each in times_s if 0.0 < each[0] <= longest_s)
        time_to_bound_s, bound = min(ahead, default=(None, None))
        return Forecast(value, slope_per_s, self.forecast_s, time_to_bound_s, bound)

    def lines(self) -> Optional[_Lines]:
        """Returns prediction and slope through all samples, the older half and the newer half; None: undefined.

        Each prediction is Prometheus's `predict_linear` (promql/functions.go).
        """
        times, older, newer = self._times, self._older, self._newer
        n, m = self._older_count, len(times) - self._middle
        if m < LEAST_SAMPLES or not n:
            return None
        now_s = times[-1]
        horizon_s = self.forecast_s
        mean_s, mean, squares, products = newer.moments(m, now_s)
        old_mean_s, old_mean, old_squares, old_products = older.moments(n, now_s)

        # Both halves together, and the samples at the cut added to the older half: Chan, Golub and LeVeque, 1979.
        apart_s, apart, weight = mean_s - old_mean_s, mean - old_mean, n * m / (n + m)
        all_squares = squares + old_squares + apart_s * apart_s * weight
        all_products = products + old_products + apart_s * apart * weight
        part = m / (n + m)
        all_mean_s, all_mean = old_mean_s + apart_s * part, old_mean + apart * part
        cut_s = now_s - self.window_s / 2.0
        middle = self._middle
        if times[middle] == cut_s:
            count, cut_mean = 1, self._values[middle]
            if times[middle + 1] == cut_s:
                count, cut_mean = self._samples_at(cut_s)
            apart_s, apart, weight = cut_s - now_s - old_mean_s, cut_mean - old_mean, n * count / (n + count)
            old_squares += apart_s * apart_s * weight
            old_products += apart_s * apart * weight
            old_mean_s += apart_s * count / (n + count)
            old_mean += apart * count / (n + count)
            n += count
        if n < LEAST_SAMPLES or old_squares <= 0.0 or squares <= 0.0:
            return None
        all_slope, old_slope, slope = all_products / all_squares, old_products / old_squares, products / squares
        lines = (
            (all_mean + all_slope * (horizon_s - all_mean_s), all_slope),
            (old_mean + old_slope * (horizon_s - old_mean_s), old_slope),
            (mean + slope * (horizon_s - mean_s), slope),
        )
        # Where one overflows, none is a prediction.
        return lines if math.isfinite(lines[0][0] + lines[1][0] + lines[2][0]) else None

    def _samples_at(self, at_s: float) -> Tuple[int, float]:
        """Returns how many samples of the newer half have the time of its oldest, and their mean."""
        times, middle = self._times, self._middle
        end = middle
        while end < len(times) and times[end] == at_s:
            end += 1
        values = self._values[middle:end]
        return len(values), sum(values) / len(values)

    def _flip(self) -> None:
        self._middle -= self._first
        super()._flip()


def window_for(config: SignalConfig) -> Window:
    """Returns an empty window for the statistic of a signal."""
    limits = config.window_s, config.window_samples, config.window_min_s
    if config.statistic == "forecast" and config.forecast_s is not None:
        return ForecastWindow(*limits, config.forecast_s, config.bounds)
    return GapWindow(*limits) if config.statistic == "largest_gap_s" else Window(*limits)
