from __future__ import annotations

import asyncio
import threading
from typing import Any, List

import pytest

from robot_health_monitor.rosbridge.server.node_access import _MOST_CALLS, NodeAccess


def test_services_that_hang_keep_nobody_from_anything_else() -> None:
    released = threading.Event()

    async def scenario() -> None:
        node = NodeAccess(asyncio.get_event_loop(), threads=True)
        hanging = [
            asyncio.ensure_future(node.call_service(released.wait, 20.0, timeout_s=0.05)) for _ in range(_MOST_CALLS)
        ]
        await asyncio.sleep(0)
        assert await node.call(lambda: "subscribed") == "subscribed"
        with pytest.raises(ValueError, match="16 other service calls wait"):
            await node.call_service(lambda: None, timeout_s=1.0)
        for call in hanging:
            with pytest.raises(ValueError, match=r"no answer within 0\.05 s"):
                await call
        released.set()
        while node._calls:
            await asyncio.sleep(0.01)
        assert await node.call_service(lambda: "fine", timeout_s=10.0) == "fine"
        node.close()

    asyncio.run(scenario())


def test_what_many_threads_deliver_arrives_in_the_loop_each_in_its_order() -> None:
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
