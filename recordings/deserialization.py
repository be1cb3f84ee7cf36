"""Messages from bytes, ROS 1 and CDR, with bounded work.

A message is an object with an attribute per field. Work and memory are bounded by the size of the bytes, whatever these
and the definition say: a length is compared with the bytes that are left, and an element of an array takes at least one
byte.

Sources: wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes; OMG DDS-XTypes, XCDR version 1.
"""

from __future__ import annotations

import struct
from typing import Any, Callable, Dict, List, NamedTuple, Sequence, Set, Tuple

import numpy as np

from robot_health_monitor.core.definitions import NUMBERS, SEQUENCE, Definitions, Field

_DEEPEST = 32
"""Types in one another."""
_MOST_ELEMENTS = 500_000
"""Strings and messages in the arrays of one message: each takes a few hundred bytes of memory."""
EMPTY = Field("structure_needs_at_least_one_member", "uint8", None)
"""What an empty message consists of in ROS 2."""

_CDR_HEADER = 4
"""Bytes before a CDR message, to which its alignment does not refer; the second is its byte order."""

_Read = Callable[[bytes, int], Tuple[Any, int]]
"""Reads a value at a position; returns it with the position behind it. Raises ValueError and struct.error."""


class _Shape(NamedTuple):
    least: int
    """Bytes that a value has at least."""
    values: int
    """Messages, numbers and strings in it, without the contents of arrays."""


