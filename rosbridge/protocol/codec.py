"""JSON and the choice between JSON and CBOR."""

from __future__ import annotations

import base64
import json
import re
from typing import Any, Callable, Dict, Iterator, List, Tuple, Union

from robot_health_monitor.core.errors import MessageError

from .cbor import decode_cbor
from .errors import ProtocolError, shown
from .limits import Limits

__all__ = ["Wire", "decode", "encode_json", "encode_json_with_nan", "encode_large_json"]

Wire = Union[str, bytes]
"""One WebSocket message: text for JSON, binary for CBOR."""

_JSON_STARTS = (b"{", b" ", b"\t", b"\r", b"\n")
"""First bytes of a JSON object; no CBOR map starts with one of them."""
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]")
_INTEGER_CHARS = 20  # of the 64-bit integers
_INFINITY = float("inf")
_SLICE = 100


def decode(data: Wire, limits: Limits) -> Dict[str, Any]:
    """Returns the object in a JSON text, in UTF-8 bytes of JSON, or in CBOR bytes.

    Takes time and memory proportional to the length of `data`.

    Raises:
        ProtocolError: it is none of these, or exceeds a limit.
    """
    if len(data) > limits.message_bytes:
        raise ProtocolError(f"message longer than {limits.message_bytes} bytes")
    if isinstance(data, bytes) and data[:1] not in _JSON_STARTS:
        decoded = decode_cbor(data, limits)
    else:
        decoded = _decode_json(data, limits)
    if not isinstance(decoded, dict):
        raise ProtocolError(f"expected an object, got {shown(decoded)}")
    return decoded


def _decode_json(data: Wire, limits: Limits) -> object:
    try:
        text = data.decode("utf-8") if isinstance(data, bytes) else data
        brackets = text.count("{") + text.count("[")
        if brackets > limits.containers:
            raise ProtocolError(f"more than {limits.containers} lists and objects")
        decoded = _decode_text(text)
        if "\\u" in text and _SURROGATE.search(text):
            json.dumps(decoded, ensure_ascii=False).encode("utf-8")
    except ProtocolError:
        raise
    except RecursionError:
        raise ProtocolError(f"nested more than {limits.nesting} levels deep") from None
    except UnicodeDecodeError:
        raise ProtocolError("not UTF-8") from None
    except UnicodeEncodeError:
        raise ProtocolError("a string contains half of a surrogate pair") from None
    except ValueError as error:
        raise ProtocolError(f"not JSON: {error}") from None
    if brackets > limits.nesting and isinstance(decoded, (dict, list)):
        _check_nesting(decoded, limits.nesting)
    return decoded


def _read_integer(digits: str) -> float:
    # Python needs quadratic time for long integers, and no ROS type holds more than 64 bits.
    return int(digits) if len(digits) <= _INTEGER_CHARS else float(digits)


_DECODER = json.JSONDecoder(parse_int=_read_integer)
_scan: Callable[[str, int], Tuple[object, int]] = _DECODER.scan_once  # type: ignore[attr-defined]


def _decode_text(text: str) -> object:
    """Does what `_DECODER.decode` does, in half the time for a text without white space around it."""
    try:
        decoded, end = _scan(text, 0)
        if end == len(text):
            return decoded
    except StopIteration:
        pass  # white space, or an error that `decode` describes
    return _DECODER.decode(text)


def _check_nesting(value: object, deepest: int) -> None:
    level: List[Any] = [value]
    for _ in range(deepest):
        level = [
            child
            for container in level
            for child in (container.values() if isinstance(container, dict) else container)
            if isinstance(child, (dict, list))
        ]
        if not level:
            return
    raise ProtocolError(f"nested more than {deepest} levels deep")


def encode_json(value: object) -> str:
    """Returns compact JSON. As in rosbridge, NaN and infinities become null, and bytes become base64.

    Raises:
        MessageError: the value contains a type that JSON does not have.
    """
    try:
        return _STRICT_JSON.encode(value)
    except ValueError:
        return _STRICT_JSON.encode(_without_infinities(value))


def encode_json_with_nan(value: object) -> str:
    """Like `encode_json`, but writes NaN and infinities as Python does; rosbridge servers read them."""
    return _LOOSE_JSON.encode(value)


def encode_large_json(value: object) -> str:
    """Like `encode_json`, for a background thread: in slices, so that other threads run in between.

    Python's encoder holds the interpreter lock until it has finished.
    """
    return "".join(_slices(value))


def _slices(value: object) -> Iterator[str]:
    if isinstance(value, dict):
        opening = "{"
        for key, item in value.items():
            yield f"{opening}{encode_json(str(key))}:"
            yield from _slices(item)
            opening = ","
        yield "}" if opening == "," else "{}"
    elif isinstance(value, (list, tuple)) and len(value) > _SLICE:
        opening = "["
        for start in range(0, len(value), _SLICE):
            yield opening + encode_json(list(value[start : start + _SLICE]))[1:-1]
            opening = ","
        yield "]"
    else:
        yield encode_json(value)


def _base64(value: object) -> str:
    if isinstance(value, (bytes, bytearray, memoryview)):
        return base64.b64encode(value).decode("ascii")
    raise MessageError(f"{type(value).__name__} cannot be encoded as JSON")


_STRICT_JSON = json.JSONEncoder(allow_nan=False, separators=(",", ":"), default=_base64)
_LOOSE_JSON = json.JSONEncoder(allow_nan=True, separators=(",", ":"), default=_base64)


def _without_infinities(value: object) -> object:
    if isinstance(value, float):
        return value if -_INFINITY < value < _INFINITY else None
    if isinstance(value, dict):
        return {key: _without_infinities(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_infinities(item) for item in value]
    return value
