"""Subscriptions to the server's topics: sent, sent again after a reconnection, and supplied with what arrives.

Several receivers of one topic share one subscription at the server.
"""

from __future__ import annotations

import asyncio
import threading
from typing import Any, Callable, Dict, Mapping, Optional, Protocol, Set, Tuple

from robot_health_monitor.core.errors import LinkError, ServiceError
from robot_health_monitor.core.middleware import canonical_type

from ..protocol import Operation, operations
from .services import Call

_TYPE_PERIOD_S = 1.0
_TYPE_TIMEOUT_S = 5.0


class Receiver(Protocol):
    """Receives the messages of one topic, in the event loop."""

    @property
    def arrivals_only(self) -> bool:
        """True if the messages need not be decoded: only their arrival counts."""

    def deliver(self, message: Mapping[str, Any]) -> None:
        """Called with every message; with an empty one if `arrivals_only` and the message was not decoded."""

    def too_large(self, size_bytes: int) -> None:
        """Called for every message that is above the size limit and was therefore not decoded."""


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
        self._untyped: Set[str] = set()
        """Topics not advertised yet, whose type is unknown: most servers refuse a subscription without a type."""

    def add(self, topic: str, type_name: str, receiver: Receiver) -> None:
        """Subscribes; the type may be empty: the server is then asked for it."""
        with self._lock:
            first = topic not in self._receivers
            self._receivers[topic] = (*self._receivers.get(topic, ()), receiver)
            if first or (type_name and not self._types[topic]):
                self._types[topic] = canonical_type(type_name)
                self._send_subscribe(topic)

    def remove(self, topic: str, receiver: Receiver) -> None:
        """Ends one `add`."""
        with self._lock:
            left = tuple(other for other in self._receivers.get(topic, ()) if other is not receiver)
            if left:
                self._receivers[topic] = left
            elif self._receivers.pop(topic, None) is not None:
                del self._types[topic]
                self._untyped.discard(topic)
                self._send(operations.Unsubscribe(topic, _subscription_id(topic)))

    def send_all(self, compression: str) -> None:
        """Sends every subscription, on a new connection: with `cbor` to this project's server, else with `none`."""
        with self._lock:
            self._compression = compression
            for topic in self._types:
                self._send_subscribe(topic)

    def deliver(self, topic: str, message: Mapping[str, Any]) -> None:
        """Passes a message on to its receivers."""
        self._untyped.discard(topic)
        for receiver in self._receivers.get(topic, ()):
            receiver.deliver(message)

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
        """Asks the server for the types of topics subscribed to without one. Runs until it is cancelled."""
        while True:
            await asyncio.sleep(_TYPE_PERIOD_S)
            if self._untyped:
                topics = tuple(self._untyped)
                await asyncio.gather(*(self._find_type(topic) for topic in topics), return_exceptions=True)

    def _send_subscribe(self, topic: str) -> None:
        type_name = self._types[topic]
        if not type_name and self._compression != "cbor":
            # Only this project's server accepts a topic that does not exist yet without a type.
            self._untyped.add(topic)
            return
        self._untyped.discard(topic)
        self._send(operations.Subscribe(topic, type_name, _subscription_id(topic), compression=self._compression))

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


def _subscription_id(topic: str) -> str:
    return f"subscribe:{topic}"
