"""CBOR (RFC 8949) as rosbridge uses it.

The decoder accepts only what rosbridge peers send: the types of JSON, byte strings and typed arrays, all of definite
length. General CBOR libraries also follow shared references, big numbers and string references, with which a message of
149 bytes can fill the memory. Here each byte of the message is read once and every length is checked against what is
left of the message.
"""

from __future__ import annotations

import base64
import struct
from typing import Any, Dict, List, Mapping, Tuple

import cbor2

from robot_health_monitor.core.errors import MessageError

from .errors import ProtocolError
from .limits import Limits

__all__ = ["decode_cbor", "encode_cbor"]

_TYPED_ARRAYS = {64: "B", 69: "H", 70: "I", 71: "Q", 72: "b", 77: "h", 78: "i", 79: "q", 85: "f", 86: "d"}
"""Tags of RFC 8746 for little-endian arrays, and the struct format of an element."""
_UNSIGNED, _NEGATIVE, _BYTES, _TEXT, _LIST, _MAP, _TAG, _SIMPLE = range(8)
_CONSTANTS: Dict[int, Any] = {20: False, 21: True, 22: None, 23: None}
_FLOATS = {25: struct.Struct(">e"), 26: struct.Struct(">f"), 27: struct.Struct(">d")}


def encode_cbor(value: Mapping[str, Any]) -> bytes:
    """Returns `value` as CBOR.

    Raises:
        MessageError: the value contains a type that cannot be encoded.
    """
    try:
        return cbor2.dumps(value)
    except (cbor2.CBOREncodeError, ValueError, TypeError) as error:
        raise MessageError(f"cannot be encoded as CBOR: {error}") from None


def decode_cbor(data: bytes, limits: Limits) -> object:
    """Returns the value in `data` as JSON would represent it: typed arrays as lists, byte strings as base64.

    Raises:
        ProtocolError: it is not CBOR, uses a feature that rosbridge does not, or exceeds a limit.
    """
    decoder = _Decoder(data, limits)
    value = decoder.item(limits.nesting)
    if decoder.position != len(data):
        raise ProtocolError("bytes after the end of the CBOR message")
    return value


class _Decoder:
    def __init__(self, data: bytes, limits: Limits) -> None:
        self.position = 0
        self._data = data
        self._containers_left = limits.containers
        self._nesting = limits.nesting

    def item(self, levels: int) -> Any:
        """Reads one item, with at most `levels` levels of lists and maps."""
        kind, argument = self._head()
        if kind == _TEXT:
            return self._text(argument)
        if kind == _SIMPLE:
            return argument
        if kind == _UNSIGNED:
            return argument
        if kind == _NEGATIVE:
            return -1 - argument
        if kind == _BYTES:
            return base64.b64encode(self._take(argument)).decode("ascii")
        if kind == _TAG:
            return self._typed_array(argument)
        return self._container(kind, argument, levels)

    def _container(self, kind: int, length: int, levels: int) -> Any:
        if levels == 0:
            raise ProtocolError(f"nested more than {self._nesting} levels deep")
        self._containers_left -= 1
        if self._containers_left < 0:
            raise ProtocolError("too many lists and maps")
        if length > len(self._data) - self.position:
            raise ProtocolError("the CBOR message is cut off")
        if kind == _LIST:
            return [self.item(levels - 1) for _ in range(length)]
        items: Dict[str, Any] = {}
        for _ in range(length):
            key_kind, argument = self._head()
            if key_kind != _TEXT:
                raise ProtocolError("a key is not a string")
            key = self._text(argument)
            items[key] = self.item(levels - 1)
        return items

    def _head(self) -> Tuple[int, Any]:
        """Reads the start of an item; returns its major type and its length or value."""
        first = self._take(1)[0]
        kind, info = first >> 5, first & 31
        if kind == _SIMPLE:
            return kind, self._simple(info)
        if info < 24:
            return kind, info
        if info > 27:
            raise ProtocolError("CBOR items of indefinite length are not supported")
        return kind, int.from_bytes(self._take(1 << (info - 24)), "big")

    def _simple(self, info: int) -> Any:
        if info in _FLOATS:
            form = _FLOATS[info]
            return form.unpack(self._take(form.size))[0]
        if info not in _CONSTANTS:
            raise ProtocolError(f"unknown CBOR value {info}")
        return _CONSTANTS[info]

    def _text(self, length: int) -> str:
        try:
            return self._take(length).decode("utf-8")
        except UnicodeDecodeError:
            raise ProtocolError("a string is not UTF-8") from None

    def _typed_array(self, tag: int) -> List[Any]:
        form = _TYPED_ARRAYS.get(tag)
        if form is None:
            raise ProtocolError(f"CBOR tag {tag} is not supported")
        kind, length = self._head()
        if kind != _BYTES:
            raise ProtocolError("a typed array is not a byte string")
        count, rest = divmod(length, struct.calcsize(f"<{form}"))
        if rest:
            raise ProtocolError("a typed array is cut off")
        return list(struct.unpack(f"<{count}{form}", self._take(length)))

    def _take(self, length: int) -> bytes:
        end = self.position + length
        if end > len(self._data):
            raise ProtocolError("the CBOR message is cut off")
        taken = self._data[self.position : end]
        self.position = end
        return taken
