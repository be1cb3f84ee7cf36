"""The path of a number inside a message: `data`, `battery.percentage`, `cell_voltage[0]`, `status["motor"].level`.

A name goes into a field, a whole number in brackets to an element, a quoted text in brackets to the element of that
`name` (or `key`): that is how a status is picked out of /diagnostics, and a value out of a status.
"""

from __future__ import annotations

import re
from typing import Any, Iterable, NamedTuple, Optional, Tuple, Union


class Keyed(NamedTuple):
    """A step to the element whose `name` or `key` is this text."""

    key: str


Step = Union[str, int, Keyed]
"""A field's name, an element's index, or an element's key."""

_PART = re.compile(
    r"""(?P<dot>\.)?(?P<name>[A-Za-z_]\w*)  # data, .percentage
    |   \[(?P<index>\d+)\]                  # [0]
    |   \[(?P<quote>["'])(?P<key>.*?)(?P=quote)\]  # ["motor: left"]
    """,
    re.ASCII | re.VERBOSE,
)
_KEY_FIELDS = ("name", "key")


class _Absent:
    """Type of `ABSENT`."""

    def __repr__(self) -> str:
        return "ABSENT"


ABSENT = _Absent()
"""What a keyed step finds when there is no such element: the message says nothing about this signal."""


def parse_field_path(path: str) -> Tuple[Step, ...]:
    """Splits a path into its steps; the empty path has none.

    >>> parse_field_path('status["motor: left"].values[0]')
    ('status', Keyed(key='motor: left'), 'values', 0)

    Raises:
        ValueError: it is no path; the message is the second half of one.
    """
    steps = []
    position = 0
    while position < len(path):
        part = _PART.match(path, position)
        # a dot stands before every name but the first, and nowhere else
        if part is None or (part["name"] is not None and (part["dot"] is None) != (position == 0)):
            raise ValueError(
                f'but {path[position:]!r} is neither a name nor an index such as [0] nor a key such as ["motor"]'
            )
        if part["name"] is not None:
            steps.append(part["name"])
        elif part["index"] is not None:
            steps.append(int(part["index"]))
        else:
            steps.append(Keyed(part["key"]))
        position = part.end()
    if steps and not isinstance(steps[0], str):
        raise ValueError(f"but {path!r} does not begin with a field's name")
    return tuple(steps)


def key_field(fields: Iterable[str]) -> Optional[str]:
    """Returns which of an element's fields a keyed step compares: `name` or `key`, None when it has neither."""
    there = set(fields)
    return next((name for name in _KEY_FIELDS if name in there), None)


def number_of_text(text: Any) -> Any:
    """Returns the number that a key-value's text is (1 for True, 0 for False), or what it is if it is none."""
    if not isinstance(text, str):
        return text
    flag = _FLAGS.get(text.lower())
    if flag is not None:
        return flag
    try:
        return text if "_" in text else float(text)  # float() would take 1_000
    except ValueError:
        return text


_FLAGS = {"true": 1.0, "false": 0.0}
