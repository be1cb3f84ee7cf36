"""Runs functions that may block, so that the server's loop does not."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from typing import Any, Callable, Deque, Tuple, TypeVar

__all__ = ["BusyError", "Worker"]

_MOST_WAITING = 500

Result = TypeVar("Result")


class BusyError(Exception):
    """Too many functions are waiting, or one took too long."""


class Worker:
    """Runs functions in daemon threads, a bounded number at a time: one that hangs delays neither loop nor exit."""

    def __init__(self, most: int, timeout_s: float) -> None:
        """Starts no thread yet.

        Args:
            most: functions at a time; more wait.
            timeout_s: how long to wait for one, in s.
        """
        self._most = most
        self._timeout_s = timeout_s
        self._lock = threading.Lock()
        self._waiting: Deque[Tuple[Callable[[], Any], asyncio.Future[Any]]] = deque()
        self._threads = 0

    async def run(self, function: Callable[[], Result]) -> Result:
        """Runs a function in a thread and returns its result.

        Raises:
            BusyError: too many are waiting, or it took too long.
            Exception: what the function raised.
        """
        future: asyncio.Future[Result] = asyncio.get_event_loop().create_future()
        with self._lock:
            if len(self._waiting) >= _MOST_WAITING:
                raise BusyError("busy")
            self._waiting.append((function, future))
            starts = self._threads < self._most
            self._threads += starts
        if starts:
            threading.Thread(target=self._work, name="web", daemon=True).start()
        try:
            return await asyncio.wait_for(future, self._timeout_s)
        except asyncio.TimeoutError:
            raise BusyError(f"no answer within {self._timeout_s:g} s") from None

    def _work(self) -> None:
        """Runs what waits, until nothing does."""
        while True:
            with self._lock:
                if not self._waiting:
                    self._threads -= 1
                    return
                function, future = self._waiting.popleft()
            if not future.done():  # else it waited too long
                _run(function, future)


def _run(function: Callable[[], Result], future: asyncio.Future[Result]) -> None:
    def finish() -> None:
        if future.done():
            return
        if error is None:
            future.set_result(result)
        else:
            future.set_exception(error)

    result: Any = None
    error = None
    try:
        result = function()
    except Exception as raised:
        error = raised
    try:
        future.get_loop().call_soon_threadsafe(finish)
    except RuntimeError:
        pass  # the loop is closed: nothing waits for the result
