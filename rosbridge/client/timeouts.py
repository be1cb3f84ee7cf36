"""Work that must end in time."""

from __future__ import annotations

import asyncio
from typing import Any, Coroutine, TypeVar

_Result = TypeVar("_Result")


async def within(timeout_s: float, work: Coroutine[Any, Any, _Result]) -> _Result:
    """Does what `asyncio.wait_for` does, which can lose a cancellation before Python 3.12: its caller would never end.

    Raises:
        asyncio.TimeoutError: the work took longer than `timeout_s`.
    """
    task = asyncio.ensure_future(work)
    try:
        await asyncio.wait({task}, timeout=timeout_s)
        if not task.done():
            raise asyncio.TimeoutError
        return task.result()
    finally:
        task.cancel()
        task.add_done_callback(ignore_result)


def ignore_result(task: asyncio.Future[Any]) -> None:
    """Reads the result of a task, so that asyncio does not complain about an unread exception."""
    if not task.cancelled():
        task.exception()
