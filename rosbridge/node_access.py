"""How the server reaches the node that it serves, from an event loop.

A middleware with threads of its own may block (a service call, a name server) and calls back from its threads: it is
called in threads, and what it delivers is handed over to the loop, many messages at a time when they come fast. The
in-process middleware lives in the loop's own thread: it is called directly.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
from collections import deque
from typing import Any, Callable, Deque, Optional, Tuple, TypeVar

T = TypeVar("T")


class NodeAccess:
    """Calls the served node, and hands its deliveries to the loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, *, threads: bool) -> None:
        """Prepares to serve from `loop`.

        Args:
            loop: the server's loop.
            threads: whether the middleware has threads of its own.
        """
        self._loop = loop
        self._executor: Optional[concurrent.futures.ThreadPoolExecutor] = None
        if threads:
            self._executor = concurrent.futures.ThreadPoolExecutor(8, "rosbridge")
        self._deliveries: Deque[Tuple[Callable[[Any], None], Any]] = deque()
        self._waking = False

    async def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """Calls a method of the node; in a thread where it may block."""
        if self._executor is None:
            return function(*arguments)
        return await self._loop.run_in_executor(self._executor, lambda: function(*arguments))

    def hand_over(self, function: Callable[[Any], None]) -> Callable[[Any, float], None]:
        """Returns a callback for the node's subscriptions that has `function(value)` called in the loop."""
        if self._executor is None:
            return lambda value, now_s: function(value)

        def callback(value: Any, now_s: float) -> None:
            self._deliveries.append((function, value))
            if not self._waking:
                self._waking = True
                self._wake()

        return callback

    def close(self) -> None:
        """Starts nothing new; calls that have begun end by themselves."""
        if self._executor is not None:
            self._executor.shutdown(wait=False)

    def _wake(self) -> None:
        try:
            self._loop.call_soon_threadsafe(self._deliver)
        except RuntimeError:  # the loop has ended: the server has been closed
            self._deliveries.clear()

    def _deliver(self) -> None:
        # Cleared first: a message that is appended meanwhile wakes the loop again, at worst for nothing.
        self._waking = False
        while self._deliveries:
            function, value = self._deliveries.popleft()
            function(value)
