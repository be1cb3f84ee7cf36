from __future__ import annotations

import asyncio
import threading
import time
from typing import Any, List

import pytest

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.rosbridge.server.node_access import _MOST_CALLS, NodeAccess


def test_services_that_hang_block_nothing_else() -> None:
    released = threading.Event()

    async def scenario() -> None:
        node = NodeAccess(asyncio.get_event_loop(), threads=True)
        hanging = [
            asyncio.ensure_future(node.call_service(released.wait, 20.0, timeout_s=0.05)) for _ in range(_MOST_CALLS)
        ]
        await asyncio.sleep(0)
        assert await node.call(lambda: "subscribed") == "subscribed"
        with pytest.raises(ServiceError, match="busy: 16 requests are pending"):
            await node.call_service(lambda: None, timeout_s=1.0)
        for call in hanging:
            with pytest.raises(ServiceError, match=r"no response within 0\.05 s"):
                await call
        released.set()
        while node._callers.pending:
            await asyncio.sleep(0.01)
        assert await node.call_service(lambda: "fine", timeout_s=10.0) == "fine"
        node.close()

    asyncio.run(scenario())


def test_messages_of_many_threads_arrive_in_the_loop_in_the_order_of_their_thread() -> None:
    async def scenario() -> None:
        loop_thread = threading.get_ident()
        node = NodeAccess(asyncio.get_event_loop(), threads=True)
        heard: List[List[int]] = [[], [], [], []]
        threads_seen = set()

        def deliver_to(index: int) -> Any:
            def take(value: int) -> None:
                threads_seen.add(threading.get_ident())
                heard[index].append(value)

            return node.hand_over(take)

        def publish(callback: Any) -> None:
            for number in range(5000):
                callback(number, 0.0)

        threads = [threading.Thread(target=publish, args=(deliver_to(index),)) for index in range(4)]
        for thread in threads:
            thread.start()
        while any(len(values) < 5000 for values in heard):
            await asyncio.sleep(0.001)
        assert heard == [list(range(5000))] * 4
        assert threads_seen == {loop_thread}
        node.close()

    asyncio.run(scenario())


def test_messages_beyond_the_bound_are_dropped_oldest_first_and_counted() -> None:
    async def scenario() -> None:
        node = NodeAccess(asyncio.get_event_loop(), threads=True, queue_bytes=10_000)
        heard: List[str] = []
        callback = node.hand_over(heard.append)
        for number in range(100):  # the loop cannot run meanwhile
            callback(f"{number:04d}" + "x" * 996, 0.0)
        while not heard:
            await asyncio.sleep(0)
        assert [text[:4] for text in heard] == [f"{number:04d}" for number in range(91, 100)]
        assert node.dropped == 91
        node.close()

    asyncio.run(scenario())


def test_a_burst_of_messages_lets_other_tasks_run() -> None:
    async def scenario() -> None:
        node = NodeAccess(asyncio.get_event_loop(), threads=True)
        heard: List[int] = []

        def take(value: int) -> None:
            end_s = time.monotonic() + 0.004
            while time.monotonic() < end_s:
                pass
            heard.append(value)

        callback = node.hand_over(take)
        for number in range(20):
            callback(number, 0.0)
        turns = 0
        while len(heard) < 20:
            await asyncio.sleep(0)
            turns += 1
        assert turns >= 10  # at most two messages of 4 ms in a slice of 5 ms
        node.close()

    asyncio.run(scenario())
