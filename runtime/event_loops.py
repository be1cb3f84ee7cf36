"""Threads for event loops: functions that block, run beside a loop, and a loop in a thread of its own.

Like all threads of `threads.py`, nothing waits for them at the end of the process. Apart from that file, because a node
of ROS without a server needs no event loop, whose modules take 2 MB.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from functools import partial
from typing import Any, Callable, Coroutine, TypeVar

from ..core.values import ServiceError
from .threads import DaemonThreads

Result = TypeVar("Result")
_CLOSE_TIMEOUT_S = 5.0


async def run_in_daemon_thread(function: Callable[[], Result]) -> Result:
    """Returns or raises what a function does in a separate thread. Cancelling the wait abandons the thread."""
    pool = ThreadPool("may hang", threads=1, most_pending=1)
    try:
        return await pool.run(function)
    finally:
        pool.close()


class ThreadPool:
    """A bounded number of threads that run functions for an event loop."""

    def __init__(self, name: str, threads: int, most_pending: int, timeout_s: float | None = None) -> None:
        """Starts no thread. At most `most_pending` functions run or wait; `run` waits `timeout_s`, or for ever."""
        self._threads = DaemonThreads(name, threads)
        self._most_pending = most_pending
        self._timeout_s = timeout_s
        self.pending = 0
        """Functions that run or wait."""

    def submit(self, function: Callable[..., Result], *arguments: Any) -> asyncio.Future[Result]:
        """Runs a function in a thread, unless the future is cancelled before. Called in the loop. Raises as `run`."""
        if self.pending >= self._most_pending:
            raise ServiceError(f"busy: {self.pending} requests are pending")
        self.pending += 1
        future: asyncio.Future[Result] = asyncio.get_event_loop().create_future()
        self._threads.run(partial(self._work, future, function, arguments), self.pending)
        return future

    async def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Returns or raises what a function does in a thread.

        Raises ServiceError if too many are pending, or if it took too long.
        """
        future = self.submit(function, *arguments)
        if self._timeout_s is None:
            return await future
        try:
            return await asyncio.wait_for(future, self._timeout_s)
        except asyncio.TimeoutError:
            raise ServiceError(f"no answer within {self._timeout_s:g} s") from None

    def close(self) -> None:
        """Ends the threads after their current function. Nothing may be submitted afterwards."""
        self._most_pending = 0
        self._threads.close()

    def _work(self, future: asyncio.Future[Any], function: Callable[..., object], arguments: Any) -> None:
        result, error = None, None
        try:
            result = None if future.cancelled() else function(*arguments)
        except Exception as raised:
            error = raised
        with contextlib.suppress(RuntimeError):  # the loop has ended
            future.get_loop().call_soon_threadsafe(self._finish, future, result, error)

    def _finish(self, future: asyncio.Future[Any], result: Any, error: Any) -> None:
        self.pending -= 1
        if future.done():  # cancelled
            return
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)


class LoopThread:
    """A running event loop: for a server beside ROS, and for clients that are used from blocking code."""

    def __init__(self, name: str = "rosbridge") -> None:
        """Starts the thread. It does not keep the process alive."""
        self.loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the loop is running."""
        return self._thread.is_alive()

    def call(self, coroutine: Coroutine[Any, Any, Result], timeout_s: float = 30.0) -> Result:
        """Returns or raises what a coroutine does, or concurrent.futures.TimeoutError. Not to be called in the loop."""
        return asyncio.run_coroutine_threadsafe(coroutine, self.loop).result(timeout_s)

    def close(self) -> None:
        """Stops the loop and cancels its tasks. May be called twice."""
        if self._thread.is_alive():
            self.loop.call_soon_threadsafe(self.loop.stop)
            self._thread.join(_CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_forever()
            tasks = asyncio.all_tasks(self.loop)
            for task in tasks:
                task.cancel()
            self.loop.run_until_complete(asyncio.gather(*tasks, return_exceptions=True))
            self.loop.run_until_complete(self.loop.shutdown_asyncgens())
        finally:
            self.loop.close()
