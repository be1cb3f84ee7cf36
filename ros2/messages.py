"""ROS 2 messages: how rosidl finds, describes and represents them. `core/messages/native_messages.py` converts them.

Their definitions are in .msg with the types that they contain, as recordings of ROS 2 have them.
"""

from __future__ import annotations

import functools
import re
import sys
from pathlib import Path
from typing import Any, Sequence

from rclpy.serialization import serialize_message

from ..core.messages import (
    LONGEST_TEXT,
    SEQUENCE,
    Dialect,
    Field,
    NativeMessages,
    RawFormat,
    SerializedType,
    find_generated,
    parse_msg,
    ros2_format,
)
from ..core.values import Getter

_KINDS = {"boolean": "bool", "float": "float32", "double": "float64"}
"""Kinds of types that rosidl names differently. (A `char` is a uint8 there.)"""

_SEPARATOR = "=" * 80
_EMPTY = "structure_needs_at_least_one_member"
"""The field of a class whose definition has none."""

_SEQUENCE = re.compile(r"sequence<(?P<kind>.+?)(?:, (?P<most>\d+))?>\Z")
_ARRAY = re.compile(r"(?P<kind>.+)\[(?P<size>\d+)\]\Z")


def type_name(native_class: Any) -> str:
    """Returns the type of a message class, `std_msgs/Float32`."""
    return f"{native_class.__module__.partition('.')[0]}/{native_class.__name__}"


@functools.lru_cache(maxsize=None)
def _fields(native_class: Any) -> Sequence[Field]:
    """Returns the fields of a message class."""
    return [_field(name, text) for name, text in native_class.get_fields_and_field_types().items()]


def _field(name: str, text: str) -> Field:
    sequence, array = _SEQUENCE.match(text), _ARRAY.match(text)
    if sequence:
        most = int(sequence["most"]) if sequence["most"] else None
        return Field(name, _kind(sequence["kind"]), SEQUENCE, most)
    return Field(name, _kind(array["kind"]), int(array["size"])) if array else Field(name, _kind(text))


def _kind(text: str) -> str:
    return _KINDS.get(text, text)


def _class_of(kind: str) -> Any:
    return message_class(kind) if "/" in kind else None


def plain(value: Any) -> Any:
    """Converts arrays and their elements to plain Python; those of fixed size are numpy's, others `array.array`."""
    return value.tolist() if hasattr(value, "tolist") else value


_find_class = functools.partial(find_generated, r"from {package}\.{kind}\._\w+ import {name}(?:\s|$)")
native = NativeMessages(Dialect(_find_class, _fields, _class_of, byte_array=list, plain=plain))
message_class = native.message_class
service_class = native.service_class
to_mapping = native.to_mapping
to_native = native.to_native
serialized = serialize_message


def field_getter(topic: str, type_name: str, field: str) -> Getter:
    """Returns what reads a field from serialized messages of a type that is installed here; raises ConfigError."""
    return SerializedType(topic, raw_format(type_name)).field_getter(field)


def raw_format(type_name: str) -> RawFormat:
    """Returns the format of serialized messages of a type; raises ConfigError if it is not installed."""
    return _format_of(message_class(type_name))


@functools.lru_cache(maxsize=None)
def _format_of(native_class: Any) -> RawFormat:
    return ros2_format(type_name(native_class), _full_text(native_class))


def _full_text(native_class: Any) -> str:
    """Returns the definition of a class, followed by those of the messages that it contains, each once."""
    parts: dict[str, str] = {}
    waiting = [native_class]
    while waiting:
        cls = waiting.pop(0)
        if type_name(cls) not in parts:
            parts[type_name(cls)] = _installed_text(cls) or "".join(map(_line, _fields(cls)))
            waiting += [message_class(field.kind) for field in _fields(cls) if "/" in field.kind]
    first, *others = parts.items()
    return first[1] + "".join(f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)


def _installed_text(native_class: Any) -> str:
    """Returns the .msg file from which the class was generated; empty if there is none, as for a type of an .idl."""
    package, name = type_name(native_class).split("/")
    for folder in Path(str(sys.modules[package].__file__)).parents:
        file = folder / "share" / package / "msg" / f"{name}.msg"
        try:
            with file.open(encoding="utf-8") as stream:
                text = stream.read(LONGEST_TEXT).rstrip("\n") + "\n"
            written = [field.name for field in parse_msg(name, text)[name].fields]
        except (OSError, ValueError):
            continue
        if written == [field.name for field in _fields(native_class) if field.name != _EMPTY]:
            return text
    return ""


def _line(field: Field) -> str:
    """Returns a field in .msg syntax, for a class without a .msg file: no default and no comment."""
    # As in a .msg file: byte, and string<=5 for string<5>.
    kind = "byte" if field.kind == "octet" else field.kind.replace("<", "<=").rstrip(">")
    bound = f"<={field.most}" if field.most else field.size if field.size != SEQUENCE else ""
    return f"{kind}{'' if field.size is None else f'[{bound}]'} {field.name}\n"
