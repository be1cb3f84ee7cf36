"""Runs what may hang in a thread that nothing waits for at the end of the process.

The threads of `loop.run_in_executor` are joined when the loop and the process end: a look-up of a host name that hangs
would delay the exit by half a minute, and a folder on a server that does not answer by hours.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import Callable, TypeVar

__all__ = ["run_in_daemon_thread"]

_Result = TypeVar("_Result")


async def run_in_daemon_thread(function: Callable[[], _Result]) -> _Result:
    """Returns the result of a function that is called in a separate thread.

    Cancelling the wait abandons the thread.

    Raises:
        Exception: what the function raised.
    """
    loop = asyncio.get_event_loop()
    done: asyncio.Future[_Result] = loop.create_future()

    def settle(result: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(lambda: None if done.done() else result())

    def run() -> None:
        try:
            value = function()
        except Exception as error:
            failure = error
            settle(lambda: done.set_exception(failure))
        else:
            settle(lambda: done.set_result(value))

    threading.Thread(target=run, name="may hang", daemon=True).start()
    return await done
