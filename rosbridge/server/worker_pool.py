"""Runs blocking or long functions in threads, for an event loop."""

from __future__ import annotations

import asyncio
import queue
import threading
from typing import Any, Callable, Tuple, TypeVar

from robot_health_monitor.core.errors import ServiceError

__all__ = ["WorkerPool"]

T = TypeVar("T")
_Job = Tuple["asyncio.Future[Any]", Callable[..., Any], Tuple[Any, ...]]


class WorkerPool:
    """A fixed number of threads.

    Unlike the threads of `concurrent.futures`, these do not delay the end of the process if a function never returns.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, name: str, threads: int, most_pending: int) -> None:
        """Starts no thread yet.

        Args:
            loop: the loop that awaits the results.
            name: of the threads.
            threads: most threads.
            most_pending: most functions that run or wait.
        """
        self._loop = loop
        self._name = name
        self._most_threads = threads
        self._most_pending = most_pending
        self._threads = 0
        self._jobs: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.pending = 0
        """Functions that run or wait."""

    def submit(self, function: Callable[..., T], *arguments: Any) -> asyncio.Future[T]:
        """Runs `function(*arguments)` in a thread. Called in the loop.

        Raises:
            ServiceError: too many functions are pending.
        """
        if self.pending >= self._most_pending:
            raise ServiceError(f"busy: {self.pending} requests are pending")
        self.pending += 1
        if self._threads < min(self.pending, self._most_threads):
            self._threads += 1
            threading.Thread(target=self._work, name=self._name, daemon=True).start()
        future: asyncio.Future[T] = self._loop.create_future()
        self._jobs.put((future, function, arguments))
        return future

    async def run(self, function: Callable[..., T], *arguments: Any) -> T:
        """Runs `function(*arguments)` in a thread and returns its result.

        Raises:
            ServiceError: too many functions are pending.
            Exception: what the function raised.
        """
        return await self.submit(function, *arguments)

    def close(self) -> None:
        """Ends the threads after their current function. Nothing may be submitted afterwards."""
        self._most_pending = 0
        for _ in range(self._threads):
            self._jobs.put(None)

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            if job is None:
                return
            future, function, arguments = job
            result, error = None, None
            try:
                result = function(*arguments)
            except Exception as raised:
                error = raised
            try:
                self._loop.call_soon_threadsafe(self._finish, future, result, error)
            except RuntimeError:  # the loop has ended
                return
            del job, future, function, arguments, result, error  # they may be large, and the next job may be far away

    def _finish(self, future: asyncio.Future[Any], result: Any, error: Any) -> None:
        self.pending -= 1
        if future.done():  # cancelled
            return
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)
