"""From recorded bytes to the values of fields, by the definitions that the recording holds.

rosbags parses the definitions and deserializes. A number at a fixed place, such as `data` of a Float32, is read from
the bytes directly: that is most of what a monitor watches, and ten times as fast.
"""

from __future__ import annotations

import functools
import struct
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Tuple

from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.native_messages import Dialect, FieldType, NativeMessages

from .recording import Channel

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
"""Bytes before a CDR message that say its byte order."""

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
            self._definitions = self._parse(channel)
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
            raise ConfigError(f"{channel.topic}: cannot use the definition of {channel.type_name}: {error}") from None

    def field_getter(self, field: str) -> Getter:
        """Returns a function that reads `field`, a path as in core/field_path.py, from serialized messages.

        An empty field: the whole message as a mapping.

        Raises:
            ConfigError: the type has no such field.
        """
        read = self._messages.field_getter(self._channel.topic, self._channel.type_name, field)
        fixed = self._fixed_place(field)
        if fixed is not None:
            return fixed
        deserialize = self._store.deserialize_ros1 if self._channel.encoding == "ros1" else self._store.deserialize_cdr
        name = self._native_name

        def get(data: bytes) -> Any:
            try:
                message = deserialize(data, name)
            except Exception as error:  # whatever a parser makes of bytes that are something else
                raise ValueError(f"not a {self._channel.type_name}: {error}") from None
            return read(message)

        return get

    def _parse(self, channel: Channel) -> Mapping[str, Definition]:
        if not channel.definition:
            store = get_typestore(Stores.ROS1_NOETIC if channel.encoding == "ros1" else Stores.ROS2_JAZZY)
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

    def _fixed_place(self, field: str) -> Optional[Getter]:
        """Returns a getter for a number whose place does not depend on the message; None if it does."""
        is_cdr = self._channel.encoding != "ros1"
        offset = 0
        for path, letter in self._leaves(self._native_name, "", 0):
            if letter is None:
                return None
            size = struct.calcsize(f"<{letter}")
            if is_cdr:
                offset = -(-offset // size) * size
            if path == field:
                return _number_getter(letter, offset, is_cdr)
            offset += size
        return None

    def _leaves(self, name: str, prefix: str, depth: int) -> Iterator[Tuple[str, Optional[str]]]:
        """Yields path and struct letter of each plain field, in their order; a letter None where sizes vary."""
        if depth > 32:
            yield "", None
            return
        for field, (kind, what) in self._fields(name):
            path = f"{prefix}{field}"
            if int(kind) == _NAME:
                yield from self._leaves(what, f"{path}.", depth + 1)
            elif int(kind) == _BASE:
                yield path, _FORMATS.get(what[0] if isinstance(what, tuple) else what)
            else:
                yield path, None


def _number_getter(letter: str, offset: int, is_cdr: bool) -> Getter:
    little = struct.Struct(f"<{letter}").unpack_from
    if not is_cdr:

        def get(data: bytes) -> Any:
            try:
                return little(data, offset)[0]
            except struct.error as error:
                raise ValueError(f"too short: {error}") from None

        return get

    big = struct.Struct(f">{letter}").unpack_from
    place = _CDR_HEADER + offset

    def get_cdr(data: bytes) -> Any:
        try:
            return (little if data[1] & 1 else big)(data, place)[0]
        except (struct.error, IndexError) as error:
            raise ValueError(f"too short: {error}") from None

    return get_cdr


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
