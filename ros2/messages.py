"""ROS 2 messages: how rosidl describes and holds them. `core/native_messages.py` converts them."""

from __future__ import annotations

import functools
import importlib
import re
from typing import Any, Mapping

from robot_health_monitor.core.native_messages import Dialect, FieldType, NativeMessages

_KINDS = {"boolean": "bool", "float": "float32", "double": "float64"}
"""Kinds of what rosidl calls differently. (A `char` is a uint8 there.)"""

_ROS1_NAMES = {"secs": "sec", "nsecs": "nanosec"}

_SEQUENCE = re.compile(r"sequence<(?P<element>.+?)(?:, (?P<most>\d+))?>\Z")
_ARRAY = re.compile(r"(?P<element>.+)\[(?P<size>\d+)\]\Z")

_MARKS = {"msg": "get_fields_and_field_types", "srv": "Request"}
"""What a class of each kind has."""


def type_name(native_class: Any) -> str:
    """Returns the type of a message class, `std_msgs/Float32`."""
    return f"{native_class.__module__.partition('.')[0]}/{native_class.__name__}"


@functools.lru_cache(maxsize=None)
def field_types(native_class: Any) -> Mapping[str, FieldType]:
    """Returns the type of every field of a message class, by name."""
    return {name: _field_type(text) for name, text in native_class.get_fields_and_field_types().items()}


def _field_type(text: str) -> FieldType:
    sequence, array = _SEQUENCE.match(text), _ARRAY.match(text)
    found = sequence or array
    element = found["element"] if found else text
    return FieldType(
        element,
        _KINDS.get(element, element),
        message_class(element) if "/" in element else None,
        is_array=found is not None,
        size=int(array["size"]) if array and not sequence else None,
        most=int(sequence["most"]) if sequence and sequence["most"] else None,
    )


def _find_class(package: str, kind: str, name: str) -> Any:
    try:
        found = getattr(importlib.import_module(f"{package}.{kind}"), name, None)
    except ImportError:
        return None
    return found if hasattr(found, _MARKS[kind]) else None


def _plain(value: Any) -> Any:
    """Returns an array or its element as Python's own: of numbers, one of fixed size is numpy's, another an `array`."""
    return value.tolist() if hasattr(value, "tolist") else value


_native = NativeMessages(Dialect(_find_class, type_name, field_types, _ROS1_NAMES, byte_array=list, plain=_plain))

message_class = _native.message_class
service_class = _native.service_class
to_mapping = _native.to_mapping
to_native = _native.to_native
field_getter = _native.field_getter
is_stamped = _native.is_stamped
