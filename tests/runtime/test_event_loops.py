"""Functions that block, run beside an event loop, and a loop in a thread."""

from __future__ import annotations

import asyncio
import concurrent.futures
import gc
import subprocess
import sys
import threading
import weakref
from pathlib import Path

import pytest
from harness.waiting import wait_for

from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.runtime.event_loops import LoopThread, ThreadPool, run_in_daemon_thread

ROOT = str(Path(__file__).resolve().parents[2])


def test_the_result_and_the_exception_arrive() -> None:
    async def run() -> None:
        assert await run_in_daemon_thread(lambda: threading.current_thread().daemon) is True
        with pytest.raises(ZeroDivisionError):
            await run_in_daemon_thread(lambda: 1 // 0)

    asyncio.run(run())


def test_a_cancelled_wait_ignores_the_result() -> None:
    async def run() -> None:
        release = threading.Event()
        task = asyncio.ensure_future(run_in_daemon_thread(release.wait))
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.wait({task})
        assert task.cancelled()
        release.set()
        assert await run_in_daemon_thread(lambda: 1) == 1

    asyncio.run(run())


def test_a_function_that_hangs_does_not_delay_the_exit() -> None:
    program = (
        "import asyncio, threading\n"
        "from robot_health_monitor.runtime.event_loops import run_in_daemon_thread\n"
        "async def run():\n"
        "    await asyncio.wait({asyncio.ensure_future(run_in_daemon_thread(threading.Event().wait))}, timeout=0.01)\n"
        "asyncio.run(run())\n"
        "print('ended')\n"
    )
    ended = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (ended.stdout, ended.stderr) == ("ended\n", "")


def test_functions_run_in_threads_and_their_results_and_errors_come_back() -> None:
    async def scenario() -> None:
        pool = ThreadPool("worker", 2, 10)
        assert await pool.run(threading.get_ident) != threading.get_ident()
        assert await pool.run(lambda a, b: a + b, 1, 2) == 3
        with pytest.raises(ZeroDivisionError):
            await pool.run(lambda: 1 // 0)
        assert pool.pending == 0
        pool.close()

    asyncio.run(scenario())


def test_threads_and_pending_functions_are_bounded() -> None:
    async def scenario() -> None:
        released = threading.Event()
        pool = ThreadPool("bounded-worker", 2, 5)
        futures = [pool.submit(released.wait, 20.0) for _ in range(5)]
        assert sum(thread.name == "bounded-worker" for thread in threading.enumerate()) == 2
        with pytest.raises(ServiceError, match="busy: 5 requests are pending"):
            pool.submit(released.wait)
        futures[0].cancel()
        released.set()
        assert await asyncio.gather(*futures[1:]) == [True] * 4
        pool.close()

    asyncio.run(scenario())


def test_a_function_that_never_returns_does_not_delay_the_end() -> None:
    async def scenario() -> None:
        pool = ThreadPool("hanging-worker", 1, 5)
        pool.submit(threading.Event().wait)
        await asyncio.sleep(0)
        pool.close()

    asyncio.run(scenario())
    (thread,) = [thread for thread in threading.enumerate() if thread.name == "hanging-worker"]
    assert thread.daemon


def test_a_result_is_not_kept() -> None:
    class Large:
        pass

    async def scenario() -> None:
        pool = ThreadPool("worker", 1, 5)
        result = weakref.ref(await pool.run(Large))
        await pool.run(lambda: None)
        await asyncio.sleep(0)
        gc.collect()
        assert result() is None
        pool.close()

    asyncio.run(scenario())


def test_a_function_that_hangs_is_given_up_and_blocks_only_its_place() -> None:
    async def scenario() -> None:
        release = threading.Event()
        begun: list[int] = []

        def hang() -> None:
            begun.append(1)
            release.wait()

        pool = ThreadPool("worker", 2, 10, timeout_s=0.05)
        with pytest.raises(ServiceError, match=r"no answer within 0\.05 s"):
            await pool.run(hang)  # which has not begun yet on a busy machine
        assert await pool.submit(lambda: "next") == "next"
        for _ in range(2):
            pool.submit(hang)
        wait_for(lambda: len(begun) == 2)
        late: list[str] = []
        with pytest.raises(ServiceError):
            await pool.run(lambda: late.append("no place"))
        waiting = pool.submit(lambda: "waited")
        release.set()
        assert await waiting == "waited"
        assert late == []  # its request has been answered
        pool.close()

    asyncio.run(scenario())


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
    events: list[str] = []
    tasks: list[asyncio.Future[None]] = []

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
