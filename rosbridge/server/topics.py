"""The topics of clients: one subscription of the middleware per topic, whatever their number; and what they publish."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Mapping, Optional

from ...core.messages.dialect import Message
from ...core.port.local import LogLine
from ...core.port.middleware import Severity, Subscription
from ...core.values.errors import ConfigError, MessageError
from ...core.values.names import canonical_type
from ...runtime.event_loops import ThreadPool
from ..protocol import Limits
from ..protocol.definitions import Serializer, null_reader, serializer
from .access import Access, matches
from .served_node import ROSOUT, ROSOUT_TYPE, ServedNode
from .topic import Options, Receiver, Topic

MOST_PUBLISHED = 1_000
"""Most topics that clients may advertise, in sum. They stay advertised: others may have subscribed to them."""

_LOG_LEVELS = {Severity.DEBUG: 1, Severity.INFO: 2, Severity.WARN: 4, Severity.ERROR: 8, Severity.FATAL: 16}
"""Severity in rosgraph_msgs/Log."""


@dataclass(eq=False)
class _Subscribed:
    """A topic and the subscriptions of the middleware that supply it."""

    topic: Topic
    messages: Optional[Subscription] = None
    raw: Optional[Subscription] = None
    lock: asyncio.Lock = field(default_factory=asyncio.Lock)


class Topics:
    """The topics that clients subscribe to."""

    def __init__(self, node: ServedNode, encoder: ThreadPool, limits: Limits, log: Callable[[str], None]) -> None:
        """Starts without subscriptions; `log` writes one line about a message that cannot be sent."""
        self._node = node
        self._encoder = encoder
        self._limits = limits
        self._log = log
        self._topics: Dict[str, _Subscribed] = {}
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """Messages that were not sent to any client."""
        return self._dropped + self._node.dropped + sum(one.topic.dropped for one in self._topics.values())

    def publish_log(self, line: LogLine) -> None:
        """Publishes a log line on `/rosout`, for a middleware without this topic."""
        rosout = self._topics.get(ROSOUT)
        if rosout is None:
            return
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        header = {"seq": 0, "stamp": {"secs": seconds, "nsecs": nanoseconds}, "frame_id": ""}
        content = {"level": _LOG_LEVELS[line.severity], "name": line.node, "msg": line.text}
        rosout.topic.deliver({"header": header, **content, "file": "", "function": "", "line": 0, "topics": []})

    async def subscribe(self, receiver: Receiver, topic: str, type_name: str, options: Optional[Options]) -> None:
        """Sends the messages of a topic to a client as in `options`; with None, no longer.

        Raises MessageError, ConfigError, ServiceError or OSError if the type is not known or is not that of the topic,
        or the middleware does not respond.
        """
        while True:
            subscribed = self._topics.get(topic)
            if subscribed is None:
                if options is None:
                    return
                subscribed = self._topics.setdefault(topic, _Subscribed(await self._create(topic, type_name)))
            elif options is not None:
                _require_same_type(topic, subscribed.topic.type_name, type_name)
                if type_name and not subscribed.topic.type_name:
                    subscribed.topic.set_type(type_name, await self._serializer(type_name))
            async with subscribed.lock:
                if self._topics.get(topic) is subscribed:
                    await self._set_options(subscribed, receiver, options)
                    return
            # The last other client left meanwhile and the topic was removed: start again.

    async def _create(self, name: str, type_name: str) -> Topic:
        known = await self._node.topic_type(name)
        _require_same_type(name, known, type_name)
        type_name = known or type_name
        serialize = await self._serializer(type_name)
        return Topic(name, type_name, serialize, self._encoder, self._log, self._limits)

    async def _serializer(self, type_name: str) -> Optional[Serializer]:
        return serializer(type_name, await self._node.message_definition(type_name))

    async def _set_options(self, subscribed: _Subscribed, receiver: Receiver, options: Optional[Options]) -> None:
        topic = subscribed.topic
        topic.set_options(receiver, options)
        try:
            await self._update(subscribed)
        except Exception:
            topic.set_options(receiver, None)
            raise
        finally:
            if not topic.compressions:
                self._dropped += topic.dropped
                del self._topics[topic.name]

    async def _update(self, subscribed: _Subscribed) -> None:
        """Subscribes to what the clients of a topic need, and ends what they no longer need."""
        topic, middleware = subscribed.topic, self._node.middleware
        if not self._node.threads and topic.name == ROSOUT and topic.type_name == ROSOUT_TYPE:
            return
        needed = set(topic.compressions)
        if "cbor-raw" in needed and subscribed.raw is None and self._node.threads:
            topic.native_raw = True  # until it has subscribed, nothing is serialized in its place, as ROS 1 does
            try:
                take = self._node.hand_over(topic.deliver_raw)
                subscribed.raw = await self._node.call(
                    middleware.subscribe_raw,
                    topic.name,
                    topic.type_name,
                    lambda message, now_s: take(message[0], now_s),
                )
            except ConfigError:
                topic.native_raw = False
        if topic.native_raw:
            needed.discard("cbor-raw")
        if needed and subscribed.messages is None:
            take = self._node.hand_over(topic.deliver)
            subscribed.messages = await self._node.call(middleware.subscribe, topic.name, topic.type_name, take)
        if not needed and subscribed.messages is not None:
            subscription, subscribed.messages = subscribed.messages, None
            await self._node.call(middleware.unsubscribe, subscription)
        if subscribed.raw is not None and "cbor-raw" not in topic.compressions:
            subscription, subscribed.raw = subscribed.raw, None
            topic.native_raw = False
            await self._node.call(middleware.unsubscribe, subscription)


class Publications:
    """The topics that clients publish on."""

    def __init__(self, node: ServedNode, access: Access) -> None:
        """Starts without topics; `access` says on which clients may publish."""
        self._node = node
        self._access = access
        self._types: Dict[str, str] = {}
        self._readers: Dict[str, Callable[[Mapping[str, Any]], Mapping[str, Any]]] = {}

    async def advertise(self, topic: str, type_name: str) -> None:
        """Advertises a topic for a client; without a type, the topic must exist.

        Raises MessageError, ConfigError, ServiceError or OSError if clients may not publish on the topic or have
        advertised too many, if the type is not known or not that of the topic, or if the middleware does not respond.
        """
        topic = self._node.resolve(topic)
        if not matches(topic, self._access.publish):
            raise MessageError(f"clients may not publish on {topic}")
        if topic not in self._types and len(self._types) >= MOST_PUBLISHED:
            raise MessageError(f"clients have advertised {MOST_PUBLISHED} topics already")
        known = self._types.get(topic) or await self._node.topic_type(topic)
        if not (known or type_name):
            raise MessageError(f"{topic} is not advertised")
        _require_same_type(topic, known, type_name)
        type_name = type_name or known
        await self._node.call(self._node.middleware.advertise, topic, type_name)
        self._readers[topic] = null_reader(type_name, await self._node.message_definition(type_name))
        self._types[topic] = type_name

    async def publish(self, topic: str, message: Message) -> None:
        """Publishes a client's message on an advertised topic; null becomes NaN in float fields.

        Raises MessageError, ServiceError or OSError if the message does not match its type, or the middleware does not
        respond.
        """
        topic = self._node.resolve(topic)
        try:
            await self._node.call(self._node.middleware.publish, topic, self._readers[topic](message))
        except (ValueError, TypeError) as error:
            raise MessageError(str(error)) from None


def _require_same_type(topic: str, known: str, requested: str) -> None:
    """Raises MessageError if both types are given and differ."""
    if known and requested and canonical_type(known) != canonical_type(requested):
        raise MessageError(f"type of {topic}: expected {known}, got {requested}")
