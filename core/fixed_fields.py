"""Numbers at a fixed place in serialized messages, read without deserializing.

Most of what a monitor watches is such a number: `data` of a Float32, or any number before the first string or array
of its message. Formats: CDR (OMG DDS-XTypes 1.3, section 7.4, encapsulations CDR_BE and CDR_LE) and ROS 1's, which has
no padding.
"""

from __future__ import annotations

import struct
from typing import Any, Callable, Iterator, Mapping, Optional, Tuple

from .errors import MessageError
from .native_messages import FieldType

Getter = Callable[[bytes], Any]
"""Returns the number in a serialized message; raises MessageError if the message is too short."""

_FORMATS = {
    "bool": "?", "octet": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I",
    "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
"""struct's letter for each kind of field."""
_CDR_HEADER = 4
"""Bytes before a CDR message: two for the encapsulation, two for options."""
_CDR_BE, _CDR_LE = b"\0\0", b"\0\1"
_MAX_DEPTH = 32

FieldTypes = Callable[[Any], Mapping[str, FieldType]]


def cdr_getter(field_types: FieldTypes, native_class: Any, field: str) -> Optional[Getter]:
    """Returns a getter of a number in CDR messages; None if its place depends on the message.

    Args:
        field_types: returns the type of every field of a message class, by name.
        native_class: the class of the messages.
        field: path of the field, `orientation.x`.
    """
    place = _place(field_types, native_class, field, aligned=True)
    if place is None:
        return None
    letter, offset = place
    little, big = struct.Struct(f"<{letter}").unpack_from, struct.Struct(f">{letter}").unpack_from
    start = _CDR_HEADER + offset

    def get(data: bytes) -> Any:
        try:
            encapsulation = data[:2]
            if encapsulation == _CDR_LE:
                return little(data, start)[0]
            if encapsulation == _CDR_BE:
                return big(data, start)[0]
        except struct.error as error:
            raise MessageError(f"too short for {field}: {error}") from None
        raise MessageError(f"expected a message in CDR, got encapsulation {encapsulation.hex()}")

    return get


def ros1_getter(field_types: FieldTypes, native_class: Any, field: str) -> Optional[Getter]:
    """Returns a getter of a number in ROS 1 messages; the arguments are those of `cdr_getter`."""
    place = _place(field_types, native_class, field, aligned=False)
    if place is None:
        return None
    letter, offset = place
    unpack = struct.Struct(f"<{letter}").unpack_from

    def get(data: bytes) -> Any:
        try:
            return unpack(data, offset)[0]
        except struct.error as error:
            raise MessageError(f"too short for {field}: {error}") from None

    return get


def _place(field_types: FieldTypes, native_class: Any, field: str, *, aligned: bool) -> Optional[Tuple[str, int]]:
    """Returns struct's letter and the offset of a field."""
    offset = 0
    for path, letter in _leaves(field_types, native_class, "", _MAX_DEPTH):
        if letter is None:
            return None
        size = struct.calcsize(f"<{letter}")
        if aligned:
            offset = -(-offset // size) * size
        if path == field:
            return letter, offset
        offset += size
    return None


def _leaves(field_types: FieldTypes, native_class: Any, prefix: str, depth: int) -> Iterator[Tuple[str, Optional[str]]]:
    """Yields path and struct letter of each plain field, in the order of the message; None where sizes vary."""
    for name, field_type in field_types(native_class).items():
        path = f"{prefix}{name}"
        if field_type.is_array or depth == 0:
            yield path, None
        elif field_type.message is not None:
            yield from _leaves(field_types, field_type.message, f"{path}.", depth - 1)
        else:
            yield path, _FORMATS.get(field_type.kind)
