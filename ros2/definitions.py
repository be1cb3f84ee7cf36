"""The definitions of message types, in .msg with the types that they contain, as recordings of ROS 2 have them."""

from __future__ import annotations

import functools
from typing import Any, Dict

from robot_health_monitor.core.dialect import FieldType
from robot_health_monitor.core.middleware import RawFormat
from robot_health_monitor.core.raw_messages import ros2_format

from . import messages

_SEPARATOR = "=" * 80


def raw_format(type_name: str) -> RawFormat:
    """Returns the format of serialized messages of a type; raises ConfigError if it is not installed."""
    return _format_of(messages.message_class(type_name))


@functools.lru_cache(maxsize=None)
def _format_of(native_class: Any) -> RawFormat:
    return ros2_format(messages.type_name(native_class), _full_text(native_class))


def _full_text(native_class: Any) -> str:
    """Returns the fields of a class in .msg syntax, followed by the messages that it contains, each once."""
    parts: Dict[str, str] = {}
    waiting = [native_class]
    while waiting:
        cls = waiting.pop(0)
        if messages.type_name(cls) not in parts:
            fields = messages.field_types(cls)
            parts[messages.type_name(cls)] = "".join(_line(name, field) for name, field in fields.items())
            waiting += [field.message for field in fields.values() if field.message is not None]
    first, *others = parts.items()
    return first[1] + "".join(f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)


def _line(name: str, field: FieldType) -> str:
    # As in a .msg file: byte, and string<=5 for string<5>.
    element = "byte" if field.kind == "octet" else field.kind.replace("<", "<=").rstrip(">")
    bound = str(field.size) if field.size else f"<={field.most}" if field.most else ""
    return f"{element}{f'[{bound}]' if field.is_array else ''} {name}\n"
