"""Mean, variance, least-squares line and extremes of the samples of a queue, O(1) per sample, without drift.

The queue has two parts, as in window.py, so that nothing is ever subtracted from a sum: a sample joins the back and
leaves the front. Sums are those of the distances to a reference, the newest sample of the front, so that they lose few
digits: it is a sample of the queue until the front is used up.
"""

from __future__ import annotations

import math
from array import array
from itertools import accumulate
from operator import mul
from typing import Sequence, Tuple


class Sums:
    """Aggregates of each sample of the front of a queue and all newer ones of the front, and of its back."""

    __slots__ = (
        "_largest", "_largest_in_back", "_product", "_products", "_reference", "_reference_s", "_smallest",
        "_smallest_in_back", "_square", "_square_s", "_squares", "_squares_s", "_sum", "_sum_s", "_sums", "_sums_s",
        "in_back",
    )  # fmt: skip

    def __init__(self, times: Sequence[float], values: Sequence[float]) -> None:
        """Takes the front, oldest first; not empty. The back is empty."""
        self._reference_s, self._reference = times[-1], values[-1]
        self.in_back = 0
        """How many samples the back holds."""
        self._sum_s = self._sum = self._square_s = self._product = self._square = 0.0
        self._smallest_in_back, self._largest_in_back = math.inf, -math.inf
        apart_s = [at_s - self._reference_s for at_s in reversed(times)]
        apart = [value - self._reference for value in reversed(values)]
        self._sums_s, self._sums = array("d", accumulate(apart_s)), array("d", accumulate(apart))
        self._squares_s = array("d", accumulate(map(mul, apart_s, apart_s)))
        self._products = array("d", accumulate(map(mul, apart_s, apart)))
        self._squares = array("d", accumulate(map(mul, apart, apart)))
        self._smallest, self._largest = (array("d", accumulate(reversed(values), end)) for end in (min, max))

    def add(self, at_s: float, value: float) -> None:
        """Adds a sample to the back."""
        apart_s, apart = at_s - self._reference_s, value - self._reference
        self.in_back += 1
        self._sum_s += apart_s
        self._sum += apart
        self._square_s += apart_s * apart_s
        self._product += apart_s * apart
        self._square += apart * apart
        if value < self._smallest_in_back:
            self._smallest_in_back = value
        if value > self._largest_in_back:
            self._largest_in_back = value

    def smallest(self, front: int) -> float:
        """Returns the smallest value; `front` samples of the front are left, at least 1, as in the other methods."""
        return min(self._smallest[front - 1], self._smallest_in_back)

    def largest(self, front: int) -> float:
        """Returns the largest value."""
        return max(self._largest[front - 1], self._largest_in_back)

    def mean(self, front: int) -> float:
        """Returns the mean of the values; as the other results, it may be infinite or NaN where a sum overflows."""
        return self._reference + (self._sums[front - 1] + self._sum) / (front + self.in_back)

    def variance(self, front: int) -> float:
        """Returns the variance of the values."""
        count: int = front + self.in_back
        total: float = self._sums[front - 1] + self._sum
        squares: float = self._squares[front - 1] + self._square
        return (squares - total * total / count) / count

    def line(self, front: int, now_s: float, ahead_s: float) -> Tuple[float, float]:
        """Returns the value of the least-squares line `ahead_s` after `now_s`, and its slope per s; NaN: undefined."""
        count, total = front + self.in_back, self._sums[front - 1] + self._sum
        mean_s = (self._sums_s[front - 1] + self._sum_s) / count
        squares_s = self._squares_s[front - 1] + self._square_s - mean_s * mean_s * count
        product = self._products[front - 1] + self._product - mean_s * total
        slope = product / squares_s if squares_s > 0.0 else math.nan
        return self._reference + total / count + slope * (now_s - self._reference_s - mean_s + ahead_s), slope
