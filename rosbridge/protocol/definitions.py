"""Checking messages by the definitions of their types, and ROS 1 serialization.

Middlewares with ROS have the definitions of all installed types. For those without, core has the definitions of the
types that this package publishes, so that `robot-health run` also serves clients that need raw bytes (Foxglove).
"""

from __future__ import annotations

import base64
import functools
import math
import struct
from typing import Any, Callable, Dict, Mapping, Optional, Sequence, Tuple

from ...core.messages.definitions import NUMBERS, ROS1_KINDS, Definitions, Field, parse_msg
from ...core.messages.standard_messages import SERVICES, definition
from ...core.values.errors import MessageError
from ...core.values.names import canonical_type

_MOST_TYPES = 200
"""Most types in the definition of a message that is serialized; each may contain the next."""
_LARGEST_ARRAY = 100_000
"""Longest array of fixed length in a message that is serialized."""

Serializer = Callable[[Any], bytes]
"""Serializes a value as ROS 1 does; None stands for zero, NaN or nothing."""


def parse(type_name: str, text: str = "") -> Definitions:
    """Returns the definitions in a full definition by type, `type_name` first; none if it cannot be parsed.

    Without a text, the definition that core has of the type is used.
    """
    text = text or definition(type_name)
    try:
        return parse_msg(canonical_type(type_name), text) if text else {}
    except ValueError:
        return {}


def service_definition(type_name: str, response: bool) -> Definitions:
    """Returns the definition of the request of a known service, or of its response; empty for an unknown service."""
    name = canonical_type(type_name)
    texts = SERVICES.get(name)
    return {} if texts is None else parse_msg(name + ("Response" if response else "Request"), texts[response])


def serializer(type_name: str, text: str = "") -> Optional[Serializer]:
    """Returns a function that serializes a message as ROS 1 does; None for an unknown type.

    The function raises MessageError for a message that does not match its type.
    """
    definitions, root = parse(type_name, text), canonical_type(type_name)
    if len(definitions) > _MOST_TYPES:
        return None
    try:
        write = _serializer(root, definitions, {**_NUMBERS, "string": _text, "time": _time, "duration": _duration})
    except KeyError:
        return None

    def serialize(message: Mapping[str, Any]) -> bytes:
        try:
            return write(message)
        except (struct.error, TypeError, AttributeError, OverflowError, UnicodeEncodeError) as error:
            raise MessageError(f"message does not match {root}: {error}") from None

    return serialize


def null_reader(type_name: str, text: str = "") -> Callable[[Mapping[str, Any]], Mapping[str, Any]]:
    """Returns a function that replaces null by NaN in the float fields of a message.

    rosbridge writes NaN as null. Messages of unknown types are returned unchanged.
    """
    kinds = {name: {field.name: field.kind for field in one.fields} for name, one in parse(type_name, text).items()}
    return functools.partial(_with_nan, kinds, canonical_type(type_name))


def _with_nan(kinds: Mapping[str, Mapping[str, str]], kind: str, value: Any) -> Any:
    if isinstance(value, list):
        return [_with_nan(kinds, kind, item) for item in value]
    if isinstance(value, dict) and kind in kinds:
        return {name: _with_nan(kinds, kinds[kind].get(name, ""), item) for name, item in value.items()}
    return math.nan if value is None and kind in ("float32", "float64") else value


def _serializer(kind: str, definitions: Definitions, known: Dict[str, Serializer]) -> Serializer:
    """Returns what serializes a type, and adds it to those that are known.

    Raises KeyError if the type or one in it is not defined, contains itself, or is too large.
    """
    if kind not in known:
        fields = definitions.pop(kind).fields  # a type within itself is then not defined
        if not fields or any((field.size or 0) > _LARGEST_ARRAY for field in fields):
            raise KeyError(kind)
        members = [(field.name, _member(field, _serializer(field.kind, definitions, known))) for field in fields]
        known[kind] = functools.partial(_message, members)
    return known[kind]


def _message(members: Sequence[Tuple[str, Serializer]], message: Optional[Mapping[str, Any]]) -> bytes:
    values = message or {}
    return b"".join([write(values.get(name)) for name, write in members])


def _member(field: Field, write: Serializer) -> Serializer:
    if field.size is None:
        return write
    length = max(field.size, 0)

    def write_array(value: Any) -> bytes:
        values = value or [None] * length
        if isinstance(values, str):
            values = _bytes_of(field, values)
        if length and len(values) != length:
            raise MessageError(f"{field.name}: expected {length} values, got {len(values)}")
        data = values if isinstance(values, bytes) else b"".join(map(write, values))
        return data if length else struct.pack("<I", len(values)) + data

    return write_array


def _bytes_of(field: Field, text: str) -> bytes:
    """Returns a byte array, which is base64 text in rosbridge's form."""
    if ROS1_KINDS.get(field.kind, field.kind) != "uint8":
        raise MessageError(f"{field.name}: expected a list, got text")
    try:
        return base64.b64decode(text, validate=True)
    except ValueError as error:
        raise MessageError(f"{field.name}: expected base64 text: {error}") from None


def _number(letter: str) -> Serializer:
    form, default = struct.Struct(f"<{letter}"), math.nan if letter in "fd" else 0
    return lambda value: form.pack(default if value is None else value)


def _text(value: Optional[str]) -> bytes:
    data = (value or "").encode("utf-8")
    return struct.pack("<I", len(data)) + data


def _time(value: Optional[Mapping[str, Any]], form: str = "<II") -> bytes:
    stamp = value or {}
    seconds = stamp.get("secs", stamp.get("sec", 0))
    return struct.pack(form, seconds, stamp.get("nsecs", stamp.get("nanosec", 0)))


_duration = functools.partial(_time, form="<ii")
_NUMBERS = {kind: _number(NUMBERS[ROS1_KINDS.get(kind, kind)]) for kind in (*NUMBERS, *ROS1_KINDS)}
