"""Subscriptions to the server's topics: sent, sent again after a reconnection, and supplied with what arrives.

Several receivers of one topic share one subscription at the server.
"""

from __future__ import annotations

import asyncio
import threading
from dataclasses import dataclass
from functools import partial
from typing import Callable, Collection

from ...core.messages import RawFormat, json_format, ros1_format, ros2_format
from ...core.messages import definition as standard_definition
from ...core.values import JsonObject, LinkError, ServiceError, canonical_type, split_type_name
from .receivers import Receiver
from .topics import Call, find_definition

_OWN = "cbor"
"""The compression by which this project's server is known."""
_SERIALIZED = "cbor-raw"
_ASK_PERIOD_S = 1.0
_ASK_TIMEOUT_S = 5.0
_MOST_ASKED = 20
"""Topics of which the server is asked for type and definition at the same time."""


@dataclass(eq=False)
class _Topic:
    """A topic with its receivers, and what is known of it on this connection."""

    name: str
    type_name: str = ""
    """Empty while it is unknown."""
    receivers: tuple[Receiver, ...] = ()
    sent: str = ""
    """Compression of the subscription that was sent; empty while the server has none, or need not have accepted it."""
    definition: tuple[str, str] | None = None
    """The type, as the server spells it, and its definition; None while they are not known."""
    raw_format: RawFormat | None = None
    """The format in which the messages are captured, as far as it is needed and known."""

    @property
    def needs_format(self) -> bool:
        return any(receiver.needs_format for receiver in self.receivers)

    @property
    def lacks(self) -> bool:
        """Whether the server has to be asked for something."""
        return not self.sent or (self.definition is None and self.needs_format)

    def operation(self, compression: str = "none") -> JsonObject:
        """Returns what subscribes to it."""
        fields = {"op": "subscribe", "topic": self.name, "id": f"subscribe:{self.name}", "compression": compression}
        return {**fields, "type": self.type_name} if self.type_name else fields


