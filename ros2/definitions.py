"""The definitions of message types, in .msg with the types that they contain, as recordings of ROS 2 have them."""

from __future__ import annotations

import functools
import sys
from pathlib import Path
from typing import Any, Dict

from ..core.messages.definitions import LONGEST_TEXT, parse_msg
from ..core.messages.dialect import FieldType
from ..core.messages.raw_messages import RawFormat, ros2_format
from . import messages

_SEPARATOR = "=" * 80
_EMPTY = "structure_needs_at_least_one_member"
"""The field of a class whose definition has none."""


def raw_format(type_name: str) -> RawFormat:
    """Returns the format of serialized messages of a type; raises ConfigError if it is not installed."""
    return _format_of(messages.message_class(type_name))


@functools.lru_cache(maxsize=None)
def _format_of(native_class: Any) -> RawFormat:
    return ros2_format(messages.type_name(native_class), _full_text(native_class))


def _full_text(native_class: Any) -> str:
    """Returns the definition of a class, followed by those of the messages that it contains, each once."""
    parts: Dict[str, str] = {}
    waiting = [native_class]
    while waiting:
        cls = waiting.pop(0)
        if messages.type_name(cls) not in parts:
            parts[messages.type_name(cls)] = _installed_text(cls) or _generated_text(cls)
            waiting += [field.message for field in messages.field_types(cls).values() if field.message is not None]
    first, *others = parts.items()
    return first[1] + "".join(f"{_SEPARATOR}\nMSG: {name}\n{text}" for name, text in others)


def _installed_text(native_class: Any) -> str:
    """Returns the .msg file from which the class was generated; empty if there is none, as for a type of an .idl."""
    package, own = messages.type_name(native_class).split("/")
    for folder in Path(str(sys.modules[package].__file__)).parents:
        file = folder / "share" / package / "msg" / f"{own}.msg"
        try:
            with file.open(encoding="utf-8") as stream:
                text = stream.read(LONGEST_TEXT).rstrip("\n") + "\n"
            fields = parse_msg(own, text)[own].fields
        except (OSError, ValueError):
            continue
        if [field.name for field in fields] == [
            found for found in messages.field_types(native_class) if found != _EMPTY
        ]:
            return text
    return ""


def _generated_text(native_class: Any) -> str:
    """Returns the fields of the class in .msg syntax: no constants, defaults and comments."""
    return "".join(_line(name, field) for name, field in messages.field_types(native_class).items())


def _line(name: str, field: FieldType) -> str:
    # As in a .msg file: byte, and string<=5 for string<5>.
    element = "byte" if field.kind == "octet" else field.kind.replace("<", "<=").rstrip(">")
    bound = str(field.size) if field.size else f"<={field.most}" if field.most else ""
    return f"{element}{f'[{bound}]' if field.is_array else ''} {name}\n"
