"""ROS 1 messages: how genpy describes and holds them. `core/native_messages.py` converts them."""

from __future__ import annotations

import functools
import re
from typing import Any, Mapping

import genpy
import roslib.message

from robot_health_monitor.core.native_messages import Dialect, FieldType, NativeMessages, as_it_is

_KINDS = {"byte": "int8", "char": "uint8"}
"""Kinds of what ROS 1 calls differently."""

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
        _KINDS.get(element, element),
        roslib.message.get_message_class(element) if "/" in element else _TIMES.get(element),
        is_array=array is not None,
        size=int(array["size"]) if array and array["size"] else None,
    )


def _find_class(package: str, kind: str, name: str) -> Any:
    get_class = roslib.message.get_message_class if kind == "msg" else roslib.message.get_service_class
    return get_class(f"{package}/{name}")


_native = NativeMessages(Dialect(_find_class, type_name, field_types, _ROS2_NAMES, byte_array=bytes, plain=as_it_is))

message_class = _native.message_class
service_class = _native.service_class
to_mapping = _native.to_mapping
to_native = _native.to_native
field_getter = _native.field_getter
is_stamped = _native.is_stamped
