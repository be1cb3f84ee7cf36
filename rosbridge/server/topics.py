"""The topics of clients: one subscription of the middleware per topic, whatever their number; and what they publish."""

from __future__ import annotations

import asyncio
import math
from dataclasses import dataclass
from functools import partial
from typing import Callable, Collection, Protocol, Sequence

from ...core.port import LogLine, Severity, Subscription
from ...core.values import Message, MessageError, ServiceError, canonical_type
from ...runtime.access import matches
from ...runtime.bounded_queue import BoundedQueue
from ..protocol.definitions import serializer
from ..protocol.operations import COMPRESSIONS, Subscribe
from .sending import LARGE_BYTES, estimated_bytes, publication, wall_stamp
from .served_node import ROSOUT, ROSOUT_TYPE, ServedNode

MOST_PUBLISHED = 1_000
"""Most topics that clients may advertise, in sum. They stay advertised: others may have subscribed to them."""

_LOG_LEVELS = {Severity.DEBUG: 1, Severity.INFO: 2, Severity.WARN: 4, Severity.ERROR: 8, Severity.FATAL: 16}
"""Severity in rosgraph_msgs/Log."""


@dataclass
class Flow:
    """How a client receives the messages of a topic."""

    throttle_s: float = 0.0
    """Minimum time between two messages, in s; those in between are left out."""
    compression: str = "none"
    due_s: float = -math.inf
    """When the next message may be sent, in s of the loop's time."""


def merge(requests: Collection[Subscribe]) -> Flow:
    """Returns one flow for all subscriptions of a client to one topic.

    As in the reference server: the fastest rate, and the compression that is last in COMPRESSIONS. A client that asks
    for a queue does not want to miss messages: it gets them at once.
    """
    is_queued = any(each.queue_length for each in requests)
    throttle_s = min(each.throttle_rate for each in requests) / 1000.0
    return Flow(0.0 if is_queued else throttle_s, max((each.compression for each in requests), key=COMPRESSIONS.index))


class Receiver(Protocol):
    """A client, as seen from a topic."""

    def put(self, frame: bytes) -> None:
        """Sends a frame or queues it."""


class Topic:
    """The clients of the messages of one topic, or of their raw bytes. Used in the event loop only."""

    def __init__(self, name: str, type_name: str, node: ServedNode) -> None:
        """Starts without clients; `name` is as sent to clients."""
        self.name = name
        self.type_name = type_name
        self.clients: dict[Receiver, Flow] = {}
        """How each client receives the messages."""
        self.source: Subscription | None = None
        """The subscription of the middleware; None if the server itself publishes on the topic."""
        self._serialize = serializer(type_name)
        """Makes raw bytes of a message if the middleware gives none; None if that is not possible."""
        self._node = node
        self._waiting: BoundedQueue[tuple[Callable[[], bytes], Sequence[Receiver]]]
        self._waiting = BoundedQueue(node.limits.encoding_bytes)
        """Large messages, until a thread has encoded them, and those that came after: their order stays. The newest
        win."""
        self._is_encoding = False
        self._clock = asyncio.get_event_loop().time

    def set_type(self, type_name: str) -> None:
        """Takes the type of a topic that was subscribed to before it was known."""
        if not self.type_name:
            self.type_name, self._serialize = type_name, serializer(type_name)

    def set_flow(self, receiver: Receiver, flow: Flow | None) -> None:
        """Sets how a client receives the messages; with None, it no longer receives them."""
        self.clients.pop(receiver, None)
        if flow is not None:
            self.clients[receiver] = flow
        if not self.clients:
            self._waiting.clear()

    def deliver(self, content: Message | bytes) -> None:
        """Sends a message, or its raw bytes."""
        size, limit = estimated_bytes(content), self._node.limits.sent_bytes
        if size > limit:
            self._fail(f"message of {size} bytes dropped (limit {limit})")
            return
        now_s = self._clock()
        receiving: dict[str, list[Receiver]] = {}
        for receiver, flow in self.clients.items():
            if now_s >= flow.due_s:
                flow.due_s = now_s + flow.throttle_s
                receiving.setdefault(flow.compression, []).append(receiver)
        for compression, receivers in receiving.items():
            is_large = size > LARGE_BYTES
            encode = partial(publication, self.name, content, compression, self._serialize, is_large=is_large)
            if is_large or self._is_encoding:
                self._node.dropped += self._waiting.put((encode, receivers), size)
                if not self._is_encoding:
                    self._is_encoding = True
                    self._encoder = asyncio.ensure_future(self._encode_waiting())
                continue
            try:
                self._put(encode(), receivers)
            except MessageError as error:
                self._fail(str(error))

    async def _encode_waiting(self) -> None:
        try:
            while self._waiting:
                encode, receivers = self._waiting.pop()
                try:
                    self._put(await self._node.codec.run(encode), receivers)
                except (MessageError, ServiceError) as error:
                    self._fail(str(error))
        finally:
            self._is_encoding = False

    def _put(self, frame: bytes, receivers: Sequence[Receiver]) -> None:
        for receiver in receivers:
            if receiver in self.clients:
                receiver.put(frame)

    def _fail(self, reason: str) -> None:
        self._node.dropped += 1
        self._node.log(f"{self.name} ({self.type_name}): {reason}")