class Subscriptions:
    """The subscriptions of one connection. `add` and `remove` may be called from any thread."""

    def __init__(
        self,
        send: Callable[[JsonObject], None],
        call: Call,
        run_in_loop: Callable[[Callable[[], object]], None],
    ) -> None:
        """Starts without subscriptions; `send` drops operations while the connection is down."""
        self._send = send
        self._call = call
        self._run_in_loop = run_in_loop
        self._lock = threading.RLock()
        self._compression = "none"
        self._topics: dict[str, _Topic] = {}
        self._wake: Callable[[], object] = bool  # does nothing
        self.has_bytes = False
        """Whether serialized messages may arrive on this connection."""

    @property
    def topics(self) -> Collection[str]:
        """The topics that are subscribed to."""
        return tuple(self._topics)

    def add(self, receiver: Receiver) -> None:
        """Subscribes to the topic of a receiver; the server is asked for the type if that is empty."""
        with self._lock:
            known = self._topics.setdefault(receiver.topic, _Topic(receiver.topic))
            others = known.receivers
            # What is captured comes first: its time must not include that which an alert takes.
            known.receivers = (receiver, *others) if receiver.needs_format else (*others, receiver)
            if not others or (receiver.type_name and not known.type_name):
                known.type_name = receiver.type_name
                self._subscribe(known)
            self._choose_format(known)
            self._wake()

    def remove(self, receiver: Receiver) -> None:
        """Ends one `add`."""
        with self._lock:
            known = self._topics.get(receiver.topic)
            if known is None:
                return
            known.receivers = tuple(other for other in known.receivers if other is not receiver)
            if known.receivers:
                self._choose_format(known)
            else:
                del self._topics[known.name]
                self._send({"op": "unsubscribe", "topic": known.name, "id": f"subscribe:{known.name}"})

    def send_all(self, compression: str) -> None:
        """Sends every subscription, on a new connection: with `cbor` to this project's server, else with `none`."""
        with self._lock:
            self._compression = compression
            self.has_bytes = False
            for topic in self._topics.values():
                topic.sent, topic.definition = "", None
                if topic.raw_format is not None and topic.raw_format.profile:
                    topic.raw_format = None
                self._subscribe(topic)
            self._wake()

    def format_of(self, topic: str) -> RawFormat | None:
        """Returns the format in which the messages of a topic are captured; None if it is not known yet."""
        known = self._topics.get(topic)
        return None if known is None else known.raw_format

    def deliver(self, topic: str, message: JsonObject) -> None:
        """Passes a message on to its receivers."""
        for receiver in self._hear(topic):
            receiver.deliver(message)

    def deliver_bytes(self, topic: str, data: bytes) -> None:
        """Passes a serialized message on to its receivers, unless these have just asked for decoded ones."""
        known = self._topics.get(topic)
        if known is not None and known.sent == _SERIALIZED:
            for receiver in known.receivers:
                receiver.deliver_bytes(data)

    def deliver_undecoded(self, topic: str, size_bytes: int) -> None:
        """Passes on the arrival of a message that was not decoded."""
        for receiver in self._hear(topic):
            if receiver.arrivals_only:
                receiver.deliver({})
            else:
                receiver.too_large(size_bytes)

    def arrivals_only(self, topic: str) -> bool:
        """Returns True if no receiver of a topic needs its messages decoded."""
        return all(receiver.arrivals_only for receiver in self._hear(topic))

    async def find_types(self) -> None:
        """Asks the server for the types and definitions of topics that lack them. Runs until it is cancelled."""
        woken = asyncio.Event()
        self._wake = partial(self._run_in_loop, woken.set)
        while True:
            woken.clear()
            lacking = [topic for topic in tuple(self._topics.values()) if topic.lacks]
            for start in range(0, len(lacking), _MOST_ASKED):
                await asyncio.gather(*map(self._ask, lacking[start : start + _MOST_ASKED]), return_exceptions=True)
            await (asyncio.sleep(_ASK_PERIOD_S) if lacking else woken.wait())

    def _hear(self, topic: str) -> tuple[Receiver, ...]:
        """Returns the receivers of a topic of which a message came: the server has accepted the subscription."""
        known = self._topics.get(topic)
        if known is None:
            return ()
        known.sent = known.sent or self._compression
        return known.receivers

    def _subscribe(self, topic: _Topic) -> None:
        # Only this project's server accepts a topic that does not exist yet without a type.
        if topic.type_name or self._compression == _OWN:
            topic.sent = self._compression_of(topic)
            self.has_bytes = self.has_bytes or topic.sent == _SERIALIZED
            self._send(topic.operation(topic.sent))

    def _choose_format(self, topic: _Topic) -> None:
        """Chooses the format in which a topic is captured, and subscribes again if it is transported otherwise.

        Bytes only from this project's server: rosbridge_suite has one subscription for all its clients, and while one
        of them receives bytes, the others receive nothing (RobotWebTools/rosbridge_suite#610).
        """
        if not topic.needs_format:
            topic.raw_format = None
        elif topic.definition is not None:
            type_name, definition = topic.definition
            raw = (ros2_format if "/msg/" in type_name else ros1_format)(type_name, definition)
            is_raw = bool(definition) and all(receiver.takes_bytes(raw) for receiver in topic.receivers)
            topic.raw_format = raw if is_raw else json_format(type_name, definition or standard_definition(type_name))
        if topic.sent not in ("", self._compression_of(topic)):
            self._subscribe(topic)

    def _compression_of(self, topic: _Topic) -> str:
        return _SERIALIZED if topic.raw_format is not None and topic.raw_format.profile else self._compression

    async def _ask(self, topic: _Topic) -> None:
        """Asks for the type of a topic and, if it is captured, for its definition."""
        type_name = topic.type_name
        definition: str | None = None
        try:
            answer = (await self._call("/rosapi/topic_type", {"topic": topic.name}, _ASK_TIMEOUT_S)).get("type")
            type_name = answer if isinstance(answer, str) and split_type_name(answer) else type_name
            if type_name and topic.needs_format:
                definition = await find_definition(self._call, type_name) if self._compression == _OWN else ""
        except LinkError:
            return
        except ServiceError:  # a server without rosapi, or one that does not know the type
            definition = ""
        with self._lock:
            if self._topics.get(topic.name) is not topic:
                return  # no longer needed
            topic.type_name = topic.type_name or canonical_type(type_name)
            if not topic.sent:
                self._subscribe(topic)
            if not topic.sent and definition is not None:
                self._send(topic.operation())  # without rosapi: it is accepted once the topic exists
            if topic.needs_format and definition is not None:
                topic.definition = type_name, definition
                self._choose_format(topic)
