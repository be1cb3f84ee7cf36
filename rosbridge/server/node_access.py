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

_THREADS = 4
_MOST_CALLS = 16
"""Service calls at the same time; a service that never answers keeps its thread."""


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
            self._executor = concurrent.futures.ThreadPoolExecutor(_THREADS, "rosbridge")
            # Of their own: services that hang must not keep anybody from subscribing.
            self._call_executor = concurrent.futures.ThreadPoolExecutor(_MOST_CALLS, "rosbridge-call")
        self._calls = 0
        self._deliveries: Deque[Tuple[Callable[[Any], None], Any]] = deque()
        self._waking = False

    async def call(self, function: Callable[..., T], *arguments: Any) -> T:
        """Calls a method of the node; in a thread where it may block."""
        if self._executor is None:
            return function(*arguments)
        return await self._loop.run_in_executor(self._executor, lambda: function(*arguments))

    async def call_service(self, function: Callable[..., T], *arguments: Any, timeout_s: float) -> T:
        """Calls a method of the node that waits for a service.

        Raises:
            ValueError: it took longer than `timeout_s`, or too many others are being waited for.
        """
        if self._executor is None:
            return function(*arguments)
        if self._calls >= _MOST_CALLS:
            raise ValueError(f"{_MOST_CALLS} other service calls wait for their answer")
        self._calls += 1
        call = self._loop.run_in_executor(self._call_executor, lambda: function(*arguments))
        call.add_done_callback(self._end_call)
        try:
            return await asyncio.wait_for(asyncio.shield(call), timeout_s)
        except asyncio.TimeoutError:
            raise ValueError(f"no answer within {timeout_s:g} s") from None

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
            self._call_executor.shutdown(wait=False)

    def _end_call(self, call: asyncio.Future[Any]) -> None:
        self._calls -= 1
        if not call.cancelled():
            call.exception()  # looked at here for those that nobody waits for any more

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
