"""The encodings of messages: JSON and CBOR (RFC 8949).

The CBOR decoder accepts only what rosbridge peers send: the types of JSON, byte strings and typed arrays, all of
definite length. General CBOR libraries also follow shared references, big numbers and string references, with which a
message of 149 bytes can fill the memory. Here each byte of the message is read once and every length is checked against
what is left of the message.
"""

from __future__ import annotations

import base64
import functools
import json
import re
import struct
from typing import Any, Callable, Sequence, Union

from ...core.messages import json_text
from ...core.values import JsonObject, MessageError, describe, shallow_json
from ...runtime.libraries import missing_text
from .limits import DEFAULT_LIMITS, Limits, ProtocolError

try:
    import cbor2
except ImportError:  # optional, and only for encoding: the Debian packages of the nodes do not depend on it
    cbor2 = None  # type: ignore[assignment]

CBOR_PROBLEM = missing_text(["cbor2"]) if cbor2 is None else ""
"""Why CBOR cannot be sent; empty if it can."""

CBOR_SUBPROTOCOL = "rosbridge.v2.cbor"
"""WebSocket subprotocol by which this package's client and server agree to send CBOR."""
SUBPROTOCOLS: Sequence[str] = () if CBOR_PROBLEM else (CBOR_SUBPROTOCOL,)
"""Those that a client requests and a server accepts."""

Wire = Union[str, bytes]
"""One WebSocket message: text for JSON, binary for CBOR."""

CBOR_COMPRESSIONS = ("cbor", "cbor-raw")
"""Compressions of which messages are CBOR; others are JSON. There are no images (`png`)."""
_JSON_STARTS = (b"{", b" ", b"\t", b"\r", b"\n")
"""First bytes of a JSON object; no CBOR map starts with one of them."""
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_INTEGER_CHARS = 20  # of the 64-bit integers


def decode(data: Wire, limits: Limits) -> dict[str, Any]:
    """Returns the object in JSON text, UTF-8 bytes of JSON, or CBOR bytes.

    Raises ProtocolError if there is none, or if it exceeds a limit. Takes time and memory proportional to the
    length of `data`.
    """
    if len(data) > limits.message_bytes:
        raise ProtocolError(f"message longer than {limits.message_bytes} bytes")
    if isinstance(data, bytes) and data[:1] not in _JSON_STARTS:
        decoded = decode_cbor(data, limits)
    else:
        decoded = _decode_json(data, limits)
    if not isinstance(decoded, dict):
        raise ProtocolError(f"expected an object, got {describe(decoded)}")
    return decoded


def _decode_json(data: Wire, limits: Limits) -> object:
    try:
        text = data.decode("utf-8") if isinstance(data, bytes) else data
        if text.count("{") + text.count("[") > limits.containers:
            raise ProtocolError(f"more than {limits.containers} lists and objects")
        decoded = _DECODER.decode(shallow_json(text, limits.nesting))
        if "\\u" in text and _SURROGATE.search(text):
            # Half of a surrogate pair in one name must not cost the other names of a message.
            decoded = json.loads(json.dumps(decoded, ensure_ascii=False).encode("utf-8", "replace"))
    except ProtocolError:
        raise
    except RecursionError as error:
        raise ProtocolError(str(error)) from None
    except UnicodeDecodeError:
        raise ProtocolError("not UTF-8") from None
    except ValueError as error:
        raise ProtocolError(f"not JSON: {error}") from None
    return decoded


def _read_integer(digits: str) -> float:
    # Python needs quadratic time for long integers, and no ROS type holds more than 64 bits.
    return int(digits) if len(digits) <= _INTEGER_CHARS else float(digits)


_DECODER = json.JSONDecoder(parse_int=_read_integer)


def encode(fields: JsonObject, compression: str = "none", *, is_large: bool = False) -> Wire:
    """Returns the message to transmit for an operation, encoded with one of COMPRESSIONS.

    Raises MessageError if a value cannot be encoded. A large one should be encoded in a background thread.
    """
    return encode_cbor(fields) if compression in CBOR_COMPRESSIONS else json_text(fields, in_pieces=is_large)


_TYPED_ARRAYS = {64: "B", 69: "H", 70: "I", 71: "Q", 72: "b", 77: "h", 78: "i", 79: "q", 85: "f", 86: "d"}
"""Tags of RFC 8746 for little-endian arrays, and the struct format of an element."""
_UNSIGNED, _NEGATIVE, _BYTES, _TEXT, _LIST, _MAP, _TAG, _SIMPLE = range(8)
_CONSTANTS: dict[int, Any] = {20: False, 21: True, 22: None, 23: None}
_FLOATS = {25: struct.Struct(">e"), 26: struct.Struct(">f"), 27: struct.Struct(">d")}


def encode_cbor(value: JsonObject) -> bytes:
    """Returns `value` as CBOR; raises MessageError for a type that cannot be encoded, or with `CBOR_PROBLEM`."""
    if cbor2 is None:
        raise MessageError(CBOR_PROBLEM)
    try:
        return cbor2.dumps(value)
    except (cbor2.CBOREncodeError, ValueError, TypeError) as error:
        raise MessageError(f"cannot be encoded as CBOR: {error}") from None


