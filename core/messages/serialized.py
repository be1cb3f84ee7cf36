"""Values of fields from serialized messages, ROS 1, CDR and JSON, by the definitions that come with them.

The number of a std_msgs message, and the statuses of a DiagnosticArray, are read without making a message. Any other
message becomes a mapping, up to the last field that is needed, whose arrays of numbers are views of the bytes. Work and
memory are bounded by the size of the bytes, whatever these and the definition say: a length is compared with the bytes
that are left, and an element of an array takes at least one byte.

Sources: wiki.ros.org/roscpp/Overview/MessagesSerializationAndAdaptingTypes; OMG DDS-XTypes, XCDR version 1.
"""

from __future__ import annotations

import functools
import struct
import sys
from array import array
from typing import Any, Callable, Literal, NamedTuple, Sequence, Tuple, cast

from ..values import (
    ABSENT,
    ARRAY_TYPE,
    MOST_ELEMENTS,
    OWN_KEY,
    STATUS_TYPE,
    ConfigError,
    DriverStatus,
    Elements,
    Getter,
    every_step,
    is_own_status,
    leading_path,
    matches_pattern,
    parse_field_path,
    printable,
    read_json,
    too_many,
)
from .definitions import NUMBERS, SEQUENCE, Definition, Definitions, Field, parse_definition
from .mapping_field import MISSING, MappingField
from .native_messages import bytes_as_text
from .raw_messages import RawFormat
from .typed_field import typed_getter

_LONGEST_PROBLEM = 300
"""Characters of an error."""
_DEEPEST = 32
"""Types in one another."""
_MOST_ELEMENTS = 500_000
"""Strings and messages in the arrays of one message: each takes a few hundred bytes of memory."""
_STATUS_FIELDS = ["level", "name", "message", "hardware_id", "values"]
_EMPTY = Field("structure_needs_at_least_one_member", "uint8", None)
"""What an empty message consists of in ROS 2."""

_CDR_HEADER = 4
"""Bytes before a CDR message, to which its alignment does not refer; the second is its byte order."""
_NATIVE = "<" if sys.byteorder == "little" else ">"

_Read = Callable[[bytes, int], Tuple[Any, int]]
"""Reads a value at a position; returns it with the position behind it. Raises ValueError and struct.error."""


class _Shape(NamedTuple):
    least: int
    """Bytes that a value has at least."""
    values: int
    """Messages, numbers and strings in it, without the contents of arrays."""


class SerializedType:
    """The type of a topic's messages as bytes, with the types in it."""

    def __init__(self, topic: str, raw_format: RawFormat) -> None:
        """Parses nothing yet; `topic` is the resolved name, for errors."""
        self._topic = topic
        self.raw_format = raw_format
        self._is_cdr = raw_format.message_encoding == "cdr"
        self._data: bytes | None = None
        self._message: Any = None
        self._needed = 0
        """How many fields of a message are read, from the first one on."""

    @functools.cached_property
    def definitions(self) -> Definitions:
        """The type and those that it contains. Raises ConfigError if the definition cannot be parsed."""
        raw = self.raw_format
        try:
            return parse_definition(raw.type_name, raw.schema, raw.schema_encoding, is_ros1=not self._is_cdr)
        except ValueError as error:
            raise self._unusable(error) from None

    def field_getter(self, field: str) -> Getter:
        """Returns a function that reads `field`, a path as in values/field_path.py, from messages.

        For an empty field it returns the whole message as a mapping. It raises ValueError for bytes that are no message
        of the type, or JSON without the field. Raises ConfigError if the type has no such field.
        """
        type_name = self.raw_format.type_name
        if self.raw_format.message_encoding == "json":
            return json_getter(self._topic, type_name, field)
        read = typed_getter(self._topic, type_name, self.definitions, field)
        fields = self.definitions[type_name].fields
        self._needed = max(self._needed, _fields_needed(fields, field))
        needed = {**self.definitions, type_name: Definition(fields[: self._needed])}
        try:
            deserializer = Deserializer(needed, self._is_cdr)
            self._deserialize = deserializer.bind(type_name)
            direct = deserializer.bind_directly(type_name, field)
        except ValueError as error:
            raise self._unusable(error) from None
        if direct is not None:
            return direct
        self._data = None

        def get(data: bytes) -> Any:
            if data is not self._data:  # several fields are read from one message
                try:
                    self._message = self._deserialize(data)
                except ValueError as error:
                    raise ValueError(f"not a {type_name}: {error}") from None
                self._data = data
            return _plain(read(self._message))

        return get

    def _unusable(self, error: Exception) -> ConfigError:
        text = f"{self._topic}: cannot use the definition of {self.raw_format.type_name}: {error}"
        return ConfigError(printable(" ".join(text.split()))[:_LONGEST_PROBLEM])


