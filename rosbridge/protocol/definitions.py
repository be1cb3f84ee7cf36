"""Checking messages by the definitions of their types, and ROS 1 serialization.

Middlewares with ROS have the definitions of all installed types. For those without, core has the definitions of the
types that this package publishes, so that `robot-health run` also serves clients that need raw bytes (Foxglove).
"""

from __future__ import annotations

import base64
import struct
from typing import Any, Callable, List, Mapping, Optional, Set

from ...core.messages.definitions import NUMBERS, ROS1_KINDS, Definitions, Field, parse_msg
from ...core.messages.standard_messages import SERVICES, definition
from ...core.values.errors import MessageError
from ...core.values.names import canonical_type

_MOST_TYPES = 200
"""Most types in the definition of a message that is serialized; each may contain the next."""
_LARGEST_ARRAY = 100_000
"""Longest array of fixed length in a message that is serialized."""
_NAN = float("nan")
_LETTERS: Mapping[str, str] = {**NUMBERS, **{name: NUMBERS[kind] for name, kind in ROS1_KINDS.items()}}


def parse(type_name: str, text: str) -> Definitions:
    """Returns the definitions in a full definition by type, `type_name` first; none if it cannot be parsed."""
    try:
        return parse_msg(canonical_type(type_name), text)
    except ValueError:
        return {}


def service_definition(type_name: str, response: bool) -> Definitions:
    """Returns the definition of the request of a known service, or of its response; empty for an unknown service."""
    texts = SERVICES.get(canonical_type(type_name))
    if texts is None:
        return {}
    name = canonical_type(type_name) + ("Response" if response else "Request")
    return parse(name, texts[response])


def serializer(type_name: str, text: str = "") -> Optional[Callable[[Mapping[str, Any]], bytes]]:
    """Returns a function that serializes a message as ROS 1 does; None for an unknown type.

    The function raises MessageError for a message that does not match its type.
    """
    definitions = parse(type_name, text or definition(type_name))
    root = canonical_type(type_name)
    if not _is_complete(definitions, root):
        return None

    def serialize(message: Mapping[str, Any]) -> bytes:
        parts: List[bytes] = []
        try:
            _write_message(definitions, root, message, parts)
        except (struct.error, TypeError, AttributeError, OverflowError, UnicodeEncodeError) as error:
            raise MessageError(f"message does not match {root}: {error}") from None
        return b"".join(parts)

    return serialize


def null_reader(type_name: str, text: str = "") -> Callable[[Mapping[str, Any]], Mapping[str, Any]]:
    """Returns a function that replaces null by NaN in the float fields of a message.

    rosbridge writes NaN as null. Messages of unknown types are returned unchanged.
    """
    definitions = parse(type_name, text or definition(type_name))
    root = canonical_type(type_name)
    return lambda message: _with_nan(definitions, root, message)


def _with_nan(definitions: Definitions, type_name: str, message: Mapping[str, Any]) -> Mapping[str, Any]:
    message_definition = definitions.get(type_name)
    if message_definition is None:
        return message
    read = dict(message)
    for field in message_definition.fields:
        value = read.get(field.name, "")
        if field.kind in ("float32", "float64"):
            if value is None:
                read[field.name] = _NAN
            elif isinstance(value, list):
                read[field.name] = [_NAN if item is None else item for item in value]
        elif field.kind in definitions and isinstance(value, dict):
            read[field.name] = _with_nan(definitions, field.kind, value)
        elif field.kind in definitions and isinstance(value, list):
            read[field.name] = [
                _with_nan(definitions, field.kind, item) if isinstance(item, dict) else item for item in value
            ]
    return read


def _is_complete(definitions: Definitions, root: str) -> bool:
    """Returns whether every type that is needed has fields and can be written, and none contains itself."""
    complete: Set[str] = set()
    above: Set[str] = set()

    def check(name: str) -> bool:
        of_type = definitions.get(name)
        if name in above or of_type is None or not of_type.fields:
            return False
        above.add(name)
        for field in of_type.fields:
            is_plain = field.kind in _LETTERS or field.kind in ("string", "time", "duration")
            if (field.size or 0) > _LARGEST_ARRAY:
                return False
            if not is_plain and field.kind not in complete and not check(field.kind):
                return False
        above.remove(name)
        complete.add(name)
        return True

    return len(definitions) <= _MOST_TYPES and check(root)


def _write_message(definitions: Definitions, type_name: str, message: Mapping[str, Any], parts: List[bytes]) -> None:
    for field in definitions[type_name].fields:
        value = message.get(field.name)
        if field.size is None:
            _write_value(definitions, field.kind, value, parts)
            continue
        length = max(field.size, 0)
        values = value or [None] * length
        if isinstance(values, str):
            values = _bytes_of(field, values)
        if length and len(values) != length:
            raise MessageError(f"{field.name}: expected {length} values, got {len(values)}")
        if not length:
            parts.append(struct.pack("<I", len(values)))
        if isinstance(values, bytes):
            parts.append(values)
            continue
        for item in values:
            _write_value(definitions, field.kind, item, parts)


def _bytes_of(field: Field, text: str) -> bytes:
    """Returns a byte array, which is base64 text in rosbridge's form."""
    if _LETTERS.get(field.kind) != "B":
        raise MessageError(f"{field.name}: expected a list, got text")
    try:
        return base64.b64decode(text, validate=True)
    except ValueError as error:
        raise MessageError(f"{field.name}: expected base64 text: {error}") from None


def _write_value(definitions: Definitions, kind: str, value: Any, parts: List[bytes]) -> None:
    form = _LETTERS.get(kind)
    if form is not None:
        if value is None:
            value = _NAN if form in "fd" else 0
        parts.append(struct.pack(f"<{form}", value))
    elif kind == "string":
        data = (value or "").encode("utf-8")
        parts.append(struct.pack("<I", len(data)) + data)
    elif kind in ("time", "duration"):
        stamp = value or {}
        seconds = stamp.get("secs", stamp.get("sec", 0))
        nanoseconds = stamp.get("nsecs", stamp.get("nanosec", 0))
        parts.append(struct.pack("<II" if kind == "time" else "<ii", seconds, nanoseconds))
    else:
        _write_message(definitions, kind, value or {}, parts)