class Topics:
    """The topics that clients subscribe to, and those that they publish on."""

    def __init__(self, node: ServedNode) -> None:
        """Starts without topics. Called in the event loop."""
        self._node = node
        self._topics: dict[tuple[str, bool], Topic] = {}
        """By name, and whether clients receive raw bytes of the middleware; those that have threads give them."""
        self._published: dict[str, str] = {}
        """Type of each topic that clients publish on."""
        self._lock = asyncio.Lock()
        """Held while clients and subscriptions change."""

    def publish_log(self, line: LogLine) -> None:
        """Publishes a log line on `/rosout`, for a middleware without this topic."""
        rosout = self._topics.get((ROSOUT, False))
        if rosout is None:
            return
        header = {"seq": 0, "stamp": wall_stamp(), "frame_id": ""}
        content = {"level": _LOG_LEVELS[line.severity], "name": line.node, "msg": line.text}
        rosout.deliver({"header": header, **content, "file": "", "function": "", "line": 0, "topics": []})

    async def subscribe(self, receiver: Receiver, name: str, type_name: str, flow: Flow | None) -> None:
        """Sends the messages of a topic to a client as in `flow`; with None, no longer.

        Raises MessageError, ConfigError, ServiceError or OSError if the type is not known or is not that of the topic,
        or the middleware does not respond.
        """
        async with self._lock:
            wanted = None
            if flow is not None:
                wanted = name, flow.compression == "cbor-raw" and self._node.threads
                await self._join(receiver, wanted, type_name, flow)
            for key in ((name, False), (name, True)):
                topic = self._topics.get(key)
                if topic is None or key == wanted:
                    continue
                topic.set_flow(receiver, None)
                if not topic.clients:
                    del self._topics[key]
                    if topic.source is not None:
                        await self._node.call(self._node.middleware.unsubscribe, topic.source)

    async def _join(self, receiver: Receiver, key: tuple[str, bool], type_name: str, flow: Flow) -> None:
        name, raw = key
        other = self._topics.get(key) or self._topics.get((name, not raw))
        known = await self._node.topic_type(name) if other is None else other.type_name
        _require_same_type(name, known, type_name)
        topic = self._topics.get(key) or Topic(name, known or type_name, self._node)
        topic.set_type(type_name)
        topic.set_flow(receiver, flow)
        if key not in self._topics:
            if self._node.threads or (name, topic.type_name) != (ROSOUT, ROSOUT_TYPE):
                middleware = self._node.middleware
                subscribe: Callable[..., Subscription] = middleware.subscribe_raw if raw else middleware.subscribe
                take = self._node.hand_over((lambda message: topic.deliver(message[0])) if raw else topic.deliver)
                topic.source = await self._node.call(subscribe, name, topic.type_name, take)
            self._topics[key] = topic

    async def advertise(self, topic: str, type_name: str) -> None:
        """Advertises a topic for a client; without a type, the topic must exist.

        Raises MessageError, ConfigError, ServiceError or OSError if clients may not publish on the topic or have
        advertised too many, if the type is not known or not that of the topic, or if the middleware does not respond.
        """
        topic = self._node.resolve(topic)
        if not matches(topic, self._node.access.publish):
            raise MessageError(f"clients may not publish on {topic}")
        if topic not in self._published and len(self._published) >= MOST_PUBLISHED:
            raise MessageError(f"clients have advertised {MOST_PUBLISHED} topics already")
        known = self._published.get(topic) or await self._node.topic_type(topic)
        if not (known or type_name):
            raise MessageError(f"{topic} is not advertised")
        _require_same_type(topic, known, type_name)
        if topic not in self._published:
            await self._node.call(self._node.middleware.advertise, topic, type_name or known)
            self._published[topic] = type_name or known

    async def publish(self, topic: str, message: Message) -> None:
        """Publishes a client's message on an advertised topic.

        Raises MessageError, ServiceError or OSError if the message does not match its type, or the middleware does not
        respond.
        """
        try:
            await self._node.call(self._node.middleware.publish, self._node.resolve(topic), message)
        except (ValueError, TypeError) as error:
            raise MessageError(str(error)) from None


def _require_same_type(topic: str, known: str, requested: str) -> None:
    """Raises MessageError if both types are given and differ."""
    if known and requested and canonical_type(known) != canonical_type(requested):
        raise MessageError(f"type of {topic}: expected {known}, got {requested}")
