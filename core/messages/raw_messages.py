"""The formats of messages as bytes: those of ROS, and JSON for middlewares that transport mappings.

Sources: mcap.dev/spec/registry; for JSON, the subset of JSON Schema that Foxglove reads: every object has `properties`,
there are no references and no alternatives, and a byte array is text with `contentEncoding: base64`.
"""

from __future__ import annotations

import base64
import functools
import itertools
import json
import math
from typing import Iterator, Mapping, NamedTuple

from ..values import JsonObject, Message, MessageError, canonical_type, split_type_name
from .definitions import NUMBERS, ROS1_KINDS, TEXTS, Definitions, parse_msg

_MOST_PROPERTIES = 5_000
"""Properties of a schema. A definition of a few lines can describe millions; the rest is left open."""
_DEEPEST = 32
_BASE64 = {"type": "string", "contentEncoding": "base64"}
_STAMP = {"type": "object", "properties": {name: {"type": "integer"} for name in ("secs", "nsecs")}}
_PLAIN: Mapping[str, JsonObject] = {
    **{kind: {"type": "number" if "float" in kind else "integer"} for kind in NUMBERS},
    **{kind: {"type": "string"} for kind in TEXTS},
    "bool": {"type": "boolean"},
    "time": _STAMP,
    "duration": _STAMP,
}


PROFILES: Mapping[str, str] = {"ros1": "ros1", "cdr": "ros2", "json": ""}
"""MCAP's profile of each encoding of messages that can be read."""


class RawFormat(NamedTuple):
    """The form of messages as bytes, in the words of MCAP (mcap.dev/spec/registry)."""

    message_encoding: str
    """`ros1`, `cdr` or `json`."""
    schema_name: str
    """The type: `pkg/Type`, of ROS 2 `pkg/msg/Type`."""
    schema_encoding: str
    """`ros1msg`, `ros2msg`, `jsonschema`; from a recording also `ros2idl`."""
    schema: str
    """The definition of the type with those that it contains; empty if it is not known."""

    @property
    def profile(self) -> str:
        """`ros1` or `ros2`; empty for JSON."""
        return PROFILES.get(self.message_encoding, "")

    @property
    def type_name(self) -> str:
        """The type as `package/Type`; empty if the name of the schema is no type of ROS, as JSON may have it."""
        return canonical_type(self.schema_name) if split_type_name(self.schema_name) else ""


@functools.lru_cache(maxsize=1000)
def ros1_format(type_name: str, definition: str) -> RawFormat:
    """Returns the format of serialized messages of ROS 1."""
    return RawFormat("ros1", canonical_type(type_name), "ros1msg", definition)


@functools.lru_cache(maxsize=1000)
def ros2_format(type_name: str, definition: str) -> RawFormat:
    """Returns the format of serialized messages of ROS 2, whose definition is in .msg."""
    return RawFormat("cdr", "/msg/".join(canonical_type(type_name).split("/")), "ros2msg", definition)


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
    schema = {"title": root, **_schema(definitions, root, itertools.repeat(None, _MOST_PROPERTIES))}
    return RawFormat("json", root, "jsonschema", json.dumps(schema, separators=(",", ":")))


def json_text(value: object, *, in_pieces: bool = False) -> str:
    """Returns a value in rosbridge's form as compact JSON in ASCII: null for NaN and infinities, base64 for bytes.

    Python's encoder holds the interpreter's lock until it has finished; with `in_pieces`, for large values in a
    background thread, other threads run in between. Raises MessageError for values that JSON has no type for.
    """
    if in_pieces:
        return "".join(_ENCODER.iterencode(_with_null(value)))
    try:
        return _ENCODER.encode(value)
    except ValueError:
        return _ENCODER.encode(_with_null(value))


def json_bytes(message: Message) -> bytes:
    """Returns a message as `json_text`."""
    return json_text(message).encode("ascii")


def _schema(definitions: Definitions, kind: str, left: Iterator[None], depth: int = 0) -> JsonObject:
    """Returns the schema of a kind of values, with as many properties as are `left`."""
    kind = ROS1_KINDS.get(kind, kind)
    if kind in _PLAIN:
        return _PLAIN[kind]
    definition = definitions.get(kind)
    fields = definition.fields if definition is not None and depth < _DEEPEST else ()
    properties = {}
    for (name, of, size, _), _ in zip(fields, left):
        schema = _schema(definitions, of, left, depth + 1)
        if size is not None:
            schema = _BASE64 if ROS1_KINDS.get(of, of) == "uint8" else {"type": "array", "items": schema}
        properties[name] = schema
    return {"type": "object", "properties": properties}


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
