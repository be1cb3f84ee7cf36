"""Functions that block, beside an event loop."""

from __future__ import annotations

import asyncio
import threading
from typing import List

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
        late: List[str] = []
        with pytest.raises(BusyError):
            await worker.run(lambda: late.append("no place"))
        worker._timeout_s = 30.0
        waiting = asyncio.ensure_future(worker.run(lambda: "waited"))
        await asyncio.sleep(0)
        release.set()
        assert await waiting == "waited"
        assert late == []  # its request has been answered
        while worker._threads:
            await asyncio.sleep(0.01)
        assert await worker.run(lambda: "again") == "again"

    asyncio.run(run())


def test_more_functions_than_threads_wait_and_too_many_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.ops.web.worker._MOST_WAITING", 50)
    lock = threading.Lock()
    running: List[int] = [0, 0]

    def work() -> int:
        with lock:
            running[0] += 1
            running[1] = max(running)
        with lock:
            running[0] -= 1
        return threading.get_ident()

    async def run() -> None:
        worker = Worker(4, 30.0)
        threads = await asyncio.gather(*(worker.run(work) for _ in range(50)))
        assert len(set(threads)) <= 50 and running[1] <= 4
        release = threading.Event()
        held = [asyncio.ensure_future(worker.run(release.wait)) for _ in range(54)]
        await asyncio.sleep(0)
        while len(worker._waiting) < 50:
            await asyncio.sleep(0.01)
        with pytest.raises(BusyError, match="busy"):
            await worker.run(work)
        release.set()
        await asyncio.gather(*held)

    asyncio.run(run())
