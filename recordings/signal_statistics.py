"""Statistics of one signal over a whole recording, computed from chunks of samples."""

from __future__ import annotations

import math
import sys
from array import array
from typing import Any, List, Optional, Sequence

import numpy as np

from robot_health_monitor.core.quality import as_float
from robot_health_monitor.core.signal_config import SignalConfig

_LARGEST = sys.float_info.max


def as_numbers(values: Sequence[Any]) -> Any:
    """Returns values as an array of doubles; NaN for what is not a number."""
    try:
        numbers = array("d", values)
    except (TypeError, OverflowError, ValueError):
        numbers = array("d", [as_float(value) for value in values])
    return np.frombuffer(numbers, dtype=np.float64)


class SignalStatistics:
    """Number, range, mean and longest gap of one signal's samples."""

    def __init__(self, config: SignalConfig) -> None:
        """Starts before the first sample."""
        self._config = config
        self._valid_min = -_LARGEST if config.valid_min is None else config.valid_min
        self._valid_max = _LARGEST if config.valid_max is None else config.valid_max
        self.samples = 0
        """Number of samples, bad ones included."""
        self.bad_samples = 0
        """Number of samples that are no valid number."""
        self.min: Optional[float] = None
        """Smallest value of the signal's statistic, in its unit (`judged_unit`); None if it was never defined."""
        self.max: Optional[float] = None
        """Largest value of the statistic."""
        self.mean: Optional[float] = None
        """Mean of the values of the statistic at the samples."""
        self.first_s: Optional[float] = None
        """Log time of the first sample, in s since 1970; None without samples."""
        self.longest_gap_s: Optional[float] = None
        """Longest time between two samples in a row, in s; None with fewer than two samples."""
        self._last_s: Optional[float] = None
        self._ranged = 0

    def skip(self, duration_s: float) -> None:
        """Leaves a time after the last sample, in s, out of the gaps."""
        if self._last_s is not None:
            self._last_s += duration_s

    def add(self, times_s: Any, values: Any) -> Any:
        """Adds samples.

        Args:
            times_s: their log times in s since 1970, an array of doubles.
            values: the values as they came, an array of doubles of the same length.

        Returns:
            The values in the signal's unit, an array of doubles with NaN for bad samples.
        """
        config = self._config
        with np.errstate(over="ignore", invalid="ignore"):
            numbers = values * config.scale if config.scale != 1.0 else values.copy()
            for placeholder in config.placeholders:
                tolerance = 1e-6 * np.maximum(np.abs(values), abs(placeholder))
                numbers[np.abs(values - placeholder) <= tolerance] = math.nan
            bad = ~((numbers >= self._valid_min) & (numbers <= self._valid_max))  # True for NaN
        numbers[bad] = math.nan
        self.samples += len(values)
        self.bad_samples += int(np.count_nonzero(bad))
        if config.statistic == "last":
            self.add_values(numbers)
        self._add_times(times_s)
        return numbers

    def add_values(self, values: Any) -> None:
        """Adds values of a statistic other than `last` to the range, an array of doubles; NaN: undefined."""
        good = values[~np.isnan(values)]
        if not len(good):
            return
        smallest, largest = float(good.min()), float(good.max())
        self.min = smallest if self.min is None else min(self.min, smallest)
        self.max = largest if self.max is None else max(self.max, largest)
        self._ranged += len(good)
        weight = len(good) / self._ranged
        before = self.mean or 0.0
        mean = before * (1.0 - weight) + float((good / len(good)).sum()) * weight
        self.mean = min(max(mean, self.min), self.max)  # rounding must not carry it beyond the samples

    def _add_times(self, times_s: Any) -> None:
        gaps: List[float] = []
        if len(times_s) > 1:
            gaps.append(float(np.diff(times_s).max()))
        if self._last_s is None:
            self.first_s = float(times_s[0])
        else:
            gaps.append(float(times_s[0]) - self._last_s)
        self._last_s = float(times_s[-1])
        if gaps:
            self.longest_gap_s = max(0.0, *gaps) if self.longest_gap_s is None else max(self.longest_gap_s, *gaps)
