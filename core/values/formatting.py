"""Numbers, durations and texts in alert lines and statuses."""

from __future__ import annotations

import datetime
import hashlib
import math
import re
import reprlib
import unicodedata
from typing import Mapping, Sequence

_DIGITS = (4, 6, 9, 17)
_DEGREE_CELSIUS = re.compile(r"\bdegC\b")


def number_text(value: float, bound: float | None = None) -> str:
    """Returns a number with four digits, or as many as show on which side of `bound` it lies.

    >>> number_text(19.299999237060547)
    '19.3'
    >>> number_text(80.00001, bound=80.0)
    '80.00001'
    """
    for digits in _DIGITS:
        text = _plain(value, digits)
        if bound is None or not math.isfinite(value):
            break
        shown = float(text)
        if (shown < bound) == (value < bound) and (shown > bound) == (value > bound):
            break
    return text


def bound_text(bound: float) -> str:
    """Returns a configured number in full: 20.0 as 20, 0.15 as 0.15."""
    return f"{bound:.0f}" if bound.is_integer() and abs(bound) < 1e15 else repr(bound)


def duration_text(seconds: float) -> str:
    """Returns a duration: 0.25 s, 312 s, from 10 min on 12 min 5 s, from 1 h on 25 h 1 min, from 100 h on 4 d 5 h.

    Less than half a millisecond is 0 s: the two times come from messages that were sent at once.
    """
    if not 599.5 <= seconds < 1e15:  # also NaN
        return "0 s" if 0.0 <= seconds < 0.0005 else f"{_plain(seconds, 3)} s"
    whole = round(seconds)
    if whole < 3600:
        return _two_units(divmod(whole, 60), "min", "s")
    if whole < 360_000:
        return _two_units(divmod(whole // 60, 60), "h", "min")
    return _two_units(divmod(whole // 3600, 24), "d", "h")


def with_unit(number: str, unit: str) -> str:
    """Appends the unit, if there is one."""
    return f"{number} {unit}" if unit else number


def with_degree_sign(text: str) -> str:
    """Returns a text with °C in place of the unit degC, for output that can show it.

    >>> with_degree_sign("80.5 degC is above 80 degC")
    '80.5 °C is above 80 °C'
    """
    return _DEGREE_CELSIUS.sub("°C", text)


def with_hint(text: str, hint: str) -> str:
    """Appends the hint of a status or transition, if there is one, as everything that shows it to people does.

    >>> with_hint("no sample for 6 s (limit 5 s)", "no publisher on /battery")
    'no sample for 6 s (limit 5 s) [no publisher on /battery]'
    """
    return f"{text} [{hint}]" if hint else text


def count_text(number: int, noun: str) -> str:
    """Returns a number with its noun: 1 alert, 0 alerts, 2,000 alerts."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def list_text(names: Sequence[str], most: int = 10) -> str:
    """Returns names on one line, at most `most` of them: a, b, c, ..."""
    return ", ".join([*names[:most], *(["..."] if len(names) > most else [])])


def datum_text(value: object) -> str:
    """Returns any datum on one line, shortened to 40 characters."""
    if isinstance(value, float):
        return number_text(value)
    try:
        text = repr(value)
    except Exception:  # a foreign object's own repr
        text = f"a {type(value).__name__}"
    text = " ".join("".join(letter if letter.isprintable() else " " for letter in text[:200]).split())
    return text if len(text) <= 40 else text[:37] + "..."


def fingerprint(robot: str, name: str) -> str:
    """Returns 16 hexadecimal digits that identify something of a robot by its name."""
    return hashlib.sha256(f"{robot}\0{name}".encode("utf-8", "replace")).hexdigest()[:16]


def printable(text: str) -> str:
    """Replaces control, format and bidirectional marks, line separators and surrogates by `?`.

    For names and texts from outside, so that they can neither control a terminal nor forge a line.
    """
    if text.isprintable():
        return text
    # Categories Cc, Cf, Cs, Co, Cn, Zl and Zp are not printable; neither are spaces other than " ", which are harmless.
    return "".join(letter if letter.isprintable() or unicodedata.category(letter) == "Zs" else "?" for letter in text)


def _two_units(numbers: tuple[int, int], large_unit: str, small_unit: str) -> str:
    large, small = numbers
    return f"{large} {large_unit} {small} {small_unit}" if small else f"{large} {large_unit}"


def _plain(value: float, digits: int) -> str:
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e15 else text


class _BoundedRepr(reprlib.Repr):
    """A `repr` whose cost does not grow with the value: configurations may contain anything."""

    def repr_int(self, x: int, level: int) -> str:
        # Python refuses to print numbers of more than 4300 digits, and is slow before that.
        return repr(x) if x.bit_length() <= 2000 else f"a number of {x.bit_length()} bits"


_REPR = _BoundedRepr()
_REPR.maxlevel = 3
_REPR.maxother = _REPR.maxstring = 60


def describe(value: object) -> str:
    """Describes a value for an error message, in at most 60 characters."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, datetime.date):
        return f"the date {value}"
    text = _REPR.repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
