"""Large messages that wait to be encoded in a thread, bounded in bytes."""

from __future__ import annotations

import asyncio
from collections import deque
from typing import Callable, Deque, Generic, Optional, Sequence, Tuple, TypeVar

from robot_health_monitor.core.errors import MessageError, ServiceError
from robot_health_monitor.runtime.threads import ThreadPool

from .encoded_message import EncodedMessage, Encoding

R = TypeVar("R")


class EncodingQueue(Generic[R]):
    """The messages of one topic that wait for one encoding. The newest win."""

    def __init__(
        self,
        encoding: Encoding,
        pool: ThreadPool,
        bound_bytes: int,
        send: Callable[[bytes, Sequence[R]], None],
        on_failure: Callable[[str], None],
    ) -> None:
        """Starts empty.

        Args:
            encoding: of the messages.
            pool: runs the encoder.
            bound_bytes: estimated size of the messages that may wait; one larger message may wait alone.
            send: called in the loop with the frames of a message and its receivers.
            on_failure: called with the reason if a message cannot be encoded.
        """
        self._encoding = encoding
        self._pool = pool
        self._bound = bound_bytes
        self._send = send
        self._on_failure = on_failure
        self._waiting: Deque[Tuple[EncodedMessage, Sequence[R]]] = deque()
        self._bytes = 0
        self._running = False
        self._task: Optional[asyncio.Future[None]] = None
        self.dropped = 0
        """Messages that were dropped because the encoder is busy."""

    @property
    def busy(self) -> bool:
        """Whether messages are waiting or being encoded; later ones must wait, to keep their order."""
        return self._running

    def put(self, message: EncodedMessage, receivers: Sequence[R]) -> None:
        """Has a message encoded and sent; drops the oldest waiting ones if there are too many."""
        self._waiting.append((message, receivers))
        self._bytes += message.size
        while self._bytes > self._bound and len(self._waiting) > 1:
            self._bytes -= self._waiting.popleft()[0].size
            self.dropped += 1
        if not self._running:
            self._running = True
            self._task = asyncio.ensure_future(self._run())

    def clear(self) -> None:
        """Drops everything that waits."""
        self._waiting.clear()
        self._bytes = 0

    async def _run(self) -> None:
        try:
            while self._waiting:
                message, receivers = self._waiting.popleft()
                self._bytes -= message.size
                try:
                    frames = await self._pool.run(message.frames, self._encoding)
                except (MessageError, ServiceError) as error:
                    self._on_failure(str(error))
                else:
                    self._send(frames, receivers)
                    del frames
                del message, receivers
        finally:
            self._running = False
