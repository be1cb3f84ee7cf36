"""The path of a value inside a message: `data`, `battery.percentage`, `cell_voltage[0]`, `status["motor"].level`.

A name selects a field, a number in brackets an element by its index, a quoted text in brackets the element with that
name. The name of an element is its own field `name`, `key` or `child_frame_id`: a status in /diagnostics, a value in a
status, a frame in /tf. Elements without one have their names in an array beside theirs: `effort["wheel_left"]` in a
JointState.

A path of a single message with a name begins with that name: `["motor: left"]` for a topic of DiagnosticStatus.

`[*]` selects all elements, by index, and a quoted text with `*` or `?` those whose names match: `effort["wheel_*"]`.
"""

from __future__ import annotations

import base64
import re
from functools import lru_cache
from typing import Any, Callable, Iterable, NamedTuple, Sequence, Union

from .elements import (
    MOST_ELEMENTS,
    NAME_ARRAYS,
    NOT_A_NUMBER,
    BadDatum,
    DriverStatus,
    Elements,
    is_own_status,
    stamp_of,
    too_many,
)
from .errors import ConfigError
from .formatting import datum_text, describe
from .patterns import matches_pattern


class Keyed(NamedTuple):
    """A step to the element with this name."""

    key: str


class Every(NamedTuple):
    """A step to all elements by index, or to those whose names match a pattern."""

    pattern: str | None = None
    """With `*` for any text and `?` for any character; None selects all elements, by index."""


Step = Union[str, int, Keyed, Every]
"""A field's name, an element's index or name, or several elements."""

Getter = Callable[[Any], Any]

_PART = re.compile(
    r"""(?P<dot>\.)?(?P<name>[A-Za-z_]\w*)  # data, .percentage
    |   \[(?P<index>\d{1,9}|\*)\]           # [0], [*]
    |   \[(?P<quote>["'])(?P<key>.*?)(?P=quote)\]  # ["motor: left"], ["motor: *"]
    """,
    re.ASCII | re.VERBOSE,
)
_KEY_FIELDS = ("name", "key", "child_frame_id")
_BOOLEANS = {"true": 1.0, "false": 0.0}
_TIME_FIELDS = (("secs", "nsecs"), ("sec", "nanosec"))
_STATUS_FIELDS = {"level", "name", "message"}


ABSENT = object()
"""Result of a path whose keyed element is not in the message: the message does not concern the signal."""


def parse_field_path(path: str) -> tuple[Step, ...]:
    """Splits a path into its steps; the empty path has none. Raises ValueError for what is no path.

    >>> parse_field_path('status["motor: left"].values[0]')
    ('status', Keyed(key='motor: left'), 'values', 0)
    """
    steps, rest = leading_path(path)
    if rest:
        raise ValueError(f'{describe(rest)} is not a name, an index such as [0] or a key such as ["motor"]')
    return steps


def leading_path(text: str) -> tuple[tuple[Step, ...], str]:
    """Returns the steps of the path with which a text begins, and the rest; raises ValueError as `parse_field_path`."""
    steps: list[Step] = []
    position = 0
    while True:
        part = _PART.match(text, position)
        # Every name but the first follows a dot, and nothing else does.
        if part is None or (part["name"] is not None and (part["dot"] is None) != (position == 0)):
            break
        if part["name"] is not None:
            steps.append(part["name"])
        elif part["index"] is not None:
            steps.append(Every() if part["index"] == "*" else int(part["index"]))
        else:
            steps.append(Every(part["key"]) if "*" in part["key"] or "?" in part["key"] else Keyed(part["key"]))
        position = part.end()
    if steps and (isinstance(steps[0], int) or steps[0] == Every()):
        raise ValueError('a path starts with the name of a field, or with the name of the message as in ["motor"]')
    if sum(isinstance(step, Every) for step in steps) > 1:
        raise ValueError("only one part of a path may select several elements")
    return tuple(steps), text[position:]


@lru_cache(maxsize=1000)  # asked for each signal of each report
def every_step(path: str) -> Every | None:
    """Returns the step that selects several elements; None if there is none, or the text is no path."""
    try:
        return next((step for step in parse_field_path(path) if isinstance(step, Every)), None)
    except ValueError:
        return None


def element_path(path: str, name: str) -> str:
    """Returns a path to several elements as that to the one with a name.

    >>> element_path("status[*].level", "7")
    'status[7].level'
    """
    every = every_step(path)
    if every is None or every.pattern is None:
        return path.replace("[*]", f"[{name}]")
    quote = "'" if '"' in name else '"'
    for given in ("'", '"'):
        path = path.replace(f"[{given}{every.pattern}{given}]", f"[{quote}{name}{quote}]")
    return path


