"""Values of fields from serialized messages, by the definitions in the recording.

Where core/fixed_fields.py can read a number from the bytes, the message is not deserialized: that is ten times as fast.
"""

from __future__ import annotations

import functools
from typing import Any, List, Mapping, Tuple

from robot_health_monitor.core.definitions import SEQUENCE, TIMES, Definition, Definitions, Field, parse_definition
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.fixed_fields import STRING, Getter, number_getter, plain_fields
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.middleware import canonical_type
from robot_health_monitor.core.native_messages import Dialect, FieldType, NativeMessages
from robot_health_monitor.runtime.libraries import RECORDINGS, libraries

from .deserialization import EMPTY, Deserializer
from .recording import Channel

_LONGEST_PROBLEM = 300
"""Characters of an error."""


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
            own = self._deserializer.classes[self._channel.type_name]
            direct = number_getter(self._field_types, own, field, is_cdr=self._channel.encoding != "ros1")
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
            fields = list(plain_fields(self._field_types, self._deserializer.classes[self._channel.type_name]))
        except KeyError as error:
            raise self._unusable(error) from None
        return [(path, place[0]) for path, place in fields if place and place[0] != STRING and path[-2:] != "[]"]

    def _field_types(self, native_class: Any) -> Mapping[str, FieldType]:
        return {field.name: self._field_type(field) for field in self._definitions[native_class.type_name].fields}

    def _field_type(self, field: Field) -> FieldType:
        message = self._deserializer.classes[field.kind] if "/" in field.kind else None
        size = None if field.size == SEQUENCE else field.size
        return FieldType(field.kind, field.kind, message, field.size is not None, size)


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
    with libraries(*RECORDINGS):
        from rosbags.typesys import Stores, get_typestore

    ros2 = getattr(Stores, "ROS2_JAZZY", Stores.ROS2_HUMBLE)  # rosbags for Python 3.8 does not know Jazzy
    store: Any = get_typestore(Stores.ROS1_NOETIC if is_ros1 else ros2)
    found = getattr(store, "fielddefs", None) or store.FIELDDEFS
    fields = {
        canonical_type(name): Definition(
            [_standard_field(field, int(kind), what, is_ros1) for field, (kind, what) in fields if field != EMPTY.name]
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
