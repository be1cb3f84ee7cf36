"""CBOR, both ways: the library cbor2, held to what rosbridge means by it.

Whatever CBOR can say beyond JSON comes out as rosbridge shapes it in JSON (typed arrays as lists, byte strings as
base64) or is refused (dates, cycles, regular expressions).
"""

from __future__ import annotations

import base64
import struct
from typing import Any, Dict, Mapping

import cbor2

from .errors import ProtocolError
from .limits import Limits

_TYPED_ARRAYS = {64: "B", 69: "H", 70: "I", 71: "Q", 72: "b", 77: "h", 78: "i", 79: "q", 85: "f", 86: "d"}
"""Tags of RFC 8746 for little-endian arrays, and the struct format of one element."""


def encode_cbor(value: Mapping[str, Any]) -> bytes:
    """Returns `value` as CBOR."""
    return cbor2.dumps(value)


def decode_cbor(data: bytes, limits: Limits) -> object:
    """Returns what `data` holds, as JSON would hold it.

    Raises:
        ProtocolError: it is not CBOR, or says more than rosbridge does.
    """
    try:
        decoded = cbor2.loads(data, tag_hook=_read_tag)
    except ProtocolError:
        raise
    except Exception as error:  # cbor2 lets the errors of what it builds (dates, fractions) through, whatever they are
        raise ProtocolError(f"the message is neither JSON nor CBOR: {type(error).__name__}") from None
    return _plain(decoded, limits.nesting)


def _read_tag(*arguments: Any) -> object:
    # (decoder, tag) up to cbor2 5, (tag, whether it must be immutable) from 6 on
    tag = next(argument for argument in arguments if isinstance(argument, cbor2.CBORTag))
    form = _TYPED_ARRAYS.get(tag.tag)
    if form is None or not isinstance(tag.value, bytes):
        raise ProtocolError(f"the message uses the unknown CBOR tag {tag.tag}")
    count, left = divmod(len(tag.value), struct.calcsize(f"<{form}"))
    if left:
        raise ProtocolError(f"an array of CBOR tag {tag.tag} is cut")
    return list(struct.unpack(f"<{count}{form}", tag.value))


def _plain(value: object, deeper: int) -> object:
    if value is None or isinstance(value, (str, int, float)):
        return value
    if isinstance(value, bytes):
        return base64.b64encode(value).decode("ascii")
    if deeper == 0:
        raise ProtocolError("the message is nested too deeply")
    if isinstance(value, (list, tuple)):
        return [_plain(item, deeper - 1) for item in value]
    if isinstance(value, dict):
        plain: Dict[str, object] = {}
        for key, item in value.items():
            if not isinstance(key, str):
                raise ProtocolError("a key in the message is not a text")
            plain[key] = _plain(item, deeper - 1)
        return plain
    raise ProtocolError(f"the message holds a {type(value).__name__}, which rosbridge does not know")
