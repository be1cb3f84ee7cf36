"""Topics and the rates of their clients; subscriptions of clients, over real sockets in front of a local bus."""

from __future__ import annotations

import asyncio
import json
import math
import threading
from types import SimpleNamespace
from typing import Any, Awaitable, Callable

import pytest
from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.core.values.errors import ConfigError, ServiceError
from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.rosbridge.protocol.operations import Subscribe
from robot_health_monitor.rosbridge.server import topics
from robot_health_monitor.rosbridge.server.topics import MOST_PUBLISHED, Flow, Topic, merge
from robot_health_monitor.runtime.access import Access
from robot_health_monitor.runtime.event_loops import ThreadPool


class Receiver:
    def __init__(self) -> None:
        self.frames: list[bytes] = []

    def put(self, frames: bytes) -> None:
        self.frames.append(frames)

    @property
    def values(self) -> list[Any]:
        return [json.loads(frames[frames.index(b"{") :])["msg"]["data"] for frames in self.frames]


def run(scenario: Callable[[Topic, list[str]], Awaitable[None]], **options: Any) -> None:
    async def start() -> None:
        pool = ThreadPool("encode", 1, 100)
        problems: list[str] = []
        node: Any = SimpleNamespace(dropped=0, codec=pool, log=problems.append, limits=Limits(**options), threads=False)
        topic = Topic("/a", "std_msgs/String", node)
        await asyncio.wait_for(scenario(topic, problems), 60.0)
        pool.close()

    asyncio.run(start())


def test_clients_with_the_same_encoding_share_the_frames() -> None:
    async def scenario(topic: Topic, problems: list[str]) -> None:
        one, other, cbor = Receiver(), Receiver(), Receiver()
        topic.set_flow(one, Flow())
        topic.set_flow(other, Flow())
        topic.set_flow(cbor, Flow(compression="cbor"))
        topic.deliver({"data": 1.0})
        assert one.frames[0] is other.frames[0]
        assert cbor.frames[0][:1] == b"\x82"
        topic.set_flow(one, None)
        topic.deliver({"data": 2.0})
        assert (one.values, other.values) == ([1.0], [1.0, 2.0])

    run(scenario)


def test_small_messages_do_not_overtake_large_ones() -> None:
    async def scenario(topic: Topic, problems: list[str]) -> None:
        client = Receiver()
        topic.set_flow(client, Flow())
        large = "x" * 200_000
        for data in ("first", large, "second", large, "third"):
            topic.deliver({"data": data})
        while len(client.frames) < 5:
            await asyncio.sleep(0)
        assert client.values == ["first", large, "second", large, "third"]

    run(scenario)


def test_large_messages_are_encoded_in_a_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[int] = []
    encode = topics.publication

    def note(*arguments: Any, **options: Any) -> bytes:
        threads.append(threading.get_ident())
        return encode(*arguments, **options)

    async def scenario(topic: Topic, problems: list[str]) -> None:
        client = Receiver()
        topic.set_flow(client, Flow())
        monkeypatch.setattr(topics, "publication", note)
        topic.deliver({"data": "x" * 200_000})
        while not client.frames:
            await asyncio.sleep(0)
        assert threading.get_ident() not in threads

    run(scenario)


def test_while_the_encoder_is_busy_the_newest_wait_within_the_bound() -> None:
    async def scenario(topic: Topic, problems: list[str]) -> None:
        client = Receiver()
        topic.set_flow(client, Flow())
        released = threading.Event()
        busy = topic._node.codec.submit(released.wait, 20.0)
        for number in range(100):
            topic.deliver({"data": f"{number:04d}" + "x" * 100_000})
            assert topic._waiting.size <= 350_000
            await asyncio.sleep(0)
        released.set()
        await busy
        while len(client.frames) < 4:
            await asyncio.sleep(0)
        assert [value[:4] for value in client.values] == ["0000", "0097", "0098", "0099"]
        assert (topic._waiting.size, topic._node.dropped) == (0, 96)

    run(scenario, encoding_bytes=350_000)


def test_a_message_that_cannot_be_encoded_is_reported_and_the_next_is_sent() -> None:
    async def scenario(topic: Topic, problems: list[str]) -> None:
        client = Receiver()
        topic.set_flow(client, Flow())
        topic.deliver({"data": ["x" * 200_000, object()]})
        topic.deliver({"data": 1.0})
        while not client.frames:
            await asyncio.sleep(0)
        assert client.values == [1.0]
        assert problems == ["/a (std_msgs/String): object cannot be encoded as JSON"]

    run(scenario)


