"""Access to the served node from the server's event loop.

A middleware with threads may block (service calls, name servers) and calls back from its threads. It is called in
worker threads, and its messages are handed over to the loop. The local middleware runs in the loop's own thread and is
called directly.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from typing import Any, Callable, Deque, Optional, Tuple, TypeVar

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.runtime.threads import ThreadPool

from .message_size import estimated_bytes

T = TypeVar("T")

_THREADS = 4
_MOST_PENDING = 1_000
_MOST_CALLS = 16
_SLICE_S = 0.005
_GRACE_S = 0.5
"""Time for the middleware itself to report that a service did not respond."""


class NodeAccess:
    """Calls the served node, and hands its messages over to the loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, *, threads: bool, queue_bytes: int = 16_000_000) -> None:
        """Prepares the access.

        Args:
            loop: the server's loop.
            threads: whether the middleware calls back from its own threads.
            queue_bytes: estimated size of the messages that may wait for the loop; beyond it, the oldest are dropped.
        """
        self._loop = loop
        self._threads = threads
        self._workers = ThreadPool("rosbridge", _THREADS, _MOST_PENDING)
        # Separate: services that do not respond must not block subscriptions.
        self._callers = ThreadPool("rosbridge-call", _MOST_CALLS, _MOST_CALLS)
        self._queue_bytes = queue_bytes
        self._lock = threading.Lock()
        self._messages: Deque[Tuple[Callable[[Any], None], Any, int]] = deque()
        self._bytes = 0
        self._waking = False
        self.dropped = 0
        """Messages that were dropped because the loop was busy."""

    async def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """Calls a method of the node, in a thread if it may block.

        Raises:
            ServiceError: too many calls are pending.
            Exception: what the method raised.
        """
        if not self._threads:
            return function(*arguments)
        return await self._workers.run(function, *arguments)

    async def call_service(self, function: Callable[..., T], *arguments: Any, timeout_s: float) -> T:
        """Calls a method of the node that waits at most `timeout_s` for a service.

        Raises:
            ServiceError: no response in time, or too many calls are pending.
            Exception: what the method raised.
        """
        if not self._threads:
            return function(*arguments)
        call = self._callers.submit(function, *arguments)
        call.add_done_callback(_retrieve)
        try:
            return await asyncio.wait_for(asyncio.shield(call), timeout_s + _GRACE_S)
        except asyncio.TimeoutError:
            raise ServiceError(f"no response within {timeout_s:g} s") from None

    def hand_over(self, function: Callable[[Any], None]) -> Callable[[Any, float], None]:
        """Returns a callback for the node's subscriptions that calls `function(value)` in the loop."""
        if not self._threads:
            return lambda value, now_s: function(value)

        def callback(value: Any, now_s: float) -> None:
            size = estimated_bytes(value)
            with self._lock:
                self._messages.append((function, value, size))
                self._bytes += size
                while self._bytes > self._queue_bytes and len(self._messages) > 1:
                    self._bytes -= self._messages.popleft()[2]
                    self.dropped += 1
                wake = not self._waking
                self._waking = True
            if wake:
                self._wake()

        return callback

    def close(self) -> None:
        """Starts nothing new; functions that are running end by themselves."""
        self._workers.close()
        self._callers.close()

    def _wake(self) -> None:
        try:
            self._loop.call_soon_threadsafe(self._deliver)
        except RuntimeError:  # the loop has ended
            with self._lock:
                self._messages.clear()
                self._bytes = 0

    def _deliver(self) -> None:
        end_s = time.monotonic() + _SLICE_S
        while True:
            message = self._next()
            if message is None:
                return
            message[0](message[1])
            if time.monotonic() > end_s:  # let other tasks of the loop run
                self._loop.call_soon(self._deliver)
                return

    def _next(self) -> Optional[Tuple[Callable[[Any], None], Any, int]]:
        with self._lock:
            if not self._messages:
                self._waking = False
                return None
            message = self._messages.popleft()
            self._bytes -= message[2]
            return message


def _retrieve(call: asyncio.Future[Any]) -> None:
    """Retrieves the exception of a call that is no longer awaited; asyncio would log it."""
    if not call.cancelled():
        call.exception()
