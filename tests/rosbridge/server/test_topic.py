from __future__ import annotations

import asyncio
import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, Awaitable, Callable, List, Tuple

from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.rosbridge.protocol.operations import Subscribe
from robot_health_monitor.rosbridge.server.topic import ByteBudget, Options, Pacer, Topic, merge
from robot_health_monitor.runtime.event_loops import ThreadPool


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
        topic = Topic("/a", pool, problems.append, Limits(**options))
        topic.type_name = "std_msgs/String"
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


def test_options_are_read_in_seconds_and_within_the_limits() -> None:
    request = Subscribe("/a", throttle_rate=250.0, queue_length=7, fragment_size=100, compression="png")
    assert merge([request], Limits()) == Options(0.25, 7, 100, "png")
    assert merge([replace(request, queue_length=10**9)], Limits(queue_messages=50)).queue_length == 50


def test_several_requests_for_a_topic_are_merged_as_the_reference_server_does() -> None:
    requests = [
        Subscribe("/a", throttle_rate=500.0, queue_length=10, fragment_size=200, compression="none"),
        Subscribe("/a", throttle_rate=100.0, queue_length=2, compression="cbor"),
        Subscribe("/a", throttle_rate=1000.0, queue_length=5, fragment_size=100, compression="png"),
    ]
    assert merge(requests, Limits()) == Options(0.1, 2, 100, "cbor")
    every = [Subscribe("/a", compression=each) for each in ("none", "cbor-raw", "cbor")]
    assert merge(every, Limits()) == Options(0.0, 0, None, "cbor-raw")


class Paced:
    """A pacer in virtual time, with what it has sent and when."""

    def __init__(self, budget: ByteBudget, **options: Any) -> None:
        self.now_s = 0.0
        self.sent: List[Tuple[float, str]] = []
        self._timers: List[Tuple[float, Callable[[], None]]] = []
        self.pacer = Pacer(Options(**options), budget, self._send, self._call_later)  # type: ignore[arg-type]

    def _send(self, message: Any) -> None:
        self.sent.append((self.now_s, message.name))

    def _call_later(self, delay_s: float, callback: Callable[[], None]) -> Any:
        timer = (self.now_s + delay_s, callback)
        self._timers.append(timer)
        return SimpleNamespace(cancel=lambda: self._timers.remove(timer))

    def at(self, now_s: float, name: str = "", size: int = 1) -> None:
        """Lets time pass, then offers a message if it has a name."""
        for due_s, callback in [timer for timer in self._timers if timer[0] <= now_s]:
            self._timers.remove((due_s, callback))
            self.now_s = due_s
            callback()
        self.now_s = now_s
        if name:
            self.pacer.offer(SimpleNamespace(name=name, size=size))  # type: ignore[arg-type]


def test_without_a_queue_messages_in_between_are_left_out() -> None:
    paced = Paced(ByteBudget(1000), throttle_s=0.25)
    for now_s, name in ((0.0, "a"), (0.125, "b"), (0.1875, "c"), (0.375, "d"), (0.5, "e"), (0.75, "f")):
        paced.at(now_s, name)
    assert paced.sent == [(0.0, "a"), (0.375, "d"), (0.75, "f")]


def test_with_a_queue_the_newest_wait_for_their_time() -> None:
    paced = Paced(ByteBudget(1000), throttle_s=0.25, queue_length=2)
    for now_s, name in ((0.0, "a"), (0.0625, "b"), (0.125, "c"), (0.1875, "d"), (0.375, "e"), (0.4375, "f")):
        paced.at(now_s, name)
    for now_s in (0.5, 0.75, 1.0, 1.25):
        paced.at(now_s)
    # "b" made room for "d", and "d" for "f".
    assert paced.sent == [(0.0, "a"), (0.25, "c"), (0.5, "e"), (0.75, "f")]
    paced.at(2.0, "g")
    assert paced.sent[4:] == [(2.0, "g")]


def test_the_queues_of_a_client_share_a_bound_in_bytes() -> None:
    budget = ByteBudget(100)
    one, other = (Paced(budget, throttle_s=1.0, queue_length=1000) for _ in range(2))
    one.at(0.0, "sent", 30)
    other.at(0.0, "sent", 30)
    assert budget.used == 0
    for name in "abcd":
        one.at(0.125, name, 30)
    assert budget.used == 90  # "a" was dropped
    other.at(0.125, "x", 30)
    assert budget.used == 90  # "x" did not fit
    one.at(1.0)
    assert one.sent == [(0.0, "sent"), (1.0, "b")]
    other.at(0.25, "y", 30)
    assert budget.used == 90
    one.pacer.close()
    assert budget.used == 30
    one.at(9.0)
    assert len(one.sent) == 2
