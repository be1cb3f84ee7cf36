"""Which messages are samples of a signal: `where: 'level >= ERROR and name == "*controller*"'`.

The port takes the condition behind the path of the field: `data where level >= ERROR`. With an empty path, the value
is 1.
"""

from __future__ import annotations

import math
import operator
import re
from typing import Any, Callable, Mapping, NamedTuple, Sequence

from .elements import BadDatum
from .errors import ConfigError
from .field_path import ABSENT, Every, Getter, leading_path, parse_field_path
from .formatting import describe
from .patterns import matches_pattern

_COMPARED = re.compile(
    r"""\s*(?:(?P<equality>[=!]=)|(?P<order>[<>]=?))\s*(?:
        (?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w.])
    |   (?P<constant>[A-Za-z_]\w*)
    |   (?(equality)"(?P<text>(?:[^"\\]|\\"|\\(?!"))*)"|(?!))  # a text is equal or not
    )(?:\s+and\s+(?=\S)|\Z)""",
    re.ASCII | re.VERBOSE,
)
_WHERE = " where "
LONGEST_TEXT = 10_000
"""Characters of a text in a message that are compared: a hostile one must not delay judging."""
_MOST_DIGITS = 20
_BOOLEANS = {"true": 1, "false": 0}


def is_equal(value: float, number: float) -> bool:
    """Returns whether a value is a number as it was written: 0.1 as a Float32 is 0.1000000015."""
    return value == number or (type(value) is float and math.isclose(value, number, rel_tol=1e-6))


COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    "==": is_equal,
    "!=": lambda value, number: not is_equal(value, number),
    "<": operator.lt,
    "<=": lambda value, number: value < number or is_equal(value, number),
    ">": operator.gt,
    ">=": lambda value, number: value > number or is_equal(value, number),
}
"""Compares a value with a number, by the operator."""


class Comparison(NamedTuple):
    """A field of a message compared with a number, a constant of its type, or a text."""

    path: str
    operator: str
    number: float | None
    constant: str
    """Name of the constant that gives the number; empty if it is not a constant's."""
    text: str
    """A pattern in which * and ? match, if there is neither number nor constant."""

    def holds(self, value: Any, number: float) -> bool:
        """Returns whether it is true for the value of the field; `number` is that of the constant, if it is one."""
        is_text, is_number = isinstance(value, str) and type(value) is not BadDatum, isinstance(value, (int, float))
        if self.number is not None or self.constant:
            return COMPARE[self.operator](value, number) if is_number else is_text and self.operator == "!="
        return (
            matches_pattern(value[:LONGEST_TEXT], self.text) is (self.operator == "==")
            if is_text
            else (is_number and self.operator == "!=")
        )


def parse_where(where: str) -> list[Comparison]:
    """Returns the comparisons of a condition, all of which must hold; raises ValueError if it is none."""
    comparisons: list[Comparison] = []
    rest = where.strip()
    while rest or not comparisons:
        steps, behind = leading_path(rest)
        match = _COMPARED.match(behind)
        is_one_value = steps and not any(isinstance(step, Every) for step in steps)
        number = match and match["number"]
        if match is None or not is_one_value or (number and math.isinf(float(number))):
            raise ValueError(f'expected comparisons such as level >= ERROR and name == "*arm*", got {describe(rest)}')
        constant = match["constant"] or ""
        exact: float | None = None
        if constant in _BOOLEANS:
            exact, constant = _BOOLEANS[constant], ""
        elif number:
            # As it is written: an id of 64 bits has more digits than a float.
            exact = int(number) if number.lstrip("+-").isdigit() and len(number) <= _MOST_DIGITS else float(number)
        path, text = rest[: len(rest) - len(behind)], (match["text"] or "").replace('\\"', '"')
        comparisons.append(Comparison(path, match["equality"] or match["order"], exact, constant, text))
        rest = behind[match.end() :]
    return comparisons


def selection(field: str, where: str) -> str | None:
    """Returns what a subscription reads of each message; None if it reads nothing, and each is a sample of value 1."""
    return f"{field}{_WHERE}{where}" if where else field or None


def selected(
    topic: str,
    type_name: str,
    text: str,
    bind: Callable[[str], Getter],
    constant: Callable[[str, str], Callable[[Any], float]],
) -> Getter:
    """Returns a function that reads from a message what `selection` describes: ABSENT if a comparison does not hold.

    `bind` returns the getter of a path, `constant` that of a constant, by the path of the field and its name. Raises
    ConfigError with the resolved topic and the type, which may be empty, for what is no path or no condition.
    """

    def number_of(comparison: Comparison) -> Callable[[Any], float]:
        if comparison.constant:
            return constant(comparison.path, comparison.constant)
        return lambda message: comparison.number or 0

    comparisons: Sequence[Comparison] = ()
    try:
        _, rest = leading_path(text)
        if rest.startswith(_WHERE):
            text, comparisons = text[: -len(rest)], parse_where(rest[len(_WHERE) :])
        parse_field_path(text)
    except ValueError as error:
        place = f"field {describe(text)} of {type_name}" if type_name else f"field {describe(text)}"
        raise ConfigError(f"{topic}: {place}: {error}") from None
    read = bind(text) if text or not comparisons else lambda message: 1.0
    if not comparisons:
        return read
    bound = [(each.holds, bind(each.path), number_of(each)) for each in comparisons]

    def get(message: Any) -> Any:
        for holds, value_of, number in bound:
            if not holds(value_of(message), number(message)):
                return ABSENT
        return read(message)

    return get