def mapping_getter(field: str) -> Getter:
    """Returns a function that reads the path `field` from a message that is a mapping.

    The function returns the whole message for an empty path, None for an index beyond the end, and ABSENT if no
    element has the key. A path that selects several elements returns `Elements`, a time a `Stamp`, a DiagnosticStatus
    a `DriverStatus`, and what cannot be any of these a `BadDatum`. It raises KeyError, TypeError or AttributeError if
    the message has no such field. What is not a path is a ConfigError.
    """
    try:
        steps = parse_field_path(field)
    except ValueError as error:
        raise ConfigError(f"field {describe(field)}: {error}") from None
    return steps_getter(steps)


def steps_getter(steps: Sequence[Step]) -> Getter:
    """Returns a function that reads a path which is split into steps, as `mapping_getter`."""
    if not steps:
        return lambda message: message
    finish = _whole if isinstance(steps[-1], str) else _element_value
    if isinstance(steps[0], str):
        return lambda message: _read(message, steps, finish)
    return lambda message: _read([message], steps, finish)


def key_field(fields: Iterable[str]) -> str | None:
    """Returns the field of an element that a key is compared with, None if it has none."""
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


def _read(message: Any, steps: Sequence[Step], finish: Getter, above: Any = None, array: str = "") -> Any:
    """Reads the rest of a path, whose value `finish` returns from what it leads to.

    An array is the field `array` of the message `above`, if it has that name.
    """
    if not steps:
        return finish(message)
    step, rest = steps[0], steps[1:]
    if isinstance(step, str):
        return _read(message[step], rest, finish, message, step)
    elements = _listed(message)
    if isinstance(step, int):
        return _read(elements[step], rest, finish) if step < len(elements) else None
    if isinstance(step, Every) and len(elements) > MOST_ELEMENTS:
        return too_many(len(elements))
    if step == Every():
        numbered = Elements(zip(map(str, range(len(elements))), elements))
        is_plain = not rest and len(elements) and type(elements[0]) in (int, float)
        return numbered if is_plain else _read_all(numbered, rest, finish)
    names, place = _names_of(elements, above, array)
    if len(elements) != len(names):
        if not len(elements):
            return ABSENT  # not measured
        return BadDatum(f"{array} has {len(elements)} elements, {place} has {len(names)}")
    unnamed = (
        BadDatum(f"{place}[{at}] is not a text: {datum_text(name)}")
        for at, name in enumerate(names)
        if type(name) is not str
    )
    if isinstance(step, Keyed):
        if step.key in names:
            return _read(elements[names.index(step.key)], rest, finish)
        return next(unnamed, ABSENT)
    chosen = (pair for pair in zip(names, elements) if matches_pattern(pair[0], step.pattern or ""))
    return next(unnamed, None) or _read_all(chosen, rest, finish) or ABSENT


def _read_all(elements: Iterable[tuple[str, Any]], steps: Sequence[Step], finish: Getter) -> Elements:
    """Reads the rest of a path from each element.

    Statuses of this package's nodes, and elements without the keyed one, are left out.
    """
    values = ((name, _read(element, steps, finish)) for name, element in elements if not _is_own(element))
    kept = ((name, value) for name, value in values if value is not ABSENT)
    return Elements((name, NOT_A_NUMBER if type(value) in (dict, list, memoryview) else value) for name, value in kept)


def _is_own(element: Any) -> bool:
    """Returns whether an element is a status of this package's nodes."""
    if type(element) is not dict or not element.keys() >= _STATUS_FIELDS:
        return False
    values = element.get("values")
    pairs = values if isinstance(values, list) else ()
    return is_own_status(element["name"], [pair["key"] for pair in pairs if type(pair) is dict and "key" in pair])


def _names_of(elements: Sequence[Any], above: Any, array: str) -> tuple[Sequence[Any], str]:
    """Returns the names of elements, their own or those in an array beside `array` in the message above, and its name.

    Its own name is that of the array.
    """
    own = key_field(elements[0]) if len(elements) and type(elements[0]) is dict else None
    if own is None and type(above) is dict:
        for name in NAME_ARRAYS:
            if name != array and isinstance(above.get(name), list):
                return above[name], name
    return [element[own] for element in elements], array


def _listed(message: Any) -> Sequence[Any]:
    """Returns an array: numbers of a serialized message are a memoryview; bytes are base64 text in JSON."""
    if isinstance(message, (list, tuple, memoryview)):
        return message
    if not isinstance(message, str):
        raise TypeError("not a list")
    try:
        return base64.b64decode(message, validate=True)
    except ValueError:
        raise TypeError("a text has no elements") from None


def _element_value(element: Any) -> Any:
    """Returns the value of an element: of a KeyValue its number, of another message what `_whole` makes of it."""
    if type(element) is not dict:
        return element
    return number_of_text(element["value"]) if "key" in element and "value" in element else _whole(element)


def _whole(value: Any) -> Any:
    """Returns a stamp or a driver's status for a mapping that is one; anything else unchanged."""
    if type(value) is dict:
        fields = value.keys()
        for seconds, nanoseconds in _TIME_FIELDS:
            if fields == {seconds, nanoseconds}:
                return stamp_of(value[seconds], value[nanoseconds])
        if fields >= _STATUS_FIELDS:
            return DriverStatus(value["level"], value["message"])
    return value
