"""Quantiles of any number of values, in bounded memory and the same in every run."""

from __future__ import annotations

import math
import random
from array import array

SIZE = 16_384
"""Numbers that are kept."""


class Quantiles:
    """Counts numbers, and estimates their quantiles from a random sample of them; minimum and maximum are exact.

    Every number is as likely to be in the sample (reservoir sampling, algorithm R of Vitter, "Random sampling with a
    reservoir", ACM Transactions on Mathematical Software 11, 1985). Up to `SIZE` numbers, all are. The rank of a
    quantile q then has a standard deviation of sqrt(q * (1 - q) / SIZE): 0.1 % is 0.1 % +- 0.025 %.
    """

    def __init__(self) -> None:
        """Starts without numbers."""
        self.count = 0
        self.min = math.inf
        self.max = -math.inf
        self._sample: array[float] = array("d")
        self._chance = random.Random(0)

    def add(self, number: float) -> None:
        """Adds a finite number."""
        self.count += 1
        if number < self.min:
            self.min = number
        if number > self.max:
            self.max = number
        if self.count <= SIZE:
            self._sample.append(number)
        else:
            at = int(self._chance.random() * self.count)
            if at < SIZE:
                self._sample[at] = number

    def scale(self, factor: float) -> None:
        """Multiplies all numbers by a positive factor."""
        self._sample = array("d", (each * factor for each in self._sample))
        self.min *= factor
        self.max *= factor

    def quantile(self, fraction: float) -> float:
        """Returns the smallest number such that at least `fraction` of all are at most that; NaN without numbers."""
        if not self.count:
            return math.nan
        if fraction <= 0.0 or fraction >= 1.0:
            return self.min if fraction <= 0.0 else self.max
        at = math.ceil(fraction * len(self._sample) * (1.0 - 1e-12)) - 1
        return sorted(self._sample)[max(0, at)]

    def different(self) -> set[float]:
        """Returns the different numbers of the sample."""
        return set(self._sample)