def test_a_client_that_left_gets_nothing_that_is_still_being_encoded() -> None:
    async def scenario(topic: Topic, problems: list[str]) -> None:
        client, other = Receiver(), Receiver()
        topic.set_flow(client, Flow())
        topic.set_flow(other, Flow())
        topic.deliver({"data": "x" * 200_000})
        topic.set_flow(client, None)
        while not other.frames:
            await asyncio.sleep(0)
        assert client.frames == []

    run(scenario)


def test_throttled_messages_in_between_are_left_out() -> None:
    async def scenario(topic: Topic, problems: list[str]) -> None:
        clock, client, other = SimpleNamespace(now_s=0.0), Receiver(), Receiver()
        topic._clock = lambda: clock.now_s
        topic.set_flow(client, Flow(throttle_s=0.25))
        topic.set_flow(other, Flow())
        for clock.now_s, data in ((0.0, "a"), (0.125, "b"), (0.1875, "c"), (0.375, "d"), (0.5, "e"), (0.75, "f")):
            topic.deliver({"data": data})
        assert (client.values, other.values) == (["a", "d", "f"], list("abcdef"))

    run(scenario)


def test_a_message_that_cannot_be_sent_is_counted_and_reported() -> None:
    async def scenario(topic: Topic, problems: list[str]) -> None:
        client = Receiver()
        topic.set_flow(client, Flow(compression="cbor-raw"))
        topic._serialize = None
        topic.deliver({"data": "a"})
        topic.deliver({"data": "x" * 20_000})
        assert (client.frames, topic._node.dropped) == ([], 2)
        assert problems[0] == (
            "/a (std_msgs/String): cannot be sent as cbor-raw: the definition of its type is not known"
        )
        assert problems[1].startswith("/a (std_msgs/String): message of 20") and problems[1].endswith(
            "dropped (limit 10000)"
        )

    run(scenario, sent_bytes=10_000)


def test_several_requests_for_a_topic_are_merged_as_the_reference_server_does() -> None:
    requests = [
        Subscribe("/a", throttle_rate=500.0, compression="none"),
        Subscribe("/a", throttle_rate=100.0, compression="cbor"),
        Subscribe("/a", throttle_rate=1000.0, compression="png"),
    ]
    assert merge(requests) == Flow(0.1, "cbor")
    assert merge([Subscribe("/a", compression=each) for each in ("none", "cbor-raw", "cbor")]) == Flow(0.0, "cbor-raw")


def test_a_client_that_asks_for_a_queue_misses_nothing() -> None:
    assert merge([Subscribe("/a", throttle_rate=500.0, queue_length=1)]) == Flow(0.0, "none")


def subscriptions(robot: Robot) -> list[str]:
    return list(robot.bus.graph().nodes["/rosbridge"].subscribes)


@with_robot()
async def test_a_topic_is_subscribed_to_once_whatever_the_number_of_clients(robot: Robot) -> None:
    async with robot.peer() as one:
        async with robot.peer() as other:
            await one.subscribe("/battery_level")
            await other.subscribe("/battery_level", compression="cbor")
            assert subscriptions(robot) == ["/battery_level"]
        await robot.until(lambda: robot.server.clients == 1)
        robot.publish(1.0)
        assert await one.receive_many(1) == [1.0]


