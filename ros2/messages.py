"""ROS 2 messages: how rosidl finds, describes and represents them. `core/messages/native_messages.py` converts them."""

from __future__ import annotations

import functools
import re
from typing import Any, Mapping

from ..core.messages.dialect import Dialect, FieldType
from ..core.messages.native_messages import NativeMessages, find_generated
from ..core.messages.serialized_statuses import serialized_getter as serialized_getter_of

_KINDS = {"boolean": "bool", "float": "float32", "double": "float64"}
"""Kinds of types that rosidl names differently. (A `char` is a uint8 there.)"""

_ROS1_NAMES = {"secs": "sec", "nsecs": "nanosec"}

_SEQUENCE = re.compile(r"sequence<(?P<element>.+?)(?:, (?P<most>\d+))?>\Z")
_ARRAY = re.compile(r"(?P<element>.+)\[(?P<size>\d+)\]\Z")


def type_name(native_class: Any) -> str:
    """Returns the type of a message class, `std_msgs/Float32`."""
    return f"{native_class.__module__.partition('.')[0]}/{native_class.__name__}"


@functools.lru_cache(maxsize=None)
def field_types(native_class: Any) -> Mapping[str, FieldType]:
    """Returns the type of every field of a message class, by name."""
    return {name: _field_type(text) for name, text in native_class.get_fields_and_field_types().items()}


def _field_type(text: str) -> FieldType:
    sequence, array = _SEQUENCE.match(text), _ARRAY.match(text)
    array_type = sequence or array
    element = array_type["element"] if array_type else text
    return FieldType(
        element,
        _KINDS.get(element, element),
        message_class(element) if "/" in element else None,
        is_array=array_type is not None,
        size=int(array["size"]) if array and not sequence else None,
        most=int(sequence["most"]) if sequence and sequence["most"] else None,
    )


def _plain(value: Any) -> Any:
    """Converts arrays and their elements to plain Python; those of fixed size are numpy's, others `array.array`."""
    return value.tolist() if hasattr(value, "tolist") else value


_find_class = functools.partial(find_generated, r"from {package}\.{kind}\._\w+ import {name}(?:\s|$)")
native = NativeMessages(Dialect(_find_class, type_name, field_types, _ROS1_NAMES, byte_array=list, plain=_plain))
message_class = native.message_class
service_class = native.service_class
to_mapping = native.to_mapping
to_native = native.to_native
field_getter = native.field_getter
serialized_getter = functools.partial(serialized_getter_of, field_types, is_cdr=True)
"""Returns a getter of a field from serialized messages of a class; None if it needs all of them."""
