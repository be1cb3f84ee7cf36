"""Values of fields from serialized messages, by the definitions in the recording.

A number that only numbers, fixed arrays and strings precede, such as `data` of a Float32 or `percentage` of a
BatteryState, is read from the bytes directly, which is ten times as fast as deserializing the message.
"""

from __future__ import annotations

import functools
import itertools
import struct
from typing import Any, Callable, Iterator, List, Mapping, Optional, Tuple

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.native_messages import Dialect, FieldType, NativeMessages

from .definitions import NUMBERS, SEQUENCE, TIMES, Definitions, Field, parse_definition
from .deserialization import EMPTY, Deserializer
from .recording import Channel, canonical_type, libraries

Getter = Callable[[bytes], Any]
"""Reads a value from a serialized message; raises ValueError if the bytes do not match the type."""

_CDR_HEADER = 4
"""Bytes before a CDR message; the second is its byte order."""
_STRING = "s"
_MOST_NUMBERS = 4096
"""Plain fields of a type that are looked at."""
_DEEPEST = 32
"""Types that a plain field may be in; a damaged definition may contain itself."""
_LONGEST_PROBLEM = 300
"""Characters of an error."""

_Place = Tuple[str, int]
"""struct's letter, and how many of them: an array of fixed size has several. A string: `s`, 1."""


@functools.lru_cache(maxsize=256)
def types_of(channel: Channel) -> Types:
    """Returns the message types of a channel, once per channel.

    Raises:
        ConfigError: its definition cannot be parsed, or it has none and its type is not a standard one.
    """
    return Types(channel)


class Types:
    """The type of one channel's messages, with the types in it."""

    def __init__(self, channel: Channel) -> None:
        """Parses the definition.

        Raises:
            ConfigError: it cannot be parsed, or is missing and the type is not a standard one.
        """
        self._channel = channel
        try:
            self._definitions = _definitions_of(channel)
        except (ValueError, KeyError) as error:
            raise self._unusable(error) from None
        self._deserializer = Deserializer(self._definitions, channel.encoding != "ros1")
        self._messages = NativeMessages(
            Dialect(
                lambda package, kind, name: self._deserializer.classes.get(f"{package}/{name}"),
                lambda found: found.type_name,
                self._field_types,
                {"secs": "sec", "nsecs": "nanosec"},
                byte_array=bytes,
                plain=_plain,
            )
        )

    def field_getter(self, field: str) -> Getter:
        """Returns a function that reads `field`, a path as in core/field_path.py, from serialized messages.

        An empty field: the whole message as a mapping.

        Raises:
            ConfigError: the type has no such field.
        """
        try:
            read = self._messages.field_getter(self._channel.topic, self._channel.type_name, field)
            direct = self._number_getter(field)
            if direct is not None:
                return direct
            deserialize = self._deserializer.bind(self._channel.type_name)
        except (ValueError, KeyError) as error:
            raise self._unusable(error) from None

        def get(data: bytes) -> Any:
            try:
                message = deserialize(data)
            except ValueError as error:
                raise ValueError(f"not a {self._channel.type_name}: {error}") from None
            return read(message)

        return get

    def _unusable(self, error: Exception) -> ConfigError:
        text = f"{self._channel.topic}: cannot use the definition of {self._channel.type_name}: {error}"
        return ConfigError(printable(" ".join(text.split()))[:_LONGEST_PROBLEM])

    def numbers(self) -> List[Tuple[str, str]]:
        """Returns path and struct's letter of each field that is one number or bool.

        Raises:
            ConfigError: the definition lacks a type.
        """
        try:
            places = list(self._places())
        except KeyError as error:
            raise self._unusable(error) from None
        return [(path, place[0]) for path, place in places if place and place[0] != _STRING and path[-2:] != "[]"]

    def _field_types(self, native_class: Any) -> Mapping[str, FieldType]:
        return {field.name: self._field_type(field) for field in self._definitions[native_class.type_name]}

    def _field_type(self, field: Field) -> FieldType:
        message = self._deserializer.classes[field.kind] if "/" in field.kind else None
        size = None if field.size == SEQUENCE else field.size
        return FieldType(field.kind, field.kind, message, field.size is not None, size)

    def _number_getter(self, field: str) -> Optional[Getter]:
        """Returns a getter that reads a number from the bytes; None if something of variable size precedes it."""
        before: List[_Place] = []
        for path, place in self._places():
            if place is None:
                return None
            if path == field:
                letter, _ = place
                return None if letter == _STRING else self._getter(before, letter)
            before.append(place)
        return None

    def _places(self) -> Iterator[Tuple[str, Optional[_Place]]]:
        """Yields path and place of each plain field, in their order; None where neither is supported here."""
        return itertools.islice(self._places_in(self._channel.type_name, "", 0), _MOST_NUMBERS)

    def _places_in(self, name: str, prefix: str, depth: int) -> Iterator[Tuple[str, Optional[_Place]]]:
        fields = self._definitions[name]
        if depth > _DEEPEST or not fields:
            yield "", None
            return
        for field in fields:
            path = f"{prefix}{field.name}"
            letter = NUMBERS.get(field.kind)
            if field.size is None and "/" in field.kind:
                yield from self._places_in(field.kind, f"{path}.", depth + 1)
            elif field.size is None and field.kind == "string":
                yield path, (_STRING, 1)
            elif field.size is None and letter:
                yield path, (letter, 1)
            elif field.size not in (None, 0, SEQUENCE) and letter:
                # No field has this path: the array itself is read by deserializing.
                yield f"{path}[]", (letter, field.size)
            else:
                yield path, None

    def _getter(self, before: List[_Place], letter: str) -> Getter:
        """Returns a getter for a number after places.

        The places up to a string have a fixed size except for their alignment, which depends on where the string before
        them ended: a table per string gives the bytes up to the next string for each of the eight alignments.
        """
        is_cdr = self._channel.encoding != "ros1"
        steps: List[List[_Place]] = [[]]
        for place in before:
            if place[0] == _STRING:
                steps[-1].append(("I", 1))
                steps.append([])
            else:
                steps[-1].append(place)
        steps[-1].append((letter, 1))
        first, *rest = (_distances(step, is_cdr) for step in steps)
        return _number_getter(letter, first[0], [tuple(table) for table in rest], is_cdr)


