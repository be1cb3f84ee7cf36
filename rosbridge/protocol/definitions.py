"""Message definitions: parsing, checking messages, and ROS 1 serialization.

Middlewares with ROS have the definitions of all installed types. For those without, this module has the definitions of
the types that this package publishes, so that `robot-health run` also serves clients that need raw bytes (Foxglove).
"""

from __future__ import annotations

import re
import struct
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from robot_health_monitor.core.errors import MessageError
from robot_health_monitor.core.middleware import split_type_name
from robot_health_monitor.core.standard_messages import MESSAGES, SERVICES

__all__ = [
    "Definition",
    "Field",
    "canonical",
    "full_text",
    "null_reader",
    "parse",
    "serializer",
    "service_definition",
]

_MOST_TYPES = 200
"""Most types in the definition of a message that is serialized; each may contain the next."""
_LARGEST_ARRAY = 100_000
"""Longest array of fixed length in a message that is serialized."""
_LOG = (
    "byte DEBUG=1\nbyte INFO=2\nbyte WARN=4\nbyte ERROR=8\nbyte FATAL=16\n"
    "std_msgs/Header header\nbyte level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n"
    "string[] topics\n"
)
_TEXTS: Mapping[str, str] = {**MESSAGES, "rosgraph_msgs/Log": _LOG, "rosgraph_msgs/Clock": "time clock\n"}
_SEPARATOR = "=" * 80
_NAN = float("nan")
_PRIMITIVES = {
    "bool": "?",
    "byte": "b",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
_LINE = re.compile(r"^(?P<type>[\w/]+)(<=\d+)?(?P<array>\[(?P<length>[^\]]*)\])?\s+(?P<name>\w+)\s*(?P<rest>.*)$")
_STRING_CONSTANT = re.compile(r"^\s*w?string(<=\d+)?\s+\w+\s*=")


class Field(NamedTuple):
    """One field of a message."""

    name: str
    type: str
    """A primitive (`float32`), `string`, `time`, or another message's type (`std_msgs/Header`)."""
    length: int
    """-1: not an array; 0: an array of any length; else the length of the array."""


class Definition(NamedTuple):
    """One message type."""

    type: str
    fields: Sequence[Field]
    constants: Sequence[Tuple[str, str]]
    """(name, value as text) per constant."""


def canonical(type_name: str) -> str:
    """Returns a type name as `package/Type`."""
    split = split_type_name(type_name)
    return "/".join(split) if split else type_name


def full_text(type_name: str) -> str:
    """Returns the definition of a known type, with the types that it contains; empty for an unknown type."""
    text = _TEXTS.get(canonical(type_name))
    if text is None:
        return ""
    parts = [text]
    seen = {canonical(type_name)}
    for inner in _inner_types(text):
        if inner not in seen:
            seen.add(inner)
            parts.append(f"{_SEPARATOR}\nMSG: {inner}\n{full_text(inner)}")
    return _without_repetitions("".join(parts))


def parse(type_name: str, text: str) -> Dict[str, Definition]:
    """Parses a full definition; returns the definitions in it by type, `type_name` first."""
    definitions: Dict[str, Definition] = {}
    current = canonical(type_name)
    lines: List[str] = []
    for line in [*text.splitlines(), _SEPARATOR]:
        if line.startswith(_SEPARATOR[:40]):
            definitions.setdefault(current, _definition(current, lines))
            lines = []
        elif line.startswith("MSG: "):
            current = canonical(line[5:].strip())
        else:
            lines.append(line)
    return definitions


def service_definition(type_name: str, response: bool) -> Dict[str, Definition]:
    """Returns the definition of the request of a known service, or of its response; empty for an unknown service."""
    texts = SERVICES.get(canonical(type_name))
    if texts is None:
        return {}
    name = canonical(type_name) + ("Response" if response else "Request")
    return parse(name, texts[response])


def serializer(type_name: str, text: str = "") -> Optional[Callable[[Mapping[str, Any]], bytes]]:
    """Returns a function that serializes a message as ROS 1 does; None for an unknown type.

    The function raises MessageError for a message that does not match its type.
    """
    definitions = parse(type_name, text or full_text(type_name))
    root = canonical(type_name)
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
    definitions = parse(type_name, text or full_text(type_name))
    root = canonical(type_name)
    return lambda message: _with_nan(definitions, root, message)


def _with_nan(definitions: Mapping[str, Definition], type_name: str, message: Mapping[str, Any]) -> Mapping[str, Any]:
    definition = definitions.get(type_name)
    if definition is None:
        return message
    read = dict(message)
    for field in definition.fields:
        value = read.get(field.name, "")
        if field.type in ("float32", "float64"):
            if value is None:
                read[field.name] = _NAN
            elif isinstance(value, list):
                read[field.name] = [_NAN if item is None else item for item in value]
        elif field.type in definitions and isinstance(value, dict):
            read[field.name] = _with_nan(definitions, field.type, value)
        elif field.type in definitions and isinstance(value, list):
            read[field.name] = [
                _with_nan(definitions, field.type, item) if isinstance(item, dict) else item for item in value
            ]
    return read


def _definition(type_name: str, lines: Sequence[str]) -> Definition:
    fields: List[Field] = []
    constants: List[Tuple[str, str]] = []
    package = type_name.partition("/")[0]
    for line in lines:
        # In a string constant, everything after the equals sign belongs to the value.
        is_string_constant = _STRING_CONSTANT.match(line) is not None
        found = _LINE.match((line if is_string_constant else line.partition("#")[0]).strip())
        if found is None:
            continue
        kind, rest = found["type"], found["rest"]
        if rest.startswith("="):
            constants.append((found["name"], rest[1:].strip()))
            continue
        fields.append(Field(found["name"], _resolved(kind, package), _length(found["array"], found["length"])))
    return Definition(type_name, fields, constants)


def _resolved(kind: str, package: str) -> str:
    if kind in _PRIMITIVES or kind in ("string", "wstring", "time", "duration"):
        return kind
    if kind == "Header":
        return "std_msgs/Header"
    return canonical(kind) if "/" in kind else f"{package}/{kind}"


def _length(array: Optional[str], length: Optional[str]) -> int:
    if array is None:
        return -1
    return int(length[:10]) if length and length.isdecimal() else 0


def _inner_types(text: str) -> List[str]:
    return [field.type for field in _definition("", text.splitlines()).fields if "/" in field.type]


def _without_repetitions(text: str) -> str:
    parts = text.split(_SEPARATOR + "\n")
    return (_SEPARATOR + "\n").join(dict.fromkeys(parts))


def _is_complete(definitions: Mapping[str, Definition], root: str) -> bool:
    """Returns whether every type that is needed has fields and can be written, and none contains itself."""
    complete: Set[str] = set()
    above: Set[str] = set()

    def check(name: str) -> bool:
        definition = definitions.get(name)
        if name in above or definition is None or not definition.fields:
            return False
        above.add(name)
        for field in definition.fields:
            is_plain = field.type in _PRIMITIVES or field.type in ("string", "time", "duration")
            if field.length > _LARGEST_ARRAY:
                return False
            if not is_plain and field.type not in complete and not check(field.type):
                return False
        above.remove(name)
        complete.add(name)
        return True

    return len(definitions) <= _MOST_TYPES and check(root)


def _write_message(
    definitions: Mapping[str, Definition], type_name: str, message: Mapping[str, Any], parts: List[bytes]
) -> None:
    for field in definitions[type_name].fields:
        value = message.get(field.name)
        if field.length == -1:
            _write_value(definitions, field.type, value, parts)
            continue
        values = value or [None] * field.length
        if field.length and len(values) != field.length:
            raise MessageError(f"{field.name}: expected {field.length} values, got {len(values)}")
        if not field.length:
            parts.append(struct.pack("<I", len(values)))
        for item in values:
            _write_value(definitions, field.type, item, parts)


def _write_value(definitions: Mapping[str, Definition], kind: str, value: Any, parts: List[bytes]) -> None:
    form = _PRIMITIVES.get(kind)
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