class Deserializer:
    """Deserializes messages of the types in one definition."""

    def __init__(self, definitions: Definitions, is_cdr: bool) -> None:
        """Compiles nothing yet.

        Args:
            definitions: the types.
            is_cdr: the messages are CDR, with a header; else they are those of ROS 1.
        """
        self._definitions = definitions
        self._is_cdr = is_cdr
        self._shapes: Dict[str, _Shape] = {}
        self._readers: Dict[Tuple[str, str], _Read] = {}
        self._elements_left = 0
        self.classes: Dict[str, Any] = {name: type("Message", (), {"type_name": name}) for name in definitions}
        """The class of the messages of each type."""

    def bind(self, name: str) -> Callable[[bytes], Any]:
        """Returns a function that deserializes messages of a type; it raises ValueError if they do not match it.

        Raises:
            ValueError: the type contains itself, is too large, or contains a type that is not known.
        """
        self._measure(name, set())
        readers = [self._message_reader(name, order) for order in "><"]
        is_cdr = self._is_cdr
        start, padding = (_CDR_HEADER, 3) if is_cdr else (0, 0)

        def get(data: bytes) -> Any:
            self._elements_left = _MOST_ELEMENTS
            try:
                message, end = readers[data[1] if is_cdr else 1](data, start)
            except (struct.error, IndexError) as error:
                raise ValueError(f"too short, or of another format: {error}") from None
            if not end <= len(data) <= end + padding:
                raise ValueError(f"{len(data)} bytes, expected {end}")
            return message

        return get

    def _fields(self, name: str) -> Sequence[Field]:
        if name not in self._definitions:
            raise ValueError(f"the definition of {name} is missing")
        return self._definitions[name].fields or ((EMPTY,) if self._is_cdr else ())

    def _measure(self, name: str, above: Set[str]) -> _Shape:
        """Computes the shapes of a type and of the types in it."""
        if name in self._shapes:
            return self._shapes[name]
        if name in above or len(above) >= _DEEPEST:
            raise ValueError(f"{name} contains itself, or more than {_DEEPEST} levels of types")
        least, values = 0, 1
        for field in self._fields(name):
            one = self._shape_of(field.kind, above | {name})
            if field.size is not None and not one.least:
                raise ValueError(f"{field.name} of {name} is an array of empty values")
            least += one.least if field.size is None else 4 if field.size == SEQUENCE else field.size * one.least
            values += one.values if field.size is None else 1
        # Each value that is not empty takes a byte, and is at most _DEEPEST messages deep.
        if values > 100 + 2 * _DEEPEST * least:
            raise ValueError(f"{name} consists of {values} values, nearly all of them empty")
        self._shapes[name] = _Shape(least, values)
        return self._shapes[name]

    def _shape_of(self, kind: str, above: Set[str]) -> _Shape:
        if kind in NUMBERS:
            return _Shape(struct.calcsize(f"<{NUMBERS[kind]}"), 1)
        return _Shape(4, 1) if kind == "string" else self._measure(kind, above)

    def _message_reader(self, name: str, order: str) -> _Read:
        if (name, order) in self._readers:
            return self._readers[name, order]
        fields = self._fields(name)
        names = [field.name for field in fields]
        readers = [self._field_reader(field, order) for field in fields]
        new: Any = self.classes[name]

        def read(data: bytes, at: int) -> Tuple[Any, int]:
            values: List[Any] = []
            for reader in readers:
                value, at = reader(data, at)
                values.append(value)
            message = new()
            message.__dict__.update(zip(names, values))
            return message, at

        self._readers[name, order] = read
        return read

    def _field_reader(self, field: Field, order: str) -> _Read:
        if field.kind in NUMBERS:
            letter = f"{order}{NUMBERS[field.kind]}"
            one = self._number_reader(letter)
            return one if field.size is None else self._numbers_reader(letter, field.size, order)
        one = self._string_reader(order) if field.kind == "string" else self._message_reader(field.kind, order)
        if field.size is None:
            return one
        return self._elements_reader(one, self._shape_of(field.kind, set()).least, field.size, order)

    def _number_reader(self, letter: str) -> _Read:
        number = struct.Struct(letter)
        unpack, size = number.unpack_from, number.size
        if not self._is_cdr or size == 1:
            return lambda data, at: (unpack(data, at)[0], at + size)

        def read(data: bytes, at: int) -> Tuple[Any, int]:
            at += (_CDR_HEADER - at) % size
            return unpack(data, at)[0], at + size

        return read

    def _string_reader(self, order: str) -> _Read:
        unpack = struct.Struct(f"{order}I").unpack_from

        def read_ros1(data: bytes, at: int) -> Tuple[Any, int]:
            end = at + 4 + unpack(data, at)[0]
            if end > len(data):
                raise ValueError("too short: a string goes beyond the message")
            return data[at + 4 : end].decode("utf-8", "replace"), end

        def read_cdr(data: bytes, at: int) -> Tuple[Any, int]:
            at += -at % 4
            end = at + 4 + unpack(data, at)[0]
            if end > len(data):
                raise ValueError("too short: a string goes beyond the message")
            return data[at + 4 : max(at + 4, end - 1)].decode("utf-8", "replace"), end  # without the zero at its end

        return read_cdr if self._is_cdr else read_ros1

    def _count_reader(self, size: int, order: str) -> _Read:
        return self._number_reader(f"{order}I") if size == SEQUENCE else lambda data, at: (size, at)

    def _numbers_reader(self, letter: str, size: int, order: str) -> _Read:
        count_at = self._count_reader(size, order)
        form = np.dtype(letter)
        alignment = form.itemsize if self._is_cdr else 1

        def read(data: bytes, at: int) -> Tuple[Any, int]:
            count, at = count_at(data, at)
            if not count:
                return np.empty(0, form), at
            at += (_CDR_HEADER - at) % alignment
            end = at + count * form.itemsize
            if end > len(data):
                raise ValueError("too short: an array goes beyond the message")
            return np.frombuffer(data, form, count, at), end

        return read

    def _elements_reader(self, one: _Read, least: int, size: int, order: str) -> _Read:
        count_at = self._count_reader(size, order)

        def read(data: bytes, at: int) -> Tuple[Any, int]:
            count, at = count_at(data, at)
            self._elements_left -= count
            if at + count * least > len(data) or self._elements_left < 0:
                raise ValueError(f"an array of {count} elements, expected at most {_MOST_ELEMENTS} within the message")
            elements: List[Any] = []
            for _ in range(count):
                element, at = one(data, at)
                elements.append(element)
            return elements, at

        return read
