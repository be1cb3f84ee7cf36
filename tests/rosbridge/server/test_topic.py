from __future__ import annotations

import asyncio
import json
from typing import Any, Awaitable, Callable, List

from robot_health_monitor.rosbridge.server.subscriptions import ByteBudget, Options
from robot_health_monitor.rosbridge.server.topic import Topic
from robot_health_monitor.runtime.threads import ThreadPool


class Receiver:
    def __init__(self, budget: int = 1_000_000) -> None:
        self.throttled = ByteBudget(budget)
        self.frames: List[bytes] = []

    def put(self, frames: bytes) -> None:
        self.frames.append(frames)

    @property
    def values(self) -> List[Any]:
        return [json.loads(frames[frames.index(b"{") :])["msg"]["data"] for frames in self.frames]


def run(scenario: Callable[[Topic, List[str]], Awaitable[None]], **options: Any) -> None:
    async def start() -> None:
        pool = ThreadPool("encode", 1, 100)
        problems: List[str] = []
        topic = Topic("/a", "std_msgs/String", None, pool, problems.append, **options)
        await asyncio.wait_for(scenario(topic, problems), 60.0)
        pool.close()

    asyncio.run(start())


def test_clients_with_the_same_encoding_share_the_frames() -> None:
    async def scenario(topic: Topic, problems: List[str]) -> None:
        one, other, cbor = Receiver(), Receiver(), Receiver()
        topic.set_options(one, Options())
        topic.set_options(other, Options())
        topic.set_options(cbor, Options(compression="cbor"))
        topic.deliver({"data": 1.0})
        assert one.frames[0] is other.frames[0]
        assert cbor.frames[0][:1] == b"\x82"
        assert set(topic.compressions) == {"none", "cbor"}
        topic.set_options(one, None)
        topic.deliver({"data": 2.0})
        assert (one.values, other.values) == ([1.0], [1.0, 2.0])

    run(scenario)


def test_small_messages_do_not_overtake_large_ones() -> None:
    async def scenario(topic: Topic, problems: List[str]) -> None:
        client = Receiver()
        topic.set_options(client, Options())
        large = "x" * 200_000
        for data in ("first", large, "second", large, "third"):
            topic.deliver({"data": data})
        while len(client.frames) < 5:
            await asyncio.sleep(0)
        assert client.values == ["first", large, "second", large, "third"]

    run(scenario)


def test_a_client_that_left_gets_nothing_that_is_still_being_encoded() -> None:
    async def scenario(topic: Topic, problems: List[str]) -> None:
        client, other = Receiver(), Receiver()
        topic.set_options(client, Options())
        topic.set_options(other, Options())
        topic.deliver({"data": "x" * 200_000})
        topic.set_options(client, None)
        while not other.frames:
            await asyncio.sleep(0)
        assert client.frames == []

    run(scenario)


def test_throttled_messages_of_all_topics_share_the_budget_of_the_client() -> None:
    async def scenario(topic: Topic, problems: List[str]) -> None:
        client = Receiver(budget=300_000)
        topic.set_options(client, Options(throttle_s=3600.0, queue_length=1000))
        for number in range(100):
            topic.deliver({"data": f"{number}" + "x" * 50_000})
            assert client.throttled.used <= 300_000
        assert client.throttled.used > 200_000
        topic.set_options(client, None)
        assert client.throttled.used == 0

    run(scenario)


def test_a_message_that_cannot_be_sent_is_counted_and_reported() -> None:
    async def scenario(topic: Topic, problems: List[str]) -> None:
        client = Receiver()
        topic.set_options(client, Options(compression="cbor-raw"))
        topic.deliver({"data": "a"})
        topic.deliver({"data": "x" * 20_000})
        assert (client.frames, topic.dropped) == ([], 2)
        assert problems[0] == (
            "/a (std_msgs/String): cannot be sent as cbor-raw: the definition of its type is not known"
        )
        assert problems[1].startswith("/a: message of 20") and problems[1].endswith("dropped (limit 10000)")

    run(scenario, sent_bytes=10_000)
