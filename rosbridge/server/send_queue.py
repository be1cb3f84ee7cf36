"""The bounded send queue of each client, and what happens to clients that read too slowly.

Frames go to the transport in pieces, so that the transport's own buffer stays small. The frames that wait here are
shared between clients. If they exceed the bound, the oldest are dropped; a frame that was sent in part is completed.
"""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Callable, Deque, Optional, Set

_PERIOD_S = 0.02


class SendQueue:
    """The frames that wait for one client."""

    def __init__(
        self,
        transport: asyncio.WriteTransport,
        bound_bytes: int,
        on_caught_up: Callable[[], None],
        high_water: int = 65_536,
    ) -> None:
        """Starts empty.

        Args:
            transport: where frames are written.
            bound_bytes: most bytes that wait here. One larger frame may wait alone.
            on_caught_up: called when a slow client has read everything.
            high_water: frames wait here while the transport's buffer holds more bytes; also the size of the pieces.
        """
        self._transport = transport
        self._bound = bound_bytes
        self._high = high_water
        self.on_caught_up = on_caught_up
        self._frames: Deque[bytes] = deque()
        self._bytes = 0
        self._sent = 0
        self.dropped = 0
        """Frames dropped since this was last reset."""
        self.behind_since_s: Optional[float] = None
        """Start of the current backlog, in s; set by the owner."""

    @property
    def behind(self) -> bool:
        """Whether the client reads more slowly than it is sent to."""
        return bool(self._frames) or self._transport.get_write_buffer_size() > self._high

    def put(self, frame: bytes) -> bool:
        """Sends a frame or queues it; returns whether the client is behind."""
        if not self._frames and len(frame) <= self._high >= self._transport.get_write_buffer_size():
            self._transport.write(frame)
            return False
        self._frames.append(frame)
        self._bytes += len(frame)
        if len(self._frames) == 1:
            self.flush()
        self._drop_oldest()
        return self.behind

    def flush(self) -> None:
        """Writes queued frames as far as the transport takes them."""
        frames, transport, high = self._frames, self._transport, self._high
        # The buffer of a broken connection stays empty, and asyncio logs a line for each write.
        while frames and transport.get_write_buffer_size() <= high and not transport.is_closing():
            first = frames[0]
            if self._sent or len(first) > high:
                piece = first[self._sent : self._sent + high]
                self._sent += len(piece)
                if self._sent >= len(first):
                    frames.popleft()
                    self._sent = 0
            else:
                batch = []
                size = 0
                while frames and size + len(frames[0]) <= high:
                    batch.append(frames.popleft())
                    size += len(batch[-1])
                piece = b"".join(batch)
            self._bytes -= len(piece)
            transport.write(piece)

    def abort(self) -> None:
        """Closes the connection at once."""
        self._transport.abort()

    def clear(self) -> None:
        """Drops everything that waits."""
        self._frames.clear()
        self._bytes = self._sent = 0

    def _drop_oldest(self) -> None:
        while self._bytes > self._bound and len(self._frames) > 1:
            if self._sent == 0:
                self._bytes -= len(self._frames.popleft())
            elif len(self._frames) > 2:
                self._bytes -= len(self._frames[1])
                del self._frames[1]
            else:
                return  # one frame that was sent in part, and the newest
            self.dropped += 1


class SlowClients:
    """Empties the send queues of slow clients, and disconnects those that do not catch up."""

    def __init__(self, timeout_s: float, log: Callable[[str], None]) -> None:
        """Starts without clients; those that are behind for longer than `timeout_s` are disconnected."""
        self._timeout_s = timeout_s
        self._log = log
        self._queues: Set[SendQueue] = set()
        self._running = False

    def add(self, queue: SendQueue) -> None:
        """Adds a client that is behind."""
        loop = asyncio.get_event_loop()
        if queue.behind_since_s is None:
            queue.behind_since_s = loop.time()
        self._queues.add(queue)
        if not self._running:
            self._running = True
            loop.call_later(_PERIOD_S, self._flush)

    def discard(self, queue: SendQueue) -> None:
        """Removes a client that has left."""
        self._queues.discard(queue)

    def _flush(self) -> None:
        loop = asyncio.get_event_loop()
        for queue in tuple(self._queues):
            queue.flush()
            if not queue.behind:
                queue.behind_since_s = None
                self._queues.discard(queue)
                queue.on_caught_up()
            elif queue.behind_since_s is not None and loop.time() - queue.behind_since_s > self._timeout_s:
                self._queues.discard(queue)
                self._log(f"disconnected a client: behind for more than {self._timeout_s:g} s")
                queue.abort()
        self._running = bool(self._queues)
        if self._running:
            loop.call_later(_PERIOD_S, self._flush)
