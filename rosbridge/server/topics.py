"""The topics of clients: one subscription of the middleware per topic, whatever their number; and what they publish."""

from __future__ import annotations

import time
from typing import Any, Callable, Dict, Mapping, Optional

from ...core.messages.dialect import Message
from ...core.port.local import LogLine
from ...core.port.middleware import Severity
from ...core.values.errors import ConfigError, MessageError
from ...core.values.names import canonical_type
from ...runtime.event_loops import ThreadPool
from ..protocol import Limits
from ..protocol.definitions import null_reader, serializer
from .access import Access, matches
from .served_node import ROSOUT, ROSOUT_TYPE, ServedNode
from .topic import Options, Receiver, Topic

MOST_PUBLISHED = 1_000
"""Most topics that clients may advertise, in sum. They stay advertised: others may have subscribed to them."""

_LOG_LEVELS = {Severity.DEBUG: 1, Severity.INFO: 2, Severity.WARN: 4, Severity.ERROR: 8, Severity.FATAL: 16}
"""Severity in rosgraph_msgs/Log."""


class Topics:
    """The topics that clients subscribe to."""

    def __init__(self, node: ServedNode, encoder: ThreadPool, limits: Limits, log: Callable[[str], None]) -> None:
        """Starts without subscriptions; `log` writes one line about a message that cannot be sent."""
        self._node = node
        self._encoder = encoder
        self._limits = limits
        self._log = log
        self._topics: Dict[str, Topic] = {}
        self._dropped = 0

    @property
    def dropped(self) -> int:
        """Messages that were not sent to any client."""
        return self._dropped + self._node.dropped + sum(topic.dropped for topic in self._topics.values())

    def publish_log(self, line: LogLine) -> None:
        """Publishes a log line on `/rosout`, for a middleware without this topic."""
        rosout = self._topics.get(ROSOUT)
        if rosout is None:
            return
        seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
        header = {"seq": 0, "stamp": {"secs": seconds, "nsecs": nanoseconds}, "frame_id": ""}
        content = {"level": _LOG_LEVELS[line.severity], "name": line.node, "msg": line.text}
        rosout.deliver({"header": header, **content, "file": "", "function": "", "line": 0, "topics": []})

    async def subscribe(self, receiver: Receiver, name: str, type_name: str, options: Optional[Options]) -> None:
        """Sends the messages of a topic to a client as in `options`; with None, no longer.

        Raises MessageError, ConfigError, ServiceError or OSError if the type is not known or is not that of the topic,
        or the middleware does not respond.
        """
        while True:
            topic = self._topics.get(name)
            if topic is None:
                if options is None:
                    return
                known = await self._node.topic_type(name)
                _require_same_type(name, known, type_name)
                topic = await self._typed(Topic(name, self._encoder, self._log, self._limits), known or type_name)
                topic = self._topics.setdefault(name, topic)
            elif options is not None:
                _require_same_type(name, topic.type_name, type_name)
                if type_name and not topic.type_name:
                    await self._typed(topic, type_name)
            async with topic.lock:
                if self._topics.get(name) is topic:
                    await self._set_options(topic, receiver, options)
                    return
            # The last other client left meanwhile and the topic was removed: start again.

    async def _typed(self, topic: Topic, type_name: str) -> Topic:
        topic.serialize = serializer(type_name, await self._node.call(self._node.definition, type_name))
        topic.type_name = type_name
        return topic

    async def _set_options(self, topic: Topic, receiver: Receiver, options: Optional[Options]) -> None:
        topic.set_options(receiver, options)
        try:
            await self._update(topic)
        except Exception:
            topic.set_options(receiver, None)
            raise
        finally:
            if not topic.compressions:
                self._dropped += topic.dropped
                del self._topics[topic.name]

    async def _update(self, topic: Topic) -> None:
        """Subscribes to what the clients of a topic need, and ends what they no longer need."""
        if not self._node.threads and topic.name == ROSOUT and topic.type_name == ROSOUT_TYPE:
            return
        middleware, needed = self._node.middleware, set(topic.compressions)
        if "cbor-raw" in needed and topic.raw is None and self._node.threads:
            topic.native_raw = True  # until it has subscribed, nothing is serialized in its place, as ROS 1 does
            take = self._node.hand_over(lambda message: topic.deliver_raw(message[0]))
            try:
                topic.raw = await self._node.call(middleware.subscribe_raw, topic.name, topic.type_name, take)
            except ConfigError:
                topic.native_raw = False
        ended = []
        if topic.raw is not None and "cbor-raw" not in needed:
            ended.append(topic.raw)
            topic.raw, topic.native_raw = None, False
        if topic.native_raw:
            needed.discard("cbor-raw")
        if needed and topic.messages is None:
            take = self._node.hand_over(topic.deliver)
            topic.messages = await self._node.call(middleware.subscribe, topic.name, topic.type_name, take)
        if not needed and topic.messages is not None:
            ended.append(topic.messages)
            topic.messages = None
        for subscription in ended:
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
        self._readers[topic] = null_reader(type_name, await self._node.call(self._node.definition, type_name))
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
