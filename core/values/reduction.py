"""The one number that a signal with `reduce` makes of the elements of an array."""

from __future__ import annotations

import math
from operator import itemgetter
from typing import Callable, Iterable, NamedTuple

from .elements import NOT_A_NUMBER, Age, BadDatum, DriverStatus, Elements

REDUCTIONS = ("min", "max", "mean", "spread", "sum", "count")
"""Reductions of all elements to one value; spread is the largest minus the smallest."""


class Element(NamedTuple):
    """One element."""

    name: str
    value: float
    """In the unit of the signal."""


class Reduced(float):
    """The value of a reduction, in the unit of the signal; NaN if no element is measured."""

    __slots__ = ("decided", "measured", "remark", "skipped")

    decided: tuple[Element, ...]
    """The elements that decided: the smallest, the largest, or for `spread` both in this order. Empty for others."""
    measured: int
    """Number of elements that are measured."""
    skipped: int
    """Number of elements that are not."""
    remark: str
    """That of the first element with an odd age; empty if there is none."""

    def __new__(
        cls,
        value: float = math.nan,
        decided: tuple[Element, ...] = (),
        measured: int = 0,
        skipped: int = 0,
        remark: str = "",
    ) -> Reduced:
        """Creates a value of `reduce`; the arguments are the attributes."""
        new = super().__new__(cls, value)
        new.decided, new.measured, new.skipped, new.remark = decided, measured, skipped, remark
        return new

    @property
    def problem(self) -> str:
        """Why there is no value; empty if there is one."""
        if self.measured or not math.isnan(self):
            return ""
        return f"none of {self.skipped} elements is measured" if self.skipped else "no elements"


def reduced(elements: Elements, reduction: str, number_of: Callable[[object], float]) -> Reduced:
    """Returns the reduction of elements. `number_of` returns their numbers in the unit of the signal.

    Elements that are not finite numbers there are not measured; `count` also counts texts and messages.
    """
    all_numbers = [number_of(value) for _, value in elements]
    measured = [Element(name, number) for (name, _), number in zip(elements, all_numbers) if math.isfinite(number)]
    count, result = len(measured), math.nan
    decided: tuple[Element, ...] = ()
    if reduction == "count":
        count = sum(math.isfinite(each) or _is_present(value) for each, (_, value) in zip(all_numbers, elements))
        result = float(count)
    elif measured and reduction in ("sum", "mean"):
        result = _sum(each.value for each in measured) / (1 if reduction == "sum" else count)
    elif measured:
        least, most = (end(measured, key=itemgetter(1)) for end in (min, max))
        decided = {"min": (least,), "max": (most,), "spread": (least, most)}[reduction]
        result = decided[-1].value - (least.value if reduction == "spread" else 0.0)
    remark = next((value.remark for _, value in elements if type(value) is Age and value.remark), "")
    return Reduced(result, decided, count, len(elements) - count, remark)


def _is_present(value: object) -> bool:
    """Returns whether an element that is no number is there all the same."""
    return value is NOT_A_NUMBER or (isinstance(value, (str, DriverStatus)) and not isinstance(value, BadDatum))


def _sum(numbers: Iterable[float]) -> float:
    try:
        return math.fsum(numbers)
    except OverflowError:
        return math.inf
