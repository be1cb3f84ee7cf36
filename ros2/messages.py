"""ROS 2 messages: how rosidl finds, describes and represents them. `core/native_messages.py` converts them."""

from __future__ import annotations

import functools
import importlib
import os
import re
import sys
from typing import Any, Callable, Mapping, Optional

from robot_health_monitor.core.fixed_fields import number_getter
from robot_health_monitor.core.native_messages import Dialect, FieldType, NativeMessages

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
    if not _is_generated(package, kind, name):
        return None
    try:
        return getattr(importlib.import_module(f"{package}.{kind}"), name, None)
    except ImportError:
        return None


def _is_generated(package: str, kind: str, name: str) -> bool:
    """Returns whether rosidl generated this class.

    Clients choose type names, and importing runs code: a module must not be imported to find out that it has no
    messages. So the text of `<package>/msg/__init__.py` is searched for the line that rosidl writes there.
    """
    line = re.compile(rf"^from {package}\.{kind}\._\w+ import {name}(?:\s|$)", re.MULTILINE)
    for folder in sys.path:
        try:
            with open(os.path.join(folder, package, kind, "__init__.py"), encoding="utf-8") as stream:
                if line.search(stream.read()):
                    return True
        except (OSError, ValueError):
            continue
    return False


def _plain(value: Any) -> Any:
    """Converts arrays and their elements to plain Python; those of fixed size are numpy's, others `array.array`."""
    return value.tolist() if hasattr(value, "tolist") else value


_native = NativeMessages(Dialect(_find_class, type_name, field_types, _ROS1_NAMES, byte_array=list, plain=_plain))

message_class = _native.message_class
service_class = _native.service_class
to_mapping = _native.to_mapping
to_native = _native.to_native
field_getter = _native.field_getter
is_stamped = _native.is_stamped


def serialized_getter(native_class: Any, field: str) -> Optional[Callable[[bytes], Any]]:
    """Returns a getter of a number from serialized messages; None if it needs all of them."""
    return number_getter(field_types, native_class, field, is_cdr=True)
