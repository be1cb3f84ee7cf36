"""Quantiles of a stream of numbers in bounded memory, the same in every run.

A buffer that is full is sorted, and every second number moves to the next buffer, where it counts twice as much (Munro
and Paterson 1980, "Selection and sorting with limited storage"; Manku, Rajagopalan and Lindsay 1998). Odd and even
positions take turns, so that the errors cancel. The rank of a result is off by at most `levels / (2 * SIZE)`: 0.02 % of
a million numbers. Minimum and maximum are exact.
"""

from __future__ import annotations

import math
from typing import Any, List, Tuple

import numpy as np

SIZE = 16_384
"""Numbers per buffer, an even number. A stream of n numbers needs at most log2(n / SIZE) + 2 buffers."""


class Quantiles:
    """Counts numbers, and estimates their quantiles."""

    def __init__(self) -> None:
        """Starts without numbers."""
        self.count = 0
        self.min = math.inf
        self.max = -math.inf
        self._buffers: List[Any] = [np.empty(0)]
        """Sorted numbers per level, except level 0; each counts `2 ** level` times."""
        self._odd: List[int] = [0]

    def add(self, numbers: Any) -> None:
        """Adds an array of finite doubles."""
        if not len(numbers):
            return
        self.count += len(numbers)
        self.min = min(self.min, float(numbers.min()))
        self.max = max(self.max, float(numbers.max()))
        buffer = np.concatenate([self._buffers[0], numbers])
        self._buffers[0] = buffer
        level = 0
        while len(self._buffers[level]) >= SIZE:
            full = np.sort(self._buffers[level])
            even = len(full) - len(full) % 2
            half = full[self._odd[level] : even : 2]
            self._odd[level] = 1 - self._odd[level]
            self._buffers[level] = full[even:]
            if level + 1 == len(self._buffers):
                self._buffers.append(np.empty(0))
                self._odd.append(0)
            level += 1
            self._buffers[level] = np.concatenate([self._buffers[level], half])

    def scale(self, factor: float) -> None:
        """Multiplies all numbers by a positive factor."""
        self._buffers = [each * factor for each in self._buffers]
        self.min *= factor
        self.max *= factor

    def within(self, low: float, high: float) -> Tuple[float, float, float]:
        """Returns the smallest and the largest number in a range, and the fraction of the numbers outside of it.

        Estimated, as quantiles are. Without a number in the range its ends are returned.
        """
        inside = [each[(each >= low) & (each <= high)] for each in self._buffers]
        weights = [2.0**level for level in range(len(inside))]
        share = sum(weight * len(each) for weight, each in zip(weights, inside)) / max(
            1.0, sum(weight * len(each) for weight, each in zip(weights, self._buffers))
        )
        kept = np.concatenate(inside)
        return (*((float(kept.min()), float(kept.max())) if len(kept) else (low, high)), 1.0 - share)

    def quantile(self, fraction: float) -> float:
        """Returns the smallest number such that at least `fraction` of all are at most that; NaN without numbers."""
        if not self.count:
            return math.nan
        if fraction <= 0.0 or fraction >= 1.0:
            return self.min if fraction <= 0.0 else self.max
        values = np.concatenate(self._buffers)
        weights = np.concatenate([np.full(len(each), 2.0**level) for level, each in enumerate(self._buffers)])
        order = np.argsort(values, kind="stable")
        ranks = np.cumsum(weights[order])
        place = int(np.searchsorted(ranks, fraction * ranks[-1] * (1.0 - 1e-12)))
        return float(values[order][min(place, len(values) - 1)])
