"""ROS 1 messages: how genpy finds, describes and represents them. `core/messages/native_messages.py` converts them."""

from __future__ import annotations

import functools
import io
import re
from typing import Any

import genpy
import rospy

from ..core.messages import (
    ROS1_KINDS,
    SEQUENCE,
    Dialect,
    Field,
    NativeMessages,
    RawFormat,
    SerializedType,
    find_generated,
    ros1_format,
)
from ..core.values import Getter, canonical_type

_TIMES = {"time": genpy.Time, "duration": genpy.Duration}

_ARRAY = re.compile(r"(?P<kind>.+)\[(?P<size>\d*)\]\Z")


def _fields(native_class: Any) -> list[Field]:
    """Returns the fields of a message class."""
    if native_class in _TIMES.values():
        kind = "uint32" if native_class is genpy.Time else "int32"
        return [Field("secs", kind), Field("nsecs", kind)]
    return [_field(name, text) for name, text in zip(native_class.__slots__, native_class._slot_types)]


def _field(name: str, text: str) -> Field:
    array = _ARRAY.match(text)
    kind = array["kind"] if array else text
    return Field(name, ROS1_KINDS.get(kind, kind), int(array["size"] or SEQUENCE) if array else None)


def _class_of(kind: str) -> Any:
    return message_class(kind) if "/" in kind else _TIMES.get(kind)


_find_class = functools.partial(find_generated, r"from \._{name} import \*\s*$")
native = NativeMessages(Dialect(_find_class, _fields, _class_of, byte_array=bytes))
message_class = native.message_class
service_class = native.service_class
to_mapping = native.to_mapping
to_native = native.to_native


def field_getter(topic: str, type_name: str, field: str) -> Getter:
    """Returns what reads a field from serialized messages of a type that is installed here; raises ConfigError."""
    return SerializedType(topic, raw_format(type_name)).field_getter(field)


def serialized(native: Any) -> bytes:
    """Returns the bytes of a message."""
    buffer = io.BytesIO()
    native.serialize(buffer)
    return buffer.getvalue()


def raw_format(type_name: str) -> RawFormat:
    """Returns the format of serialized messages of a type; raises ConfigError if it is not installed here."""
    native_class = message_class(type_name)
    return ros1_format(native_class._type, native_class._full_text)


def bytes_class(type_name: str) -> Any:
    """Returns a class to subscribe with whose messages stay bytes, of any publisher.

    The master learns the type. It need not be installed here; it is empty if it is not known.
    """
    return type("Bytes", (rospy.AnyMsg,), {"_type": canonical_type(type_name)}) if type_name else rospy.AnyMsg
