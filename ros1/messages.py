"""ROS 1 messages: how genpy finds, describes and represents them. `core/messages/native_messages.py` converts them."""

from __future__ import annotations

import functools
import io
import re
from typing import Any, Mapping

import genpy
import rospy

from ..core.messages.definitions import ROS1_KINDS
from ..core.messages.dialect import Dialect, FieldType
from ..core.messages.native_fields import as_it_is
from ..core.messages.native_messages import NativeMessages, find_generated
from ..core.messages.raw_messages import RawFormat, ros1_format
from ..core.messages.serialized_statuses import serialized_getter as serialized_getter_of

_TIMES = {"time": genpy.Time, "duration": genpy.Duration}

_ROS2_NAMES = {"sec": "secs", "nanosec": "nsecs"}

_ARRAY = re.compile(r"(?P<element>.+)\[(?P<size>\d*)\]\Z")


def type_name(native_class: Any) -> str:
    """Returns the type of a message class, `std_msgs/Float32`."""
    name: str = native_class._type
    return name


@functools.lru_cache(maxsize=None)
def field_types(native_class: Any) -> Mapping[str, FieldType]:
    """Returns the type of every field of a message class, by name."""
    if native_class in _TIMES.values():
        kind = "uint32" if native_class is genpy.Time else "int32"
        return {name: FieldType(kind, kind) for name in _ROS2_NAMES.values()}
    return {name: _field_type(text) for name, text in zip(native_class.__slots__, native_class._slot_types)}


def _field_type(text: str) -> FieldType:
    array = _ARRAY.match(text)
    element = array["element"] if array else text
    return FieldType(
        element,
        ROS1_KINDS.get(element, element),
        message_class(element) if "/" in element else _TIMES.get(element),
        is_array=array is not None,
        size=int(array["size"]) if array and array["size"] else None,
    )


_find_class = functools.partial(find_generated, r"from \._{name} import \*\s*$")
native = NativeMessages(Dialect(_find_class, type_name, field_types, _ROS2_NAMES, byte_array=bytes, plain=as_it_is))
message_class = native.message_class
service_class = native.service_class
to_mapping = native.to_mapping
to_native = native.to_native
field_getter = native.field_getter
serialized_getter = functools.partial(serialized_getter_of, field_types, is_cdr=False)
"""Returns a getter of a field from serialized messages of a class; None if it needs all of them."""


def serialized(native: Any) -> bytes:
    """Returns the bytes of a message."""
    buffer = io.BytesIO()
    native.serialize(buffer)
    return buffer.getvalue()


def deserialized(data: bytes, native_class: Any) -> Any:
    """Returns a message of a class."""
    return native_class().deserialize(data)


def raw_format(type_name: str) -> RawFormat:
    """Returns the format of serialized messages of a type; raises ConfigError if it is not installed here."""
    native_class = message_class(type_name)
    return ros1_format(native_class._type, native_class._full_text)


@functools.lru_cache(maxsize=None)
def serialized_class(native_class: Any) -> Any:
    """Returns a class to subscribe with whose messages stay bytes, of the type and checksum of `native_class`."""
    names = ("_type", "_md5sum", "_full_text")
    return type(native_class.__name__, (rospy.AnyMsg,), {name: getattr(native_class, name) for name in names})