def decode_cbor(data: bytes, limits: Limits) -> object:
    """Returns the value in `data` as from JSON: typed arrays as lists, byte strings as base64. Raises as `decode`."""
    decoder = _CborDecoder(data, limits)
    value = decoder.item(limits.nesting)
    if decoder.position != len(data):
        raise ProtocolError("bytes after the end of the CBOR message")
    return value


class _CborDecoder:
    def __init__(self, data: bytes, limits: Limits) -> None:
        self.position = 0
        self._data = data
        self._containers_left = limits.containers
        self._nesting = limits.nesting

    def item(self, levels: int) -> Any:
        """Reads one item, with at most `levels` levels of lists and maps."""
        kind, argument = self.head()
        if kind == _TEXT:
            return self._text(argument)
        if kind in (_SIMPLE, _UNSIGNED):
            return argument
        if kind == _NEGATIVE:
            return -1 - argument
        if kind == _BYTES:
            return base64.b64encode(self.take(argument)).decode("ascii")
        if kind == _TAG:
            return self._typed_array(argument)
        return self._container(kind, argument, levels)

    def head(self) -> tuple[int, Any]:
        """Reads the start of an item; returns its major type and its length or value."""
        first = self.take(1)[0]
        kind, info = first >> 5, first & 31
        if kind == _SIMPLE:
            return kind, self._simple(info)
        if info < 24:
            return kind, info
        if info > 27:
            raise ProtocolError("CBOR items of indefinite length are not supported")
        return kind, int.from_bytes(self.take(1 << (info - 24)), "big")

    def argument(self, expected: int) -> Any:
        """Reads the start of an item of a major type; returns its length or value."""
        kind, argument = self.head()
        if kind != expected:
            raise ProtocolError(f"expected a CBOR item of type {expected}, got {kind}")
        return argument

    def key(self) -> str:
        """Reads an item that must be a text."""
        return self._text(self.argument(_TEXT))

    def members(self, **read: Callable[[], Any]) -> dict[str, Any]:
        """Reads a map of exactly these keys, in any order; raises ProtocolError or KeyError for another item."""
        if self.argument(_MAP) != len(read):
            raise ProtocolError("a map of another length")
        values = {}
        while read:
            name = self.key()
            values[name] = read.pop(name)()
        return values

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
        return {self.key(): self.item(levels - 1) for _ in range(length)}

    def _simple(self, info: int) -> Any:
        if info in _FLOATS:
            form = _FLOATS[info]
            return form.unpack(self.take(form.size))[0]
        if info not in _CONSTANTS:
            raise ProtocolError(f"unknown CBOR value {info}")
        return _CONSTANTS[info]

    def _text(self, length: int) -> str:
        return self.take(length).decode("utf-8", "replace")

    def _typed_array(self, tag: int) -> list[Any]:
        form = _TYPED_ARRAYS.get(tag)
        if form is None:
            raise ProtocolError(f"CBOR tag {tag} is not supported")
        length = self.argument(_BYTES)
        count, rest = divmod(length, struct.calcsize(f"<{form}"))
        if rest:
            raise ProtocolError("a typed array is cut off")
        return list(struct.unpack(f"<{count}{form}", self.take(length)))

    def take(self, length: int) -> bytes:
        """Reads so many bytes."""
        end = self.position + length
        if end > len(self._data):
            raise ProtocolError("the CBOR message is cut off")
        taken = self._data[self.position : end]
        self.position = end
        return taken


HEAD_BYTES = 2_048
"""How much of a message `topic_of_message` looks at."""
_JSON_HEAD = re.compile(r'\s*\{\s*"op"\s*:\s*"publish"\s*,\s*"topic"\s*:\s*("(?:[^"\\\x00-\x1f]|\\.)*")')


def topic_of_message(data: Wire) -> str | None:
    """Returns the topic of a large message without decoding the message, which need not be valid.

    Only `HEAD_BYTES` are looked at: servers write `op` and `topic` first. Returns None for another operation, or if the
    topic comes later.
    """
    head = data[:HEAD_BYTES]
    try:
        if isinstance(head, str):
            found = _JSON_HEAD.match(head)
            return json.loads(found[1]) if found else None
        decoder = _CborDecoder(head, DEFAULT_LIMITS)
        decoder.argument(_MAP)
        *start, topic = [decoder.key() for _ in range(4)]
    except ValueError:  # an escape that JSON does not have; in CBOR, something else than a text, or the end of the head
        return None
    return topic if start == ["op", "publish", "topic"] else None


def serialized_publication(data: bytes) -> tuple[str, bytes] | None:
    """Returns topic and bytes of a message of the compression `cbor-raw`, of any size; None for another message."""
    decoder = _CborDecoder(data, DEFAULT_LIMITS)
    count = functools.partial(decoder.argument, _UNSIGNED)
    message = functools.partial(
        decoder.members, secs=count, nsecs=count, bytes=lambda: decoder.take(decoder.argument(_BYTES))
    )
    try:
        fields = decoder.members(op=decoder.key, topic=decoder.key, msg=message)
    except (ProtocolError, KeyError):
        return None
    return (fields["topic"], fields["msg"]["bytes"]) if fields["op"] == "publish" else None
