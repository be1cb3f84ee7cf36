"""What waits for a client that reads more slowly than it is sent to: bounded, and nobody else's problem.

A frame goes straight to the transport as long as the transport's own buffer is short. Otherwise it waits here, at most
`bytes_bound` of it; when that is full the client's own oldest frames are dropped. The frames are shared between
clients, so what waits costs little more than references.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Deque, Optional


class Outbox:
    """The frames of one client, on their way to its transport."""

    __slots__ = ("_bound", "_bytes", "_frames", "_high", "_transport", "behind_since_s", "dropped")

    def __init__(self, transport: asyncio.WriteTransport, bytes_bound: int, high_water: int = 65_536) -> None:
        """Starts empty.

        Args:
            transport: where frames go.
            bytes_bound: most bytes that wait here.
            high_water: with more than this in the transport's own buffer, in bytes, frames wait here.
        """
        self._transport = transport
        self._bound = bytes_bound
        self._high = high_water
        self._frames: Deque[bytes] = deque()
        self._bytes = 0
        self.dropped = 0
        """How many frames were dropped since somebody last set this to 0."""
        self.behind_since_s: Optional[float] = None
        """Since when the client has been behind; kept by whoever calls `flush`."""

    @property
    def behind(self) -> bool:
        """Whether frames wait here, or would: the client does not read as fast as it is sent to."""
        return bool(self._frames) or self._transport.get_write_buffer_size() > self._high

    def put(self, frame: bytes) -> bool:
        """Sends a frame, or lets it wait; returns whether the client is behind."""
        transport = self._transport
        if not self._frames and transport.get_write_buffer_size() <= self._high:
            transport.write(frame)
            return False
        self._frames.append(frame)
        self._bytes += len(frame)
        while self._bytes > self._bound:
            self._bytes -= len(self._frames.popleft())
            self.dropped += 1
        return True

    def flush(self) -> None:
        """Hands waiting frames to the transport as far as it takes them."""
        frames, transport = self._frames, self._transport
        while frames and transport.get_write_buffer_size() <= self._high:
            batch = []
            size = 0
            while frames and size <= self._high:
                frame = frames.popleft()
                batch.append(frame)
                size += len(frame)
            self._bytes -= size
            transport.write(b"".join(batch))
