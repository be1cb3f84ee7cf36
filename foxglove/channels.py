"""What a server offers, and the subscriptions to it. Only channels of topics that are watched are subscribed to."""

from __future__ import annotations

import itertools
import threading
from typing import Callable, Iterable, Mapping, Protocol, Sequence

from ..core.messages import SerializedType
from ..core.port import explain, similar_topic
from ..core.values import printable
from .protocol import LARGEST_ID, Channel, subscribe, unsubscribe

MOST_CHANNELS = 10_000
"""Of one server; further ones are not known."""
MOST_OF_TOPIC = 100
"""Channels of one topic; further ones are not known. A bridge has one, other servers one per publisher."""
_MOST_SCHEMA_CHARS = 20_000_000
"""Characters of all different schemas of a server; of further ones nothing is read."""


class Receiver(Protocol):
    """Receives the messages of one topic, in the event loop."""

    topic: str
    is_raw: bool
    """Whether it takes the messages as bytes, for a capture."""

    def bind(self, channel: Channel, messages: SerializedType) -> Callable[[bytes], None] | None:
        """Returns what is called with each message of a channel; None if it cannot read them, after one log line."""


class Channels:
    """The channels of one connection, and who receives their messages. `add` and `remove` may be called anywhere."""

    def __init__(self, send: Callable[[str], None], warn: Callable[[str], object]) -> None:
        """Knows no channel; `send` drops messages while the connection is down."""
        self._send = send
        self._warn = warn
        self._lock = threading.RLock()
        self._receivers: dict[str, list[Receiver]] = {}
        self._channels: dict[int, Channel] = {}
        self._by_topic: dict[str, list[int]] = {}
        self._schemas: dict[str, str] = {}
        self._schema_chars = 0
        self._subscribed: dict[int, int] = {}
        """Subscription by channel."""
        self._delivered: dict[int, tuple[Callable[[bytes], None], ...]] = {}
        """What is called with each message, by subscription."""
        self._ids = itertools.count()

    def end(self) -> None:
        """Forgets what the server offered, when a connection has ended; what is received stays."""
        with self._lock:
            for known in (self._channels, self._by_topic, self._schemas, self._subscribed, self._delivered):
                known.clear()
            self._schema_chars = 0

    def add(self, receiver: Receiver) -> None:
        """Passes the messages of a topic on, from now and after every reconnection."""
        with self._lock:
            receivers = self._receivers.setdefault(receiver.topic, [])
            # What is captured comes first: its time must not include that which an alert takes.
            receivers.insert(0 if receiver.is_raw else len(receivers), receiver)
            self._update(receiver.topic)

    def remove(self, receiver: Receiver) -> None:
        """Ends an `add`."""
        with self._lock:
            receivers = self._receivers.get(receiver.topic, [])
            if receiver in receivers:
                receivers.remove(receiver)
                self._update(receiver.topic)

    def advertise(self, channels: Iterable[Channel]) -> None:
        """Takes channels that the server offers; one with a known id replaces that one."""
        with self._lock:
            for channel in channels:
                if channel.id in self._channels:
                    self.unadvertise([channel.id])
                if len(self._channels) >= MOST_CHANNELS:
                    self._warn(f"the server offers more than {MOST_CHANNELS} channels; further ones are not watched")
                    return
                of_topic = self._by_topic.setdefault(channel.topic, [])
                if len(of_topic) >= MOST_OF_TOPIC:
                    self._warn(f"the server offers more than {MOST_OF_TOPIC} channels of one topic")
                    continue
                self._channels[channel.id] = self._with_known_schema(channel)
                of_topic.append(channel.id)
                self._serve(channel.id)

    def unadvertise(self, channel_ids: Sequence[int]) -> None:
        """Forgets channels that the server no longer offers."""
        with self._lock:
            for id in channel_ids:  # noqa: A001 - the protocol's own word
                channel = self._channels.pop(id, None)
                if channel is None:
                    continue
                self._by_topic[channel.topic].remove(id)
                if not self._by_topic[channel.topic]:
                    del self._by_topic[channel.topic]
                self._unsubscribe(id)

    def deliver(self, subscription: int, data: bytes) -> None:
        """Passes a message on to those who read it; a subscription that has ended is ignored."""
        for take in self._delivered.get(subscription, ()):
            take(data)

    def topics(self) -> Mapping[str, Channel]:
        """Returns a channel of each topic that the server offers."""
        with self._lock:
            return {topic: self._channels[ids[0]] for topic, ids in self._by_topic.items()}

    def why_silent(self, topic: str, type_name: str) -> str | None:
        """Returns why a topic brings no samples, None if nothing is known; see `core/port/hints.py`."""
        with self._lock:
            offered = [self._channels[id] for id in self._by_topic.get(topic, ())]  # noqa: A001
        published = {name: channel.raw_format.type_name for name, channel in self.topics().items()}
        problems = [channel.problem for channel in offered]
        if offered and all(problems):
            return printable(problems[0])
        similar = similar_topic(topic, type_name, published)
        return explain(topic, type_name, [channel.raw_format.type_name for channel in offered], similar=similar)

    def _with_known_schema(self, channel: Channel) -> Channel:
        """Returns a channel whose schema is one object for all that have it; empty once they take too much memory."""
        schema = channel.raw_format.schema
        text = self._schemas.get(schema)
        if text is None and self._schema_chars + len(schema) > _MOST_SCHEMA_CHARS:
            self._warn("the server's schemas take too much memory; some messages cannot be read")
            text = ""
        elif text is None:
            text = self._schemas[schema] = schema
            self._schema_chars += len(text)
        return channel._replace(raw_format=channel.raw_format._replace(schema=text))

    def _update(self, topic: str) -> None:
        for channel_id in self._by_topic.get(topic, ()):
            self._serve(channel_id)

    def _serve(self, channel_id: int) -> None:
        """Subscribes to a channel, or ends that; binds those who read it."""
        channel = self._channels[channel_id]
        receivers = [] if channel.problem else self._receivers.get(channel.topic, [])
        messages = SerializedType(channel.topic, channel.raw_format)
        bound = (receiver.bind(channel, messages) for receiver in receivers)
        takers = tuple(take for take in bound if take is not None)
        if not takers:
            self._unsubscribe(channel_id)
        elif channel_id in self._subscribed:
            self._delivered[self._subscribed[channel_id]] = takers
        else:
            subscription = self._subscribed[channel_id] = next(self._ids) % LARGEST_ID
            self._delivered[subscription] = takers
            self._send(subscribe(subscription, channel_id))

    def _unsubscribe(self, channel_id: int) -> None:
        subscription = self._subscribed.pop(channel_id, None)
        if subscription is not None:
            del self._delivered[subscription]
            if channel_id in self._channels:
                self._send(unsubscribe(subscription))
