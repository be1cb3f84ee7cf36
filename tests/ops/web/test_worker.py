"""Functions that block, beside an event loop."""

from __future__ import annotations

import asyncio
import threading

import pytest

from robot_health_monitor.ops.web.worker import BusyError, Worker


def test_it_returns_the_result_and_raises_the_error() -> None:
    async def run() -> None:
        worker = Worker(1, 10.0)
        assert await worker.run(lambda: threading.current_thread().daemon) is True
        with pytest.raises(ZeroDivisionError):
            await worker.run(lambda: 1 / 0)
        assert await worker.run(lambda: 2) == 2

    asyncio.run(run())


def test_a_function_that_hangs_is_given_up_and_blocks_only_its_place() -> None:
    async def run() -> None:
        release = threading.Event()
        worker = Worker(2, 0.05)
        with pytest.raises(BusyError, match=r"no answer within 0\.05 s"):
            await worker.run(release.wait)
        worker._timeout_s = 30.0
        assert await worker.run(lambda: "next") == "next"
        worker._timeout_s = 0.05
        with pytest.raises(BusyError):
            await worker.run(release.wait)
        worker._timeout_s = 30.0
        with pytest.raises(BusyError, match="busy"):
            await worker.run(lambda: "no place")
        release.set()
        while worker._running:
            await asyncio.sleep(0.01)
        assert await worker.run(lambda: "again") == "again"

    asyncio.run(run())
