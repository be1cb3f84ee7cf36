"""Least-squares lines through the samples of a queue, O(1) per sample, without drift.

The queue has two parts, as in window.py, so that nothing is ever subtracted from a sum: a sample joins the back and
leaves the front. Sums are those of the distances to a reference, a sample of the queue, so that they lose few digits.
The owner calls `flip` when the front is used up, since the reference has left then: one pass over the samples, so the
cost per sample is constant on average.
"""

from __future__ import annotations

import math
from array import array
from itertools import accumulate
from operator import mul
from typing import Sequence, Tuple

Moments = Tuple[float, float, float, float]
"""The means of time and value, and the sums of squared times and of the products of time and value.

Squares and products are those of the distances from the means: their quotient is the slope of the line per s.
"""


def merged(one: Moments, n: int, other: Moments, m: int) -> Moments:
    """Returns the moments of n and m samples together: Chan, Golub and LeVeque, 1979."""
    apart_s, apart, part = other[0] - one[0], other[1] - one[1], m / (n + m)
    squares = one[2] + other[2] + apart_s * apart_s * n * part
    return one[0] + apart_s * part, one[1] + apart * part, squares, one[3] + other[3] + apart_s * apart * n * part


class LineSums:
    """The sums of a queue: of each sample of its front and all newer ones of the front, and of its back."""

    __slots__ = (
        "front", "product", "products", "reference", "reference_s", "square", "squares", "sum_s", "sums_s", "total",
        "totals",
    )  # fmt: skip

    def __init__(self) -> None:
        """Starts without samples."""
        self.flip((), ())

    def flip(self, times: Sequence[float], values: Sequence[float]) -> None:
        """Makes all samples the front; the newest is the reference."""
        self.front = len(times)
        """How many samples of the front are left."""
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

    def moments(self, count: int, now_s: float) -> Moments:
        """Returns the moments of `count` samples, all of the queue and at least 1; times are relative to `now_s`."""
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
