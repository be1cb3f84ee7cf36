"""The formats of messages as bytes: those of ROS, and JSON for middlewares that transport mappings.

Sources: mcap.dev/spec/registry; for JSON, the subset of JSON Schema that Foxglove reads: every object has `properties`,
there are no references and no alternatives, and a byte array is text with `contentEncoding: base64`.
"""

from __future__ import annotations

import base64
import functools
import json
import math
from typing import Any, Dict, Mapping, Optional, Sequence

from ..messages.definitions import ROS1_KINDS, SEQUENCE, TEXTS, Definitions, Field, parse_definition, parse_msg
from ..messages.dialect import FieldType, Message
from ..messages.fixed_fields import Getter
from ..messages.serialized_statuses import serialized_getter
from ..values.errors import MessageError
from ..values.names import canonical_type
from .middleware import RawFormat

_MOST_PROPERTIES = 5_000
"""Properties of a schema. A definition of a few lines can describe millions; the rest is left open."""
_DEEPEST = 32
_WHOLE_NUMBERS = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
_BASE64 = {"type": "string", "contentEncoding": "base64"}
_STAMP = {"type": "object", "properties": {name: {"type": "integer"} for name in ("secs", "nsecs")}}


@functools.lru_cache(maxsize=1000)
def ros1_format(type_name: str, definition: str) -> RawFormat:
    """Returns the format of serialized messages of ROS 1."""
    return RawFormat("ros1", canonical_type(type_name), "ros1msg", definition, "ros1")


@functools.lru_cache(maxsize=1000)
def ros2_format(type_name: str, definition: str) -> RawFormat:
    """Returns the format of serialized messages of ROS 2, whose definition is in .msg."""
    return RawFormat("cdr", "/msg/".join(canonical_type(type_name).split("/")), "ros2msg", definition, "ros2")


@functools.lru_cache(maxsize=1000)
def json_format(type_name: str, definition: str) -> RawFormat:
    """Returns the format of messages in rosbridge's form as JSON; without a definition the schema allows any object.

    The definition is in .msg with the types that it contains, or empty.
    """
    root = canonical_type(type_name)
    try:
        definitions = parse_msg(root, definition) if definition else {}
    except ValueError:
        definitions = {}
    schema = {"title": root, **_Schemas(definitions).of_type(root, 0)}
    return RawFormat("json", root, "jsonschema", json.dumps(schema, separators=(",", ":")), "")


def bytes_getter(raw_format: RawFormat, field: str) -> Optional[Getter]:
    """Returns a getter of a field from serialized messages; None if it cannot be read from their bytes alone."""
    is_cdr = raw_format.message_encoding == "cdr"
    root = canonical_type(raw_format.schema_name)
    try:
        definitions = parse_definition(root, raw_format.schema, "msg", "uint8" if is_cdr else "int8")
        return serialized_getter(functools.partial(_field_types, definitions), root, field, is_cdr=is_cdr)
    except (ValueError, KeyError):
        return None


def _field_types(definitions: Definitions, type_name: str) -> Mapping[str, FieldType]:
    return {
        name: FieldType(kind, kind, kind if "/" in kind else None, size is not None, None if size == SEQUENCE else size)
        for name, kind, size in definitions[type_name].fields
    }


def json_bytes(message: Message) -> bytes:
    """Returns a message in rosbridge's form as JSON: null for NaN and infinities, base64 for bytes.

    Raises MessageError if it contains values that JSON has no type for.
    """
    try:
        return _ENCODER.encode(message).encode("ascii")
    except ValueError:
        return _ENCODER.encode(_with_null(message)).encode("ascii")


class _Schemas:
    """Makes the schemas of types from their definitions."""

    def __init__(self, definitions: Definitions) -> None:
        self._definitions = definitions
        self._properties_left = _MOST_PROPERTIES

    def of_type(self, name: str, depth: int) -> Dict[str, Any]:
        found = self._definitions.get(name)
        fields: Sequence[Field] = found.fields if found is not None and depth < _DEEPEST else ()
        properties: Dict[str, Any] = {}
        for field in fields:
            if self._properties_left > 0:
                self._properties_left -= 1
                properties[field.name] = self._of_field(field, depth)
        return {"type": "object", "properties": properties}

    def _of_field(self, field: Field, depth: int) -> Mapping[str, Any]:
        kind = ROS1_KINDS.get(field.kind, field.kind)
        if field.size is not None:
            return _BASE64 if kind == "uint8" else {"type": "array", "items": self._of_kind(kind, depth)}
        return self._of_kind(kind, depth)

    def _of_kind(self, kind: str, depth: int) -> Mapping[str, Any]:
        if kind in _WHOLE_NUMBERS:
            return {"type": "integer"}
        if kind in ("float32", "float64"):
            return {"type": "number"}
        if kind == "bool":
            return {"type": "boolean"}
        if kind in TEXTS:
            return {"type": "string"}
        return _STAMP if kind in ("time", "duration") else self.of_type(kind, depth + 1)


def _as_base64(value: object) -> str:
    if isinstance(value, (bytes, bytearray, memoryview)):
        return base64.b64encode(value).decode("ascii")
    raise MessageError(f"{type(value).__name__} cannot be encoded as JSON")


_ENCODER = json.JSONEncoder(allow_nan=False, separators=(",", ":"), default=_as_base64)


def _with_null(value: object) -> object:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _with_null(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_null(item) for item in value]
    return value
