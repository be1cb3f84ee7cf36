"""WebSocket frames, encoded once for any number of clients."""

from __future__ import annotations

import struct
from typing import Union

_FINAL_TEXT, _FINAL_BINARY = 0x81, 0x82


def frame(message: Union[str, bytes]) -> bytes:
    """Returns a message as one WebSocket frame of a server: not masked, so that it fits every client.

    RFC 6455, section 5.2.
    """
    first = _FINAL_BINARY if isinstance(message, bytes) else _FINAL_TEXT
    data = message if isinstance(message, bytes) else message.encode("utf-8")
    length = len(data)
    if length < 126:
        return struct.pack("!BB", first, length) + data
    if length < 65_536:
        return struct.pack("!BBH", first, 126, length) + data
    return struct.pack("!BBQ", first, 127, length) + data
