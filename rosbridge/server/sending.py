"""Messages on their way to clients: encoded once for all of them, then in a bounded send queue for each.

Large messages are encoded in a thread. Frames go to the transport in pieces, so that the transport's own buffer stays
small. The frames that wait here are shared between clients. If they exceed the bound, the oldest are dropped; a frame
that was sent in part is completed. A client that stays behind is disconnected.
"""

from __future__ import annotations

import asyncio
import struct
import time

from ...core.values import Message, MessageError
from ...runtime.bounded_queue import BoundedQueue
from ..protocol import Wire, encode
from ..protocol.definitions import Serializer

LARGE_BYTES = 65_536
"""Messages above this size are encoded and decoded in a background thread."""

HIGH_WATER = 65_536
"""Bytes in the buffer of a transport from which on frames wait."""

_FINAL_TEXT, _FINAL_BINARY = 0x81, 0x82
_OBJECT_BYTES = 32
_COUNTED_ITEMS = 16


def frame(message: Wire) -> bytes:
    """Returns one frame of a server (RFC 6455, section 5.2): unmasked, so the same bytes go to every client."""
    first = _FINAL_BINARY if isinstance(message, bytes) else _FINAL_TEXT
    data = message if isinstance(message, bytes) else message.encode("utf-8")
    length = len(data)
    if length < 126:
        return struct.pack("!BB", first, length) + data
    if length < 65_536:
        return struct.pack("!BBH", first, 126, length) + data
    return struct.pack("!BBQ", first, 127, length) + data


def estimated_bytes(value: object) -> int:
    """Returns about how many bytes a value occupies, in time that does not depend on the length of its arrays.

    The elements of a ROS array have one type, so a long array is estimated from three of them.
    """
    if isinstance(value, (str, bytes, bytearray)):
        return 2 * _OBJECT_BYTES + len(value)
    if isinstance(value, dict):
        return 4 * _OBJECT_BYTES + sum(_OBJECT_BYTES + estimated_bytes(item) for item in value.values())
    if isinstance(value, (list, tuple)):
        count = len(value)
        if count <= _COUNTED_ITEMS:
            return 2 * _OBJECT_BYTES + sum(map(estimated_bytes, value))
        sample = (value[0], value[count // 2], value[-1])
        return 2 * _OBJECT_BYTES + count * max(map(estimated_bytes, sample))
    return _OBJECT_BYTES


def wall_stamp() -> dict[str, int]:
    """Returns the present time as a stamp of ROS 1."""
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    return {"secs": seconds, "nsecs": nanoseconds}


def publication(
    topic: str,
    content: Message | bytes,
    compression: str,
    serialize: Serializer | None = None,
    *,
    is_large: bool = False,
) -> bytes:
    """Returns the WebSocket frame of a message or of its raw bytes, by one of COMPRESSIONS.

    `serialize` makes raw bytes of a message, unless it is None. Raises MessageError if it cannot be encoded so.
    """
    if compression == "cbor-raw":
        if not isinstance(content, bytes):
            if serialize is None:
                raise MessageError("cannot be sent as cbor-raw: the definition of its type is not known")
            content = serialize(content)
        content = {**wall_stamp(), "bytes": content}
    return frame(encode({"op": "publish", "topic": topic, "msg": content}, compression, is_large=is_large))


class ClientQueue:
    """The frames that wait for one client."""

    def __init__(self, transport: asyncio.WriteTransport, bound_bytes: int) -> None:
        """Starts empty. At most `bound_bytes` wait here; one larger frame may wait alone.

        Frames wait while the transport's buffer holds more than `HIGH_WATER` bytes; not more are written at once. The
        owner calls `flush` when the transport resumes writing.
        """
        self._transport = transport
        transport.set_write_buffer_limits(HIGH_WATER)
        self._frames: BoundedQueue[bytes] = BoundedQueue(bound_bytes)
        self._rest = memoryview(b"")
        """What is left of the frame that is being sent."""

    @property
    def dropped(self) -> int:
        """Frames dropped so far."""
        return self._frames.dropped

    @property
    def behind(self) -> bool:
        """Whether the client reads more slowly than it is sent to."""
        return bool(self._frames or self._rest) or self._transport.get_write_buffer_size() > HIGH_WATER

    def put(self, frame: bytes) -> bool:
        """Sends a frame or queues it; returns whether the client is behind."""
        if not (self._frames or self._rest) and len(frame) <= HIGH_WATER >= self._transport.get_write_buffer_size():
            self._transport.write(frame)
            return False
        self._frames.put(frame, len(frame))
        if len(self._frames) == 1:
            self.flush()
        return self.behind

    def flush(self) -> None:
        """Writes queued frames as far as the transport takes them."""
        transport = self._transport
        # The buffer of a broken connection stays empty, and asyncio logs a line for each write.
        while transport.get_write_buffer_size() <= HIGH_WATER and not transport.is_closing():
            if not self._rest:
                if not self._frames:
                    return
                self._rest = memoryview(self._frames.pop())
            piece, self._rest = self._rest[:HIGH_WATER], self._rest[HIGH_WATER:]
            transport.write(piece)

    def clear(self) -> None:
        """Drops everything that waits."""
        self._frames.clear()
        self._rest = memoryview(b"")
