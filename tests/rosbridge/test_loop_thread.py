from __future__ import annotations

import asyncio
import concurrent.futures
from typing import List

import pytest

from robot_health_monitor.rosbridge.loop_thread import LoopThread


def test_coroutines_run_in_the_thread_and_their_results_and_errors_come_back() -> None:
    thread = LoopThread("test")

    async def divide(number: int) -> float:
        return 1 / number

    assert thread.call(divide(2)) == 0.5
    with pytest.raises(ZeroDivisionError):
        thread.call(divide(0))
    with pytest.raises(concurrent.futures.TimeoutError):
        thread.call(asyncio.sleep(60.0), 0.01)
    thread.close()


def test_closing_cancels_what_is_running() -> None:
    thread = LoopThread()
    events: List[str] = []
    tasks: List[asyncio.Future[None]] = []

    async def run() -> None:
        try:
            await asyncio.sleep(60.0)
        except asyncio.CancelledError:
            events.append("cancelled")
            raise

    async def start() -> None:
        events.append("started")
        tasks.append(asyncio.ensure_future(run()))
        await asyncio.sleep(0)

    thread.call(start())
    assert thread.alive
    thread.close()
    thread.close()
    assert events == ["started", "cancelled"]
    assert not thread.alive and thread.loop.is_closed()
