"""The path of a value inside a message: `data`, `battery.percentage`, `cell_voltage[0]`, `status["motor"].level`.

A name selects a field, a number in brackets an element by its index, a quoted text in brackets the element with that
`name` (or `key`): it selects a status in /diagnostics, and a value in a status.
"""

from __future__ import annotations

import re
from operator import itemgetter
from typing import Any, Callable, Iterable, NamedTuple, Optional, Tuple, Union

from .errors import ConfigError
from .parameters import describe


class Keyed(NamedTuple):
    """A step to the element whose `name` or `key` is this text."""

    key: str


Step = Union[str, int, Keyed]
"""A field's name, an element's index, or an element's key."""

_PART = re.compile(
    r"""(?P<dot>\.)?(?P<name>[A-Za-z_]\w*)  # data, .percentage
    |   \[(?P<index>\d{1,9})\]              # [0]
    |   \[(?P<quote>["'])(?P<key>.*?)(?P=quote)\]  # ["motor: left"]
    """,
    re.ASCII | re.VERBOSE,
)
_KEY_FIELDS = ("name", "key")
_BOOLEANS = {"true": 1.0, "false": 0.0}


class _Absent:
    """Type of `ABSENT`."""

    def __repr__(self) -> str:
        return "ABSENT"


ABSENT = _Absent()
"""Result of a path whose keyed element is not in the message: the message does not concern the signal."""


def parse_field_path(path: str) -> Tuple[Step, ...]:
    """Splits a path into its steps; the empty path has none. Raises ValueError for what is no path.

    >>> parse_field_path('status["motor: left"].values[0]')
    ('status', Keyed(key='motor: left'), 'values', 0)
    """
    steps = []
    position = 0
    while position < len(path):
        part = _PART.match(path, position)
        # Every name but the first follows a dot, and nothing else does.
        if part is None or (part["name"] is not None and (part["dot"] is None) != (position == 0)):
            rest = describe(path[position:])
            raise ValueError(f'{rest} is not a name, an index such as [0] or a key such as ["motor"]')
        if part["name"] is not None:
            steps.append(part["name"])
        elif part["index"] is not None:
            steps.append(int(part["index"]))
        else:
            steps.append(Keyed(part["key"]))
        position = part.end()
    if steps and not isinstance(steps[0], str):
        raise ValueError("a path starts with the name of a field")
    return tuple(steps)


def mapping_getter(field: str) -> Callable[[Any], Any]:
    """Returns a function that reads the path `field` from a message that is a mapping.

    The function returns the whole message for an empty path, None for an index beyond the end, and ABSENT if no
    element has the key. It raises KeyError, TypeError or AttributeError if the message has no such field. What is not a
    path is a ConfigError.
    """
    try:
        steps = parse_field_path(field)
    except ValueError as error:
        raise ConfigError(f"field {describe(field)}: {error}") from None
    if len(steps) == 1:
        return itemgetter(steps[0])

    def get(message: Any) -> Any:
        for step in steps:
            if isinstance(step, Keyed):
                message = _element(message, step.key)
                if message is ABSENT:
                    return ABSENT
            elif isinstance(step, int) and step >= len(message):
                return None
            else:
                message = message[step]
        if steps and isinstance(steps[-1], Keyed) and "key" in message:
            return number_of_text(message.get("value"))
        return message

    return get


def key_field(fields: Iterable[str]) -> Optional[str]:
    """Returns the field of an element that a key is compared with: `name` or `key`, None if it has neither."""
    present = set(fields)
    return next((name for name in _KEY_FIELDS if name in present), None)


def number_of_text(text: Any) -> Any:
    """Returns the number in the text of a key-value (True: 1, False: 0); what is not a number is returned as it is."""
    if not isinstance(text, str):
        return text
    boolean = _BOOLEANS.get(text.lower())
    if boolean is not None:
        return boolean
    try:
        return text if "_" in text else float(text)  # float() would accept 1_000
    except ValueError:
        return text


def _element(elements: Any, key: str) -> Any:
    for element in elements:
        field = key_field(element)
        if field is not None and element[field] == key:
            return element
    return ABSENT
