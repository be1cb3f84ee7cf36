"""Threads that hang delay neither the loop nor the end of the process."""

from __future__ import annotations

import asyncio
import concurrent.futures
import gc
import os
import subprocess
import sys
import threading
import weakref
from pathlib import Path
from queue import Queue
from typing import List, Optional

import pytest

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.sensors.source import SensorError
from robot_health_monitor.runtime.threads import (
    DetachedCalls,
    LoopThread,
    MonotonicEvent,
    StepThread,
    ThreadPool,
    run_in_daemon_thread,
)

ROOT = str(Path(__file__).resolve().parents[2])


def test_the_result_and_the_exception_arrive() -> None:
    async def run() -> None:
        assert await run_in_daemon_thread(lambda: threading.current_thread().daemon) is True
        with pytest.raises(ZeroDivisionError):
            await run_in_daemon_thread(lambda: 1 // 0)

    asyncio.run(run())


def test_a_detached_call_that_hangs_keeps_its_thread_and_others_share_one() -> None:
    calls = DetachedCalls("test", most_threads=2, patience_s=30.0)
    names: List[int] = []
    for _ in range(3):
        assert calls(lambda: names.append(threading.get_ident()))
    assert len(set(names)) == 1
    hangs, patient = threading.Event(), calls._patience_s
    calls._patience_s = 0.0
    assert not calls(lambda: assert_set(hangs))
    calls._patience_s = patient
    assert calls(lambda: names.append(threading.get_ident()))
    assert len(set(names)) == 2
    calls._patience_s = 0.0
    other = threading.Event()
    assert not calls(lambda: assert_set(other))
    with pytest.raises(SensorError, match=r"^2 sources do not answer: no thread is left$"):
        calls(lambda: None)
    hangs.set()
    other.set()
    calls.close()


def assert_set(event: threading.Event) -> None:
    assert event.wait(30.0)


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
        "from robot_health_monitor.runtime.threads import run_in_daemon_thread\n"
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
        pool = ThreadPool("worker", 2, 10, timeout_s=0.05)
        with pytest.raises(ServiceError, match=r"no answer within 0\.05 s"):
            await pool.run(release.wait)
        assert await pool.submit(lambda: "next") == "next"
        with pytest.raises(ServiceError):
            await pool.run(release.wait)
        late: List[str] = []
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


DEADLINE_S = 30.0
FOREVER_S = 3600.0


def test_a_step_is_repeated_after_the_wait_that_it_returns_or_when_woken() -> None:
    steps: Queue[int] = Queue()
    waits = iter([0.0, 0.0, FOREVER_S, FOREVER_S])

    def step() -> float:
        steps.put(1)
        return next(waits)

    thread = StepThread("test", step, lambda error: None)
    thread.start()
    for _ in range(3):
        steps.get(timeout=DEADLINE_S)
    thread.wake()
    steps.get(timeout=DEADLINE_S)
    thread.close()
    thread.join(DEADLINE_S)
    assert steps.empty()


def test_an_exception_is_reported_and_the_thread_goes_on() -> None:
    errors: List[Exception] = []
    went_on = threading.Event()

    def step() -> float:
        if not errors:
            raise ValueError("broken")
        went_on.set()
        return FOREVER_S

    thread = StepThread("test", step, lambda error: (errors.append(error), thread.wake()))
    thread.start()
    assert went_on.wait(DEADLINE_S)
    thread.close()
    thread.join(DEADLINE_S)
    assert [str(error) for error in errors] == ["broken"]


def test_a_thread_that_is_closed_before_its_first_step_makes_none() -> None:
    steps: List[int] = []
    thread = StepThread("test", lambda: steps.append(1) or FOREVER_S, lambda error: None)
    thread.close()
    thread.start()
    thread.join(DEADLINE_S)
    assert steps == []


def test_a_thread_that_has_ended_holds_no_descriptors() -> None:
    before = len(os.listdir("/proc/self/fd"))
    threads = [StepThread("test", lambda: FOREVER_S, lambda error: None) for _ in range(20)]
    for thread in threads:
        thread.start()
    assert len(os.listdir("/proc/self/fd")) >= before + 40
    for thread in threads:
        thread.close()
        thread.join(DEADLINE_S)
        thread.wake()
        thread.close()
    assert len(os.listdir("/proc/self/fd")) <= before + 20


def test_an_event_ends_a_wait_from_another_thread_and_can_be_used_again() -> None:
    event = MonotonicEvent()
    assert not event.wait(0.0)
    assert not event.wait(-1.0)
    for _ in range(3):
        thread = threading.Thread(target=event.set)
        thread.start()
        assert event.wait(float("inf"))
        thread.join()
        assert event.is_set()
        event.set()
        assert event.wait(0.0)
        event.clear()
        event.clear()
        assert not event.is_set()
        assert not event.wait(0.001)


def test_a_thread_waits_by_the_monotonic_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """On Python 3.8, a clock that is set back lengthens every timed wait of `threading`."""
    steps: Queue[int] = Queue()

    timed: List[object] = []
    wait = threading.Condition.wait

    def note(self: threading.Condition, timeout: Optional[float] = None) -> bool:
        if timeout is not None and threading.current_thread().name == "steps":
            timed.append(timeout)
        return wait(self, timeout)

    monkeypatch.setattr(threading.Condition, "wait", note)
    thread = StepThread("steps", lambda: steps.put(1) or 0.001, lambda error: None)
    thread.start()
    assert [steps.get(timeout=20.0) for _ in range(3)] == [1, 1, 1]
    assert timed == []
    thread.close()
    thread.join(20.0)
