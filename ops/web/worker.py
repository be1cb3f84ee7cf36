"""Runs functions that may block, so that the server's loop does not."""

from __future__ import annotations

import asyncio
import threading
from typing import Any, Callable, TypeVar

__all__ = ["BusyError", "Worker"]

Result = TypeVar("Result")


class BusyError(Exception):
    """Too many functions are running, or one took too long."""


class Worker:
    """Runs functions in daemon threads, a bounded number at a time: one that hangs delays neither loop nor exit."""

    def __init__(self, most: int, timeout_s: float) -> None:
        """Starts no thread yet.

        Args:
            most: functions at a time; more are refused.
            timeout_s: how long to wait for one, in s.
        """
        self._most = most
        self._timeout_s = timeout_s
        self._running = 0

    async def run(self, function: Callable[[], Result]) -> Result:
        """Runs a function in a thread and returns its result.

        Raises:
            BusyError: too many are running, or it took too long.
            Exception: what the function raised.
        """
        if self._running >= self._most:
            raise BusyError("busy")
        loop = asyncio.get_event_loop()
        future: asyncio.Future[Any] = loop.create_future()

        def finish(result: Any, error: Any) -> None:
            self._running -= 1
            if not future.done():
                if error is None:
                    future.set_result(result)
                else:
                    future.set_exception(error)

        def work() -> None:
            result, problem = None, None
            try:
                result = function()
            except Exception as error:
                problem = error
            try:
                loop.call_soon_threadsafe(finish, result, problem)
            except RuntimeError:
                pass  # the loop is closed: nothing waits for the result

        self._running += 1
        threading.Thread(target=work, name="web", daemon=True).start()
        try:
            done: Result = await asyncio.wait_for(future, self._timeout_s)
        except asyncio.TimeoutError:
            raise BusyError(f"no answer within {self._timeout_s:g} s") from None
        return done