def _fields_needed(fields: Sequence[Field], path: str) -> int:
    """Returns how many fields of a message, from the first one on, are read for a path."""
    steps, condition = leading_path(path)
    names = [field.name for field in fields]
    is_simple = not condition and all(isinstance(step, (str, int)) for step in steps)
    return names.index(str(steps[0])) + 1 if is_simple and steps and steps[0] in names else len(names)


class _JsonField(MappingField):
    null_is_nan = True


def json_getter(topic: str, type_name: str, field: str) -> Getter:
    """Returns a function that reads `field`, as `SerializedType.field_getter`, from JSON in rosbridge's form.

    It raises ValueError also for a message without the field. Raises ConfigError if the type has no such field.
    """
    read = _JsonField(topic, type_name, field).read

    def get(data: bytes) -> Any:
        message = read_json(data)
        if not isinstance(message, dict):
            raise ValueError("not a JSON object")
        try:
            return read(message)
        except MISSING as error:
            raise ValueError(f"no field {field}: {error}") from None

    return get


def _plain(value: Any) -> Any:
    """Returns a value whose arrays of numbers are lists, and those of bytes are base64 text."""
    if type(value) is dict:
        return {name: _plain(each) for name, each in value.items()}
    if type(value) is list:
        return [_plain(each) for each in value]
    if type(value) is memoryview:
        return bytes_as_text(value) if value.format == "B" else value.tolist()
    return value


