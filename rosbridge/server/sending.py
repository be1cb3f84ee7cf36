"""Messages on their way to clients: encoded once for all of them, then in a bounded send queue for each.

Large messages are encoded in a thread. Frames go to the transport in pieces, so that the transport's own buffer stays
small. The frames that wait here are shared between clients. If they exceed the bound, the oldest are dropped; a frame
that was sent in part is completed. A client that stays behind is disconnected.
"""

from __future__ import annotations

import asyncio
import struct
import time
from typing import Any, Callable, Dict, NamedTuple, Optional, Sequence, Tuple, Union

from ...core.messages.dialect import Message
from ...core.values.errors import MessageError, ServiceError
from ...runtime.bounded_queue import BoundedQueue
from ...runtime.event_loops import ThreadPool
from ..protocol import Wire
from ..protocol.codec import encode_json, encode_large_json
from ..protocol.connection import encode_fields
from ..protocol.definitions import Serializer

LARGE_BYTES = 65_536
"""Messages above this size are encoded and decoded in a background thread."""

_FINAL_TEXT, _FINAL_BINARY = 0x81, 0x82
_OBJECT_BYTES = 32
_COUNTED_ITEMS = 16

Receivers = Sequence[Any]


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


class Encoding(NamedTuple):
    """What the bytes that are sent to a client depend on."""

    compression: str = "none"
    fragment_size: Optional[int] = None
    """In characters; None: no fragments."""


class EncodedMessage:
    """A message, and the frames that were made of it."""

    def __init__(self, topic: str, content: Union[Message, bytes], serialize: Optional[Serializer] = None) -> None:
        """Takes a message or only its raw bytes; `serialize` makes raw bytes of a message, unless it is None."""
        self.size = estimated_bytes(content)
        """Estimated memory in bytes."""
        self.is_large = self.size > LARGE_BYTES
        """Whether encoding takes so long that a thread should do it."""
        self._topic = topic
        self._content = content
        self._serialize = serialize
        self._frames: Dict[Encoding, bytes] = {}

    def frames(self, encoding: Encoding) -> bytes:
        """Returns the WebSocket frames: one, or one per fragment; raises MessageError if it cannot be encoded so."""
        frames = self._frames.get(encoding)
        if frames is None:
            encode = encode_large_json if self.is_large else encode_json
            message: Any = self._content
            if encoding.compression == "cbor-raw":
                seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
                message = {"secs": seconds, "nsecs": nanoseconds, "bytes": self._raw()}
            wires = encode_fields({"op": "publish", "topic": self._topic, "msg": message}, encode, *encoding)
            frames = self._frames[encoding] = b"".join(map(frame, wires))
        return frames

    def _raw(self) -> bytes:
        if isinstance(self._content, bytes):
            return self._content
        if self._serialize is None:
            raise MessageError("cannot be sent as cbor-raw: the definition of its type is not known")
        return self._serialize(self._content)


class EncodingQueue:
    """The messages of one topic in one encoding: large ones wait for a thread, bounded in bytes. The newest win."""

    def __init__(
        self,
        encoding: Encoding,
        pool: ThreadPool,
        bound_bytes: int,
        send: Callable[[bytes, Receivers], None],
        on_failure: Callable[[str], None],
    ) -> None:
        """Starts empty.

        `send` is called in the loop with the frames of a message and its receivers, `on_failure` with the reason if it
        cannot be encoded. `bound_bytes` bounds the estimated size of those that wait; one larger may wait alone.
        """
        self._encoding = encoding
        self._pool = pool
        self._send = send
        self._on_failure = on_failure
        self._waiting: BoundedQueue[Tuple[EncodedMessage, Receivers]] = BoundedQueue(bound_bytes)
        self.busy = False
        """Whether messages are waiting or being encoded; later ones must wait, to keep their order."""
        self.clear = self._waiting.clear
        """Drops everything that waits."""

    @property
    def dropped(self) -> int:
        """Messages that were dropped because the encoder is busy."""
        return self._waiting.dropped

    def put(self, message: EncodedMessage, receivers: Receivers) -> None:
        """Sends a small message at once, has others encoded; drops the oldest that wait if there are too many."""
        if not self.busy and not message.is_large:
            try:
                self._send(message.frames(self._encoding), receivers)
            except MessageError as error:
                self._on_failure(str(error))
            return
        self._waiting.put((message, receivers), message.size)
        if not self.busy:
            self.busy = True
            self._task = asyncio.ensure_future(self._run())

    async def _run(self) -> None:
        try:
            while self._waiting:
                message, receivers = self._waiting.pop()
                try:
                    frames = await self._pool.run(message.frames, self._encoding)
                except (MessageError, ServiceError) as error:
                    self._on_failure(str(error))
                else:
                    self._send(frames, receivers)
                    del frames
                del message, receivers
        finally:
            self.busy = False


class ClientQueue:
    """The frames that wait for one client."""

    def __init__(
        self,
        transport: asyncio.WriteTransport,
        bound_bytes: int,
        high_water: int = 65_536,
    ) -> None:
        """Starts empty. At most `bound_bytes` wait here; one larger frame may wait alone.

        Frames wait while the transport's buffer holds more than `high_water` bytes; not more are written at once. The
        owner calls `flush` when the transport resumes writing.
        """
        self._transport = transport
        self._high = high_water
        transport.set_write_buffer_limits(high_water)
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
        return bool(self._frames or self._rest) or self._transport.get_write_buffer_size() > self._high

    def put(self, frame: bytes) -> bool:
        """Sends a frame or queues it; returns whether the client is behind."""
        if not (self._frames or self._rest) and len(frame) <= self._high >= self._transport.get_write_buffer_size():
            self._transport.write(frame)
            return False
        self._frames.put(frame, len(frame))
        if len(self._frames) == 1:
            self.flush()
        return self.behind

    def flush(self) -> None:
        """Writes queued frames as far as the transport takes them."""
        transport, high = self._transport, self._high
        # The buffer of a broken connection stays empty, and asyncio logs a line for each write.
        while transport.get_write_buffer_size() <= high and not transport.is_closing():
            if not self._rest:
                if not self._frames:
                    return
                self._rest = memoryview(self._frames.pop())
            piece, self._rest = self._rest[:high], self._rest[high:]
            transport.write(piece)

    def clear(self) -> None:
        """Drops everything that waits."""
        self._frames.clear()
        self._rest = memoryview(b"")
