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
from operator import itemgetter
from typing import Any, Callable, Iterable, NamedTuple, Sequence, Union

from .elements import (
    MOST_ELEMENTS,
    NAME_ARRAYS,
    NOT_A_NUMBER,
    BadDatum,
    DriverStatus,
    Elements,
    is_own_status,
    numbered,
    stamp_of,
    too_many,
    unequal,
    unnamed,
)
from .errors import ConfigError
from .formatting import describe
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


class _Absent:
    """Type of `ABSENT`."""

    def __repr__(self) -> str:
        return "ABSENT"


ABSENT = _Absent()
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
    if len(steps) == 1 and isinstance(steps[0], str):
        read = itemgetter(steps[0])

        def get_field(message: Any) -> Any:
            value = read(message)
            return _whole(value) if type(value) is dict else value

        return get_field
    return bind_steps(steps, _whole if isinstance(steps[-1], str) else _element_value)


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


def named_element(elements: Sequence[Any], names: Sequence[Any], key: str, array: str, place: str) -> Any:
    """Returns the element with a name; ABSENT for an empty array: not measured. `place` is that of the names."""
    if len(elements) != len(names):
        return unequal(array, place, len(elements), len(names)) if len(elements) else ABSENT
    return elements[names.index(key)] if key in names else _unnamed_among(names, place) or ABSENT


def named_elements(
    elements: Sequence[Any], names: Sequence[Any], array: str, place: str, pattern: str, read: Getter
) -> Any:
    """Returns the values of the elements whose names match; ABSENT if there are none. `place` is that of the names.

    `read` returns ABSENT for an element that is left out.
    """
    if len(elements) != len(names):
        return unequal(array, place, len(elements), len(names)) if len(elements) else ABSENT
    if len(elements) > MOST_ELEMENTS:
        return too_many(len(elements))
    chosen = ((name, element) for name, element in zip(names, elements) if matches_pattern(name, pattern))
    return _unnamed_among(names, place) or _read_all(chosen, read) or ABSENT


def _unnamed_among(names: Sequence[Any], place: str) -> BadDatum | None:
    """Returns the datum for the first name that is not a text; None if all are."""
    return next((unnamed(f"{place}[{at}]", name) for at, name in enumerate(names) if type(name) is not str), None)


def numbered_elements(elements: Sequence[Any], read: Getter | None) -> Any:
    """Returns the values of all elements, named by their index; without `read`, the elements are the values."""
    named = numbered(elements)
    return _read_all(named, read) if isinstance(named, Elements) and read is not None else named


def _read_all(elements: Iterable[tuple[str, Any]], read: Getter) -> Elements:
    """Reads the rest of the path from each element; those that lack a keyed element there are left out."""
    values = ((name, read(element)) for name, element in elements)
    return Elements((name, value) for name, value in values if value is not ABSENT)


def bind_steps(steps: Sequence[Step], finish: Getter) -> Getter:
    """Returns a function that reads a path which is not empty, as `mapping_getter`.

    `finish` returns the value of what the path leads to; numbers without a name are passed on without it.
    """
    at = next((number for number, step in enumerate(steps) if isinstance(step, Every)), len(steps))
    before, after = steps[:at], steps[at + 1 :]
    every: Any = steps[at] if at < len(steps) else None
    read = _element_reader(after, finish)

    def get(message: Any) -> Any:
        above: Any = None
        array = ""
        for step in before:
            if isinstance(step, str):
                above, array, message = message, step, message[step]
            elif isinstance(step, int):
                elements = _listed(message)
                if step >= len(elements):
                    return None
                above, message = None, elements[step]
            else:
                elements = _listed(message)
                names, place = _names_of(elements, above, array)
                key = step.key  # type: ignore[union-attr]
                message = named_element(elements, names, key, array, place)
                if message is ABSENT or type(message) is BadDatum:
                    return message
                above = None
        if every is None:
            return finish(message)
        elements = _listed(message)
        if every.pattern is None:
            is_plain = not after and len(elements) and type(elements[0]) in (int, float)
            return numbered_elements(elements, None if is_plain else read)
        names, place = _names_of(elements, above, array)
        return named_elements(elements, names, array, place, every.pattern, read)

    return get if isinstance(steps[0], str) else lambda message: get([message])


def _element_reader(steps: Sequence[Step], finish: Getter) -> Getter:
    """Returns a function that reads the rest of a path from one of several elements."""
    read_rest = bind_steps(steps, finish) if steps else finish

    def read(element: Any) -> Any:
        if _is_own(element):
            return ABSENT
        value = read_rest(element)
        return NOT_A_NUMBER if type(value) in (dict, list, memoryview) else value

    return read


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
