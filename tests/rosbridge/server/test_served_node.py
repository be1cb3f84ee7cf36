from __future__ import annotations

import asyncio
import threading
import time
from typing import Any

import pytest

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ServiceError
from robot_health_monitor.rosbridge.protocol import Limits
from robot_health_monitor.rosbridge.server.served_node import _MOST_CALLS, ServedNode


class Blocking:
    """A middleware whose service /hangs does not answer until it is released."""

    name = "/blocking"

    def __init__(self, released: threading.Event) -> None:
        self.released = released

    def call_service(self, service: str, type_name: str, request: Any, timeout_s: float) -> Any:
        if service == "/hangs":
            self.released.wait(20.0)
        return {"answer": "fine"}


def served(middleware: Any = None, **options: Any) -> ServedNode:
    return ServedNode(middleware or LocalBus().node("rosbridge"), threads=True, **options)


def test_services_that_hang_block_nothing_else() -> None:
    released = threading.Event()

    async def scenario() -> None:
        node = served(Blocking(released))
        hanging = [asyncio.ensure_future(node.call_service("/hangs", {}, 0.05)) for _ in range(_MOST_CALLS)]
        await asyncio.sleep(0)
        assert await node.call(lambda: "subscribed") == "subscribed"
        with pytest.raises(ServiceError, match="busy: 16 requests are pending"):
            await node.call_service("/fine", {}, 1.0)
        for call in hanging:
            with pytest.raises(ServiceError, match=r"no response within 0\.05 s"):
                await call
        released.set()
        while node._callers.pending:
            await asyncio.sleep(0.01)
        assert await node.call_service("/fine", {}, 10.0) == {"answer": "fine"}
        node.close()

    asyncio.run(scenario())


def test_messages_of_many_threads_arrive_in_the_loop_in_the_order_of_their_thread() -> None:
    async def scenario() -> None:
        loop_thread = threading.get_ident()
        node = served()
        heard: list[list[int]] = [[], [], [], []]
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
        node = served(limits=Limits(waiting_bytes=10_000))
        heard: list[str] = []
        callback = node.hand_over(heard.append)
        for number in range(100):  # the loop cannot run meanwhile
            callback(f"{number:04d}" + "x" * 996, 0.0)
        while not heard:
            await asyncio.sleep(0)
        assert [text[:4] for text in heard] == [f"{number:04d}" for number in range(91, 100)]
        assert node.messages.dropped == 91
        node.close()

    asyncio.run(scenario())


def test_a_burst_of_messages_lets_other_tasks_run() -> None:
    async def scenario() -> None:
        node = served()
        heard: list[int] = []

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


def test_the_servers_topics_and_services_are_added_to_the_middlewares() -> None:
    async def scenario() -> None:
        bus = LocalBus()
        robot, server = bus.node("robot"), bus.node("rosbridge")
        robot.advertise("/battery_level", "std_msgs/Float32")
        robot.advertise_service("~reset", "std_srvs/Trigger", lambda request: {})
        node = ServedNode(server, threads=False)
        node.added_services["/offered"] = "std_srvs/SetBool"
        found = node.graph()
        assert found.topics == {"/battery_level": "std_msgs/Float32", "/rosout": "rosgraph_msgs/Log"}
        assert found.services == {"/robot/reset": "std_srvs/Trigger", "/offered": "std_srvs/SetBool"}
        assert list(found.nodes["/rosbridge"].publishes) == ["/rosout"]
        assert list(found.nodes["/rosbridge"].services) == ["/offered"]
        assert await node.topic_type("battery_level") == "std_msgs/Float32"
        assert await node.topic_type("/unknown") == ""
        assert "/rosout" not in ServedNode(server, threads=True).graph().topics

    asyncio.run(scenario())


def test_definitions_that_the_middleware_lacks_are_known_here() -> None:
    node = ServedNode(LocalBus().node("rosbridge"), threads=False)
    assert node.definition("std_msgs/Float32") == "float32 data\n"
    assert node.definition("nav_msgs/Odometry") == ""
    assert node.definition("") == ""