def _distances(places: List[_Place], is_aligned: bool) -> List[int]:
    """Returns, for each alignment of the start, the bytes from there to the last of the places."""
    distances = []
    for start in range(8):
        offset = size = 0
        for letter, count in places:
            offset += size
            item = struct.calcsize(f"<{letter}")
            if is_aligned:
                offset += -(start + offset) % item
            size = item * count
        distances.append(offset)
    return distances


def _number_getter(letter: str, first: int, tables: List[Tuple[int, ...]], is_cdr: bool) -> Getter:
    """Returns a getter for a number.

    Args:
        letter: struct's letter of the number.
        first: bytes up to the length of the first string, or to the number if there is no string.
        tables: per string, the bytes from its end to the next length or to the number, by alignment of its end.
        is_cdr: the message is CDR, with a header; else it is ROS 1.
    """
    numbers = [struct.Struct(f"{order}{letter}").unpack_from for order in "><"]
    lengths = [struct.Struct(f"{order}I").unpack_from for order in "><"]
    header = _CDR_HEADER if is_cdr else 0
    start = header + first

    def get_fixed_ros1(data: bytes) -> Any:
        try:
            return little(data, start)[0]
        except struct.error as error:
            raise ValueError(f"too short: {error}") from None

    def get_fixed_cdr(data: bytes) -> Any:
        try:
            return numbers[data[1]](data, start)[0]
        except (struct.error, IndexError) as error:
            raise ValueError(f"too short, or not CDR: {error}") from None

    def get(data: bytes) -> Any:
        try:
            order = data[1] if is_cdr else 1
            length = lengths[order]
            offset = start
            for table in tables:
                offset += 4 + length(data, offset)[0]
                offset += table[(offset - header) & 7]
            return numbers[order](data, offset)[0]
        except (struct.error, IndexError) as error:
            raise ValueError(f"too short, or not CDR: {error}") from None

    little = numbers[1]
    if tables:
        return get
    return get_fixed_cdr if is_cdr else get_fixed_ros1


def _definitions_of(channel: Channel) -> Definitions:
    """Returns the types in the definition of a channel; without one, those of the standard messages.

    Raises:
        ValueError: it cannot be parsed.
        KeyError: it is missing, and the type is not a standard one.
    """
    is_ros1 = channel.encoding == "ros1"
    if channel.definition:
        byte = "int8" if is_ros1 else "uint8"
        return parse_definition(channel.type_name, channel.definition, channel.definition_format, byte)
    found = _standard_definitions(is_ros1)
    if channel.type_name not in found:
        raise KeyError("the recording has no definition of it, and it is not a standard type")
    return found


@functools.lru_cache(maxsize=2)
def _standard_definitions(is_ros1: bool) -> Definitions:
    with libraries():
        from rosbags.typesys import Stores, get_typestore

    ros2 = getattr(Stores, "ROS2_JAZZY", Stores.ROS2_HUMBLE)  # rosbags for Python 3.8 does not know Jazzy
    store: Any = get_typestore(Stores.ROS1_NOETIC if is_ros1 else ros2)
    found = getattr(store, "fielddefs", None) or store.FIELDDEFS
    fields = {
        canonical_type(name): tuple(
            _standard_field(field, int(kind), what, is_ros1) for field, (kind, what) in fields if field != EMPTY.name
        )
        for name, (_, fields) in found.items()
    }
    return {**TIMES, **fields}


def _standard_field(name: str, kind: int, what: Any, is_ros1: bool) -> Field:
    """Returns a field as rosbags describes it: a kind of field, and its type or the type and size of its elements."""
    if kind in (_ROSBAGS_ARRAY, _ROSBAGS_SEQUENCE):
        (element_kind, element), size = what
        one = _standard_field(name, int(element_kind), element, is_ros1)
        return one._replace(size=size if kind == _ROSBAGS_ARRAY else SEQUENCE)
    if kind == _ROSBAGS_MESSAGE:
        return Field(name, canonical_type(what), None)
    plain = what[0] if isinstance(what, tuple) else what
    kinds: Mapping[Any, str] = {"byte": "int8" if is_ros1 else "uint8", "char": "uint8", "octet": "uint8"}
    return Field(name, kinds.get(plain, str(plain)), None)


_ROSBAGS_MESSAGE, _ROSBAGS_ARRAY, _ROSBAGS_SEQUENCE = 2, 3, 4


def _plain(value: Any) -> Any:
    """Returns arrays of numpy as plain lists."""
    return value.tolist() if hasattr(value, "tolist") else value
