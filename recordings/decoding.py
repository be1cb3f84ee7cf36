"""Values of fields from serialized messages, by the definitions in the recording.

rosbags parses the definitions and deserializes. A number that only numbers, fixed arrays and strings precede, such as
`data` of a Float32 or `percentage` of a BatteryState, is read from the bytes directly, which is ten times as fast.
"""

from __future__ import annotations

import functools
import itertools
import struct
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Tuple

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.native_messages import Dialect, FieldType, NativeMessages

from .recording import Channel, libraries

with libraries():
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

Getter = Callable[[bytes], Any]
"""Reads a value from a serialized message; raises ValueError if the bytes do not match the type."""

_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
"""rosbags' kinds of fields."""
_FORMATS = {
    "bool": "?", "byte": "B", "char": "B", "octet": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
"""struct's letter for each type of fixed size."""
_KINDS = {"byte": "uint8", "char": "uint8", "octet": "uint8"}
_IDL_SEPARATOR = "=" * 80 + "\n"
_CDR_HEADER = 4
"""Bytes before a CDR message; the second is its byte order."""
_STRING = "s"
_MOST_FIELDS = 4096
"""Plain fields of a type that are looked at."""
_DEEPEST = 32
"""Types that a plain field may be in; a damaged definition may contain itself."""
_LONGEST_PROBLEM = 300
"""Characters of an error of rosbags' parser."""

_Place = Tuple[str, int]
"""struct's letter, and how many of them: an array of fixed size has several. A string: `s`, 1."""

Definition = Tuple[Any, List[Tuple[str, Tuple[Any, Any]]]]
"""Constants and fields of a type, as rosbags describes them."""


@functools.lru_cache(maxsize=1024)
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
        self._native_name = _native_name(channel.type_name)
        self._store = get_typestore(Stores.EMPTY)
        try:
            self._definitions = {**_times(), **self._parse(channel)}
            self._store.register(dict(self._definitions))
            if self._native_name not in self._definitions:
                raise KeyError("the definition does not define it")
            self._messages = NativeMessages(
                Dialect(
                    self._find_class,
                    _type_name,
                    self._field_types,
                    {"secs": "sec", "nsecs": "nanosec"},
                    byte_array=bytes,
                    plain=_plain,
                )
            )
        except Exception as error:  # rosbags lets any error of its parser through
            raise self._unusable(error) from None

    def field_getter(self, field: str) -> Getter:
        """Returns a function that reads `field`, a path as in core/field_path.py, from serialized messages.

        An empty field: the whole message as a mapping.

        Raises:
            ConfigError: the type has no such field.
        """
        try:
            read = self._messages.field_getter(self._channel.topic, self._channel.type_name, field)
            direct = self._number_getter(field)
        except KeyError as error:
            raise self._unusable(error) from None
        if direct is not None:
            return direct
        deserialize = self._store.deserialize_ros1 if self._channel.encoding == "ros1" else self._store.deserialize_cdr
        name = self._native_name

        def get(data: bytes) -> Any:
            try:
                message = deserialize(data, name)
            except Exception as error:  # whatever a parser makes of bytes that are something else
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

    def _parse(self, channel: Channel) -> Mapping[str, Definition]:
        if not channel.definition:
            ros2 = getattr(Stores, "ROS2_JAZZY", Stores.ROS2_HUMBLE)  # rosbags for Python 3.8 does not know Jazzy
            store: Any = get_typestore(Stores.ROS1_NOETIC if channel.encoding == "ros1" else ros2)
            definitions: Mapping[str, Definition] = getattr(store, "fielddefs", None) or store.FIELDDEFS
            if self._native_name not in definitions:
                raise KeyError("the recording has no definition of it, and it is not a standard type")
            return definitions
        if channel.definition_format == "msg":
            parsed: Mapping[str, Definition] = get_types_from_msg(channel.definition, self._native_name)
            return parsed
        if not channel.definition.startswith(f"{_IDL_SEPARATOR}IDL: "):
            return dict(get_types_from_idl(channel.definition))
        found: Dict[str, Definition] = {}
        for part in channel.definition.split(_IDL_SEPARATOR)[1:]:
            found.update(get_types_from_idl(part.partition("\n")[2]))
        return found

    def _find_class(self, package: str, kind: str, name: str) -> Any:
        return self._store.types.get(f"{package}/{kind}/{name}")

    def _field_types(self, native_class: Any) -> Mapping[str, FieldType]:
        return {name: self._field_type(kind, what) for name, (kind, what) in self._fields(native_class.__msgtype__)}

    def _fields(self, name: str) -> List[Tuple[str, Tuple[Any, Any]]]:
        return list(self._definitions[name][1])

    def _field_type(self, kind: Any, what: Any) -> FieldType:
        if int(kind) in (_ARRAY, _SEQUENCE):
            (element_kind, element), bound = what
            inner = self._field_type(element_kind, element)
            size = bound if int(kind) == _ARRAY else None
            most = bound if int(kind) == _SEQUENCE and bound else None
            return inner._replace(is_array=True, size=size, most=most)
        if int(kind) == _NAME:
            name = _type_name_of(what)
            return FieldType(name, name, self._store.types[what])
        element = what[0] if isinstance(what, tuple) else what
        return FieldType(element, _KINDS.get(element, element))

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
        return itertools.islice(self._places_in(self._native_name, "", 0), _MOST_FIELDS)

    def _places_in(self, name: str, prefix: str, depth: int) -> Iterator[Tuple[str, Optional[_Place]]]:
        fields = self._fields(name)
        if depth > _DEEPEST or not fields:
            yield "", None
            return
        for field, (kind, what) in fields:
            path = f"{prefix}{field}"
            if int(kind) == _NAME:
                yield from self._places_in(what, f"{path}.", depth + 1)
            elif int(kind) == _BASE:
                yield path, self._place(what, 1)
            elif int(kind) == _ARRAY and int(what[0][0]) == _BASE and what[1]:
                place = self._place(what[0][1], what[1])
                # No field has this path: the array itself is read by deserializing.
                yield f"{path}[]", None if place and place[0] == _STRING else place
            else:
                yield path, None

    def _place(self, what: Any, count: int) -> Optional[_Place]:
        kind = what[0] if isinstance(what, tuple) else what
        if kind == "string":
            return _STRING, count
        letter = "b" if kind == "byte" and self._channel.encoding == "ros1" else _FORMATS.get(kind)
        return (letter, count) if letter else None

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


@functools.lru_cache(maxsize=1)
def _times() -> Mapping[str, Definition]:
    """Returns the types that ROS 1 has built in, under rosbags' names."""
    found: Dict[str, Definition] = {}
    for name in ("Time", "Duration"):
        found.update(get_types_from_msg("int32 sec\nuint32 nanosec", f"builtin_interfaces/msg/{name}"))
    return found


def _native_name(type_name: str) -> str:
    package, _, name = type_name.partition("/")
    return f"{package}/msg/{name}"


def _type_name_of(native_name: str) -> str:
    return native_name.replace("/msg/", "/")


def _type_name(native_class: Any) -> str:
    return _type_name_of(native_class.__msgtype__)


def _plain(value: Any) -> Any:
    """Returns arrays of numpy as plain lists."""
    return value.tolist() if hasattr(value, "tolist") else value
