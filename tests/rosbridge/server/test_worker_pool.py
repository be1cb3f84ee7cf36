from __future__ import annotations

import asyncio
import gc
import threading
import weakref

import pytest

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.rosbridge.server.worker_pool import WorkerPool


def test_functions_run_in_threads_and_their_results_and_errors_come_back() -> None:
    async def scenario() -> None:
        pool = WorkerPool(asyncio.get_event_loop(), "worker", 2, 10)
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
        pool = WorkerPool(asyncio.get_event_loop(), "bounded-worker", 2, 5)
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
        pool = WorkerPool(asyncio.get_event_loop(), "hanging-worker", 1, 5)
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
        pool = WorkerPool(asyncio.get_event_loop(), "worker", 1, 5)
        result = weakref.ref(await pool.run(Large))
        await pool.run(lambda: None)
        await asyncio.sleep(0)
        gc.collect()
        assert result() is None
        pool.close()

    asyncio.run(scenario())
