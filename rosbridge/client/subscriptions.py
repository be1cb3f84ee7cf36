"""Subscriptions to the server's topics: sent, sent again after a reconnection, and supplied with what arrives.

Several receivers of one topic share one subscription at the server.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import threading
from typing import Any, Callable, Collection, Dict, Mapping, Optional, Set, Tuple

from ...core.messages.raw_messages import RawFormat, json_format, ros1_format, ros2_format
from ...core.values.errors import LinkError, ServiceError
from ...core.values.names import canonical_type, split_type_name
from ..protocol import Operation, operations
from .receivers import Receiver
from .services import Call
from .topics import find_definition

_OWN = "cbor"
"""The compression by which this project's server is known."""
_SERIALIZED = "cbor-raw"
_TYPE_PERIOD_S = 1.0
_TYPE_TIMEOUT_S = 5.0
_MOST_ASKED = 20
"""Topics whose format the server is asked for at the same time."""


class Subscriptions:
    """The subscriptions of one connection. `add` and `remove` may be called from any thread."""

    def __init__(self, send: Callable[[Operation], None], call: Call) -> None:
        """Starts without subscriptions; `send` drops operations while the connection is down."""
        self._send = send
        self._call = call
        self._lock = threading.RLock()
        self._compression = "none"
        self._types: Dict[str, str] = {}
        self._receivers: Dict[str, Tuple[Receiver, ...]] = {}
        self._wake: Callable[[], None] = _nothing
        self._untyped: Set[str] = set()
        """Topics not advertised yet, whose type is unknown: most servers refuse a subscription without a type."""
        self.formats: Dict[str, RawFormat] = {}
        """The format in which the messages are captured, by topic, as far as it is needed and known."""
        self._definitions: Dict[str, Tuple[str, str]] = {}
        """Type, as the server spells it, and definition of the topics in `formats`."""
        self._sent: Dict[str, str] = {}
        """The compression of each subscription that was sent on this connection."""
        self.has_bytes = False
        """Whether serialized messages may arrive on this connection."""
        self._undefined: Dict[str, None] = {}
        """Topics whose format is needed, and not known on this connection; those asked for longest ago come first."""

    @property
    def topics(self) -> Collection[str]:
        """The topics that are subscribed to."""
        return tuple(self._receivers)

    def add(self, topic: str, type_name: str, receiver: Receiver) -> None:
        """Subscribes; the type may be empty: the server is then asked for it."""
        with self._lock:
            first = topic not in self._receivers
            others = self._receivers.get(topic, ())
            # What is captured comes first: its time must not include that which an alert takes.
            self._receivers[topic] = (receiver, *others) if receiver.needs_format else (*others, receiver)
            if first or (type_name and not self._types[topic]):
                self._types[topic] = canonical_type(type_name)
                self._send_subscribe(topic)
            if receiver.needs_format and topic not in self._definitions:
                self._undefined[topic] = None
                self._wake()
            self._choose_format(topic)

    def remove(self, topic: str, receiver: Receiver) -> None:
        """Ends one `add`."""
        with self._lock:
            left = tuple(other for other in self._receivers.get(topic, ()) if other is not receiver)
            if left:
                self._receivers[topic] = left
                self._choose_format(topic)
            elif self._receivers.pop(topic, None) is not None:
                del self._types[topic]
                self._untyped.discard(topic)
                for known in (self._undefined, self._definitions, self.formats, self._sent):
                    known.pop(topic, None)
                self._send(operations.Unsubscribe(topic, _subscription_id(topic)))

    def send_all(self, compression: str) -> None:
        """Sends every subscription, on a new connection: with `cbor` to this project's server, else with `none`."""
        with self._lock:
            self._compression = compression
            self._sent.clear()
            self.has_bytes = False
            self._definitions.clear()
            self.formats = {topic: found for topic, found in self.formats.items() if not found.profile}
            for topic, receivers in self._receivers.items():
                self._send_subscribe(topic)
                if any(receiver.needs_format for receiver in receivers):
                    self._undefined[topic] = None
            self._wake()

    def deliver(self, topic: str, message: Mapping[str, Any]) -> None:
        """Passes a message on to its receivers."""
        self._untyped.discard(topic)
        for receiver in self._receivers.get(topic, ()):
            receiver.deliver(message)

    def deliver_bytes(self, topic: str, data: bytes) -> None:
        """Passes a serialized message on to its receivers, unless these have just asked for decoded ones."""
        if self._sent.get(topic) == _SERIALIZED:
            for receiver in self._receivers.get(topic, ()):
                receiver.deliver_bytes(data)

    def deliver_undecoded(self, topic: str, size_bytes: int) -> None:
        """Passes on the arrival of a message that was not decoded."""
        self._untyped.discard(topic)
        for receiver in self._receivers.get(topic, ()):
            if receiver.arrivals_only:
                receiver.deliver({})
            else:
                receiver.too_large(size_bytes)

    def arrivals_only(self, topic: str) -> bool:
        """Returns True if no receiver of a topic needs its messages decoded."""
        return all(receiver.arrivals_only for receiver in self._receivers.get(topic, ()))

    async def find_types(self) -> None:
        """Asks the server for the types and formats of topics that lack them. Runs until it is cancelled."""
        woken = asyncio.Event()
        self._wake = functools.partial(_set_threadsafe, asyncio.get_event_loop(), woken)
        while True:
            period_s = _TYPE_PERIOD_S if self._untyped or self._undefined else None
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(woken.wait(), period_s)
            woken.clear()
            untyped, undefined = tuple(self._untyped), tuple(self._undefined)[:_MOST_ASKED]
            asking = [*map(self._find_type, untyped), *map(self._find_format, undefined)]
            await asyncio.gather(*asking, return_exceptions=True)

    def _send_subscribe(self, topic: str) -> None:
        type_name = self._types[topic]
        if not type_name and self._compression != _OWN:
            # Only this project's server accepts a topic that does not exist yet without a type.
            self._untyped.add(topic)
            self._wake()
            return
        self._untyped.discard(topic)
        compression = self._sent[topic] = self._compression_of(topic)
        self.has_bytes = self.has_bytes or compression == _SERIALIZED
        self._send(operations.Subscribe(topic, type_name, _subscription_id(topic), compression=compression))

    def _choose_format(self, topic: str) -> None:
        """Chooses the format in which a topic is captured, and subscribes again if it is transported otherwise.

        Bytes only from this project's server: rosbridge_suite has one subscription for all its clients, and while one
        of them receives bytes, the others receive nothing (RobotWebTools/rosbridge_suite#610).
        """
        receivers = self._receivers[topic]
        if not any(receiver.needs_format for receiver in receivers):
            self.formats.pop(topic, None)
        elif topic in self._definitions:
            type_name, definition = self._definitions[topic]
            raw = (ros2_format if "/msg/" in type_name else ros1_format)(type_name, definition)
            has_raw = self._compression == _OWN and bool(definition)
            is_raw = has_raw and all(receiver.takes_bytes(raw) for receiver in receivers)
            self.formats[topic] = raw if is_raw else json_format(type_name, definition)
        if topic in self._sent and self._sent[topic] != self._compression_of(topic):
            self._send_subscribe(topic)

    def _compression_of(self, topic: str) -> str:
        raw_format = self.formats.get(topic)
        return _SERIALIZED if raw_format is not None and raw_format.profile else self._compression

    async def _find_type(self, topic: str) -> None:
        found: Optional[object] = None
        try:
            found = (await self._call("/rosapi/topic_type", {"topic": topic}, _TYPE_TIMEOUT_S)).get("type")
        except LinkError:
            return
        except ServiceError:
            # A server without rosapi. It accepts a subscription without a type once the topic exists.
            self._send(operations.Subscribe(topic, "", _subscription_id(topic)))
        with self._lock:
            if isinstance(found, str) and found and topic in self._untyped:
                self._types[topic] = canonical_type(found)
                self._send_subscribe(topic)

    async def _find_format(self, topic: str) -> None:
        type_name = self._types.get(topic, "")
        definition: Optional[str] = None
        try:
            found = (await self._call("/rosapi/topic_type", {"topic": topic}, _TYPE_TIMEOUT_S)).get("type")
            type_name = found if isinstance(found, str) and split_type_name(found) else type_name
            if type_name:
                definition = await find_definition(self._call, type_name)
        except LinkError:
            return
        except ServiceError:
            definition = ""  # a server without rosapi, or one that does not know the type
        with self._lock:
            if topic not in self._undefined:
                return  # no longer needed
            del self._undefined[topic]
            if definition is None:
                self._undefined[topic] = None
            else:
                self._definitions[topic] = type_name, definition
                self._types[topic] = self._types[topic] or canonical_type(type_name)
                self._choose_format(topic)


def _set_threadsafe(loop: asyncio.AbstractEventLoop, event: asyncio.Event) -> None:
    with contextlib.suppress(RuntimeError):  # the loop has ended
        loop.call_soon_threadsafe(event.set)


def _nothing() -> None:
    """Wakes nothing."""


def _subscription_id(topic: str) -> str:
    return f"subscribe:{topic}"