class Deserializer:
    """Deserializes messages of the types in one definition."""

    def __init__(self, definitions: Definitions, is_cdr: bool) -> None:
        """Compiles nothing yet. CDR messages have a header; the others are those of ROS 1."""
        self._definitions = definitions
        self._is_cdr = is_cdr
        self._text_format = (3, 1) if is_cdr else (0, 0)
        """Most bytes before the length of a string, and number of zeros at its end."""
        self._shapes = {kind: _Shape(struct.calcsize(f"<{letter}"), 1) for kind, letter in NUMBERS.items()}
        self._shapes["string"] = _Shape(4, 1)
        self._readers: dict[tuple[str, str], _Read] = {}
        self._elements_left = 0

    def bind(self, name: str) -> Callable[[bytes], Any]:
        """Returns a function that deserializes messages of a type; it raises ValueError if they do not match it.

        Bytes behind the message are ignored. Raises ValueError if the type contains itself, is too large, or contains a
        type that is not known.
        """
        self._measure(name, set())
        return self._getter([self._message_reader(name, order) for order in "><"])

    def bind_directly(self, name: str, field: str) -> Callable[[bytes], Any] | None:
        """Returns a function that reads a field without making a message, raising as that of `bind`, which comes first.

        None if the field is not the number of a message of one number, nor several statuses of a DiagnosticArray.
        """
        fields = self._fields(name)
        if len(fields) == 1 and fields[0].name == field and fields[0].kind in NUMBERS and fields[0].size is None:
            return self._getter([self._field_reader(fields[0], order) for order in "><"])
        every = every_step(field)
        pattern = every and every.pattern
        if (
            name != ARRAY_TYPE
            or pattern is None
            or parse_field_path(field) != ("status", every)
            or [each.name for each in self._fields(STATUS_TYPE)] != _STATUS_FIELDS
        ):
            return None
        return self._getter([self._statuses_reader(pattern, order) for order in "><"])

    def _getter(self, readers: Sequence[_Read]) -> Callable[[bytes], Any]:
        """Returns what reads a value behind the header; `readers` are for both byte orders."""
        is_cdr = self._is_cdr
        start = _CDR_HEADER if is_cdr else 0

        def get(data: bytes) -> Any:
            self._elements_left = _MOST_ELEMENTS
            try:
                value, end = readers[data[1] if is_cdr else 1](data, start)
            except (struct.error, IndexError) as error:
                raise ValueError(f"too short, or of another format: {error}") from None
            if end > len(data):
                raise ValueError(f"too short: {len(data)} bytes, expected {end}")
            return value

        return get

    def _fields(self, name: str) -> Sequence[Field]:
        if name not in self._definitions:
            raise ValueError(f"the definition of {name} is missing")
        return self._definitions[name].fields or ((_EMPTY,) if self._is_cdr else ())

    def _measure(self, name: str, above: set[str]) -> _Shape:
        """Computes the shapes of a type and of the types in it."""
        if name in self._shapes:
            return self._shapes[name]
        if name in above or len(above) >= _DEEPEST:
            raise ValueError(f"{name} contains itself, or more than {_DEEPEST} levels of types")
        least, values = 0, 1
        for field in self._fields(name):
            one = self._measure(field.kind, above | {name})
            if field.size is not None and not one.least:
                raise ValueError(f"{field.name} of {name} is an array of empty values")
            least += one.least if field.size is None else 4 if field.size == SEQUENCE else field.size * one.least
            values += one.values if field.size is None else 1
        # Each value that is not empty takes a byte, and is at most _DEEPEST messages deep.
        if values > 100 + 2 * _DEEPEST * least:
            raise ValueError(f"{name} consists of {values} values, nearly all of them empty")
        self._shapes[name] = _Shape(least, values)
        return self._shapes[name]

    def _message_reader(self, name: str, order: str) -> _Read:
        if (name, order) in self._readers:
            return self._readers[name, order]
        fields = self._fields(name)
        names = [field.name for field in fields]
        readers = [self._field_reader(field, order) for field in fields]

        def read(data: bytes, at: int) -> tuple[Any, int]:
            values: list[Any] = []
            for reader in readers:
                value, at = reader(data, at)
                values.append(value)
            return dict(zip(names, values)), at

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
        return self._elements_reader(one, self._shapes[field.kind].least, field.size, order)

    def _number_reader(self, letter: str) -> _Read:
        number = struct.Struct(letter)
        unpack, size = number.unpack_from, number.size
        alignment = size if self._is_cdr else 1

        def read(data: bytes, at: int) -> tuple[Any, int]:
            at += (_CDR_HEADER - at) % alignment
            return unpack(data, at)[0], at + size

        return read

    def _string_reader(self, order: str) -> _Read:
        length = struct.Struct(f"{order}I").unpack_from
        padding, terminator = self._text_format

        def read(data: bytes, at: int) -> tuple[Any, int]:
            start = at + (-at & padding) + 4
            end = start + length(data, start - 4)[0]
            return data[start : end - terminator].decode("utf-8", "replace"), end

        return read

    def _count_reader(self, size: int, order: str) -> _Read:
        return self._number_reader(f"{order}I") if size == SEQUENCE else lambda data, at: (size, at)

    def _numbers_reader(self, letter: str, size: int, order: str) -> _Read:
        count_at = self._count_reader(size, order)
        item, kind = struct.calcsize(letter), cast("Literal['d']", letter[1])  # any of struct's letters
        alignment = item if self._is_cdr else 1
        is_native = item == 1 or order == _NATIVE

        def read(data: bytes, at: int) -> tuple[Any, int]:
            count, at = count_at(data, at)
            if count:
                at += (_CDR_HEADER - at) % alignment
            end = at + count * item
            if end > len(data):
                raise ValueError("too short: an array goes beyond the message")
            numbers = memoryview(data)[at:end]  # no copy of an image
            if is_native:
                return numbers.cast(kind), end
            swapped: array[Any] = array(kind, bytes(numbers))
            swapped.byteswap()
            return memoryview(swapped), end

        return read

    def _elements_reader(self, one: _Read, least: int, size: int, order: str) -> _Read:
        count_at = self._count_reader(size, order)

        def read(data: bytes, at: int) -> tuple[Any, int]:
            count, at = count_at(data, at)
            self._elements_left -= count
            if at + count * least > len(data) or self._elements_left < 0:
                raise ValueError(f"an array of {count} elements, expected at most {_MOST_ELEMENTS} within the message")
            elements: list[Any] = []
            for _ in range(count):
                element, at = one(data, at)
                elements.append(element)
            return elements, at

        return read

    def _statuses_reader(self, pattern: str, order: str) -> _Read:
        """Returns a reader of the statuses whose names match, in a DiagnosticArray.

        Robots have hundreds with several values each. Messages of them are a thousand objects, which cost several times
        what level and message of each status do.
        """
        header, level_at = (self._field_reader(self._fields(name)[0], order) for name in (ARRAY_TYPE, STATUS_TYPE))
        text_at, count_at = self._string_reader(order), self._count_reader(SEQUENCE, order)
        length = struct.Struct(f"{order}I").unpack_from
        padding, terminator = self._text_format
        own_key = OWN_KEY.encode()

        def read(data: bytes, at: int) -> tuple[Any, int]:
            _, at = header(data, at)
            count, at = count_at(data, at)
            if count > MOST_ELEMENTS:
                return too_many(count), at
            statuses = Elements()
            for _ in range(count):
                level, at = level_at(data, at)
                name, at = text_at(data, at)
                message, at = text_at(data, at)
                _, at = text_at(data, at)
                values, at = count_at(data, at)
                is_own = is_own_status(name, ())
                for _ in range(values):
                    key = at + (-at & padding) + 4
                    at = key + length(data, key - 4)[0]
                    is_own |= data[key : at - terminator] == own_key
                    at += (-at & padding) + 4
                    at += length(data, at - 4)[0]
                if not is_own and matches_pattern(name, pattern):
                    statuses.append((name, DriverStatus(level, message)))
            return statuses or ABSENT, at

        return read
