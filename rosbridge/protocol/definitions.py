"""Definitions of types that clients ask for, and ROS 1 serialization.

Middlewares with ROS have the definitions of all installed types, and the bytes of their messages. For those without,
core has the definitions of the types that this package publishes, so that `robot-health run` also serves clients that
need raw bytes (Foxglove).
"""

from __future__ import annotations

import base64
import struct
from typing import Any, Callable

from ...core.messages import NUMBERS, ROS1_KINDS, SEQUENCE, SERVICES, Definitions, Field, definition, parse_msg
from ...core.values import Message, MessageError, canonical_type

Serializer = Callable[[Message], bytes]
"""Serializes a complete message as ROS 1 does."""


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


def serializer(type_name: str) -> Serializer | None:
    """Returns a function that serializes a message as ROS 1 does; None for a type whose definition core does not have.

    The function raises MessageError for a message that does not match its type, or lacks a field.
    """
    known, root = parse(type_name), canonical_type(type_name)

    def serialize(message: Message) -> bytes:
        try:
            return _serialized(known, root, message)
        except (struct.error, LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise MessageError(f"message does not match {root}: {error}") from None

    return serialize if root in known else None


def _serialized(known: Definitions, kind: str, value: Any) -> bytes:
    if kind in known:
        return b"".join(_serialized_field(known, field, value[field.name]) for field in known[kind].fields)
    if kind == "string":
        data: bytes = value.encode("utf-8")
        return struct.pack("<I", len(data)) + data
    if kind in ("time", "duration"):
        return struct.pack("<II" if kind == "time" else "<ii", value["secs"], value["nsecs"])
    return struct.pack(f"<{NUMBERS[ROS1_KINDS.get(kind, kind)]}", value)


def _serialized_field(known: Definitions, field: Field, value: Any) -> bytes:
    if field.size is None:
        return _serialized(known, field.kind, value)
    values = base64.b64decode(value, validate=True) if isinstance(value, str) else value  # the text of a byte array
    data = values if isinstance(values, bytes) else b"".join(_serialized(known, field.kind, each) for each in values)
    return struct.pack("<I", len(values)) + data if field.size == SEQUENCE else data