@with_robot()
async def test_a_wrong_type_is_refused_and_the_connection_continues(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/battery_level", type="std_msgs/String", id="s1")
        assert await peer.receive() == {
            "op": "status",
            "level": "error",
            "msg": "subscribe: type of /battery_level: expected std_msgs/Float32, got std_msgs/String",
            "id": "s1",
        }
        await peer.subscribe("/battery_level", type=FLOAT32)
        await peer.send("subscribe", topic="/battery_level", type="std_msgs/String", id="s2")
        assert "expected std_msgs/Float32" in (await peer.receive())["msg"]
        robot.publish(1.0)
        assert await peer.receive_many(1) == [1.0]


@with_robot()
async def test_while_the_master_is_down_subscribing_is_refused_and_no_client_is_disconnected(robot: Robot) -> None:
    served = robot.server._node.middleware
    graph = served.graph

    def fail() -> Any:
        raise ServiceError("the ROS master does not respond")

    async with robot.peer() as peer, robot.peer() as reader:
        await reader.subscribe("/battery_level")
        served.graph = fail  # type: ignore[method-assign]
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/later", type=FLOAT32, id="s")
        assert (await peer.receive())["msg"] == "subscribe: the ROS master does not respond"
        response = await peer.call("/rosapi/topics")
        assert (response["result"], response["values"]) == (False, "the ROS master does not respond")
        robot.publish(1.0)
        assert await reader.receive_many(1) == [1.0]
        served.graph = graph  # type: ignore[method-assign]
        await peer.subscribe("/battery_level")
        robot.publish(2.0)
        assert await peer.receive_many(1) == [2.0]


@with_robot()
async def test_a_subscription_that_the_middleware_refuses_leaves_nothing_behind(robot: Robot) -> None:
    def refuse(*arguments: Any, **options: Any) -> Any:
        raise ConfigError("unknown type no_msgs/Type")

    robot.server._node.middleware.subscribe = refuse  # type: ignore[method-assign]
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/later", type="no_msgs/Type", id="s")
        assert await peer.receive() == {
            "op": "status",
            "level": "error",
            "msg": "subscribe: unknown type no_msgs/Type",
            "id": "s",
        }
        assert robot.server._topics._topics == {}


@with_robot()
async def test_clients_that_come_and_go_at_once_leave_the_topic_as_the_last_one_wants_it(robot: Robot) -> None:
    async with robot.peer() as stays:
        for _ in range(5):
            async with robot.peer() as leaves:
                await asyncio.gather(
                    leaves.send("subscribe", topic="/battery_level"),
                    stays.send("subscribe", topic="/battery_level", id="a"),
                    stays.send("unsubscribe", topic="/battery_level", id="a"),
                )
        await stays.settle()
        await robot.until(lambda: subscriptions(robot) == [])


OPEN = Access(publish=("/in",))


@with_robot(OPEN)
async def test_null_is_published_as_nan(robot: Robot) -> None:
    heard: list[float] = []
    robot.node.subscribe("/in", FLOAT32, lambda value, now_s: heard.append(value), field="data")
    async with robot.peer() as peer:
        await peer.send("advertise", topic="/in", type=FLOAT32)
        await peer.send("publish", topic="/in", msg={"data": None})
        await peer.send("publish", topic="/in", msg={"data": 1.0})
        await robot.until(lambda: len(heard) == 2)
    assert math.isnan(heard[0]) and heard[1] == 1.0


@with_robot(Access(services=("*",)))
async def test_subscribing_to_a_topic_does_not_open_it_for_publishing(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("subscribe", topic="/battery_level")
        for op, fields in (("advertise", {"type": FLOAT32}), ("publish", {"msg": {"data": 0.0}})):
            await peer.send(op, topic="/battery_level", id="p", **fields)
            status = await peer.receive()
            assert (status["msg"], status["id"]) == (f"{op}: clients may not publish on /battery_level", "p")


@with_robot(OPEN)
async def test_a_relative_name_is_the_same_topic(robot: Robot) -> None:
    heard: list[float] = []
    robot.node.subscribe("/in", FLOAT32, lambda value, now_s: heard.append(value), field="data")
    async with robot.peer() as peer:
        await peer.send("advertise", topic="in", type=FLOAT32)
        await peer.send("publish", topic="in", msg={"data": 2.0})
        await robot.until(lambda: heard == [2.0])


@with_robot(OPEN)
async def test_while_the_master_is_down_publishing_is_refused_and_the_connection_continues(robot: Robot) -> None:
    def fail() -> Any:
        raise ServiceError("the ROS master does not respond")

    robot.server._node.middleware.graph = fail  # type: ignore[method-assign]
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("advertise", topic="/in", type=FLOAT32, id="a")
        assert (await peer.receive())["msg"] == "advertise: the ROS master does not respond"
        await peer.settle()


@with_robot(Access(publish=("*",)), limits=Limits(advertisements=2_000))
async def test_clients_cannot_invent_any_number_of_topics(robot: Robot) -> None:
    """Each is advertised on the robot, and stays so when the client has left."""
    async with robot.peer() as peer:
        for number in range(MOST_PUBLISHED):
            await peer.send("advertise", topic=f"/invented{number}", type=FLOAT32)
        await peer.settle()
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.send("advertise", topic="/one_more", type=FLOAT32, id="a")
        assert (await peer.receive())["msg"] == "advertise: clients have advertised 1000 topics already"
        await peer.send("advertise", topic="/invented7", type=FLOAT32)
        await peer.settle()
    assert len(robot.bus.graph().topics) == 1 + MOST_PUBLISHED
