"""One connection to a rosbridge server, re-established whenever it ends.

Theory of operation. Every connection begins with everything that was subscribed to. The robot is only read: nothing is
published or offered there.

    runtime/bridge/connection.py   connecting, reading, delays
    subscriptions.py               where a subscription is sent, and where its messages arrive

This project's client and server use CBOR in both directions (they agree on it as a WebSocket subprotocol), which keeps
NaN and infinities. With other servers it is JSON, where both are null.
"""

from __future__ import annotations

import functools
from typing import Any, Awaitable

from ...core.port import Severity
from ...core.values import JsonObject, LinkError, printable
from ...runtime.bridge.connection import LONGEST_TEXT, BridgeConnection
from ...runtime.bridge.websocket import Wire
from ...runtime.event_loops import run_in_daemon_thread
from ..calls import PendingCalls
from ..protocol import CBOR_SUBPROTOCOL, DEFAULT_LIMITS, SUBPROTOCOLS, Limits, decode, encode, read_operation
from ..protocol.codec import HEAD_BYTES, serialized_publication, topic_of_message
from ..protocol.operations import ServiceResponse
from .subscriptions import Subscriptions

_LARGE_CBOR_BYTES = 65_536


class ServerConnection(BridgeConnection):
    """A connection to one rosbridge server, kept up."""

    subprotocols = SUBPROTOCOLS
    server_kind = "rosbridge server"

    def __init__(self, url: str, *, limits: Limits = DEFAULT_LIMITS, **options: Any) -> None:
        """Creates a connection that is down, with the `options` of `BridgeConnection`; `run` connects.

        `limits` are for messages that are decoded; of larger ones only the arrival counts.
        """
        super().__init__(url, **options)
        self._calls = PendingCalls()
        self.receivers = self.subscriptions = Subscriptions(self.send, self.call, self.run_in_loop)
        self.tasks.append(self.subscriptions.find_types)
        self.limits = limits
        """Bounds for messages that are decoded."""
        self._compression = "none"

    def send(self, operation: JsonObject) -> None:
        """Sends an operation; raises MessageError if it cannot be encoded.

        Drops it while the connection is down: after a reconnection, every subscription is sent again.
        """
        if self.up:
            self.send_wire(encode(operation, self._compression))

    async def call(self, service: str, request: JsonObject, timeout_s: float) -> JsonObject:
        """Returns the response of a service of the server; called in the event loop.

        Raises LinkError if the connection is or went down, and ServiceError if the service failed, or did not respond
        within `timeout_s`.
        """
        if not self.up:
            raise LinkError(f"{service} was not called: no connection to {self.address}")
        values = await self._calls.call(self.send, None, service, request, timeout_s)
        return values if isinstance(values, dict) else {}

    def _begin(self, subprotocol: str | None) -> bool:
        self._compression = "cbor" if subprotocol == CBOR_SUBPROTOCOL else "none"
        self.subscriptions.send_all(self._compression)
        return True

    def _went_down(self) -> None:
        self._calls.fail(LinkError(f"the connection to {self.address} went down"))

    def _receive(self, data: Wire) -> Awaitable[None] | None:
        if type(data) is bytes and self._receive_serialized(data):
            return None
        if len(data) > HEAD_BYTES:
            if self._receive_undecoded(data):
                return None
            if type(data) is bytes and len(data) > _LARGE_CBOR_BYTES:
                return self._receive_large(data)
        self._process(decode(data, self.limits))
        return None

    async def _receive_large(self, data: Wire) -> None:
        """Decodes in a thread: CBOR takes up to a second per megabyte."""
        self._process(await run_in_daemon_thread(functools.partial(decode, data, self.limits)))

    def _process(self, fields: dict[str, Any]) -> None:
        topic, message = fields.get("topic"), fields.get("msg")
        if fields.get("op") == "publish" and type(topic) is str and type(message) is dict:
            self.subscriptions.deliver(topic, message)  # by far the most frequent
            return
        operation = read_operation(fields)
        if isinstance(operation, ServiceResponse):
            reason = printable(str(operation.values)[:LONGEST_TEXT])
            self._calls.receive(operation, None, f"{printable(operation.service)} failed: {reason}")

    def _receive_serialized(self, data: bytes) -> bool:
        """Passes a serialized message on; returns False if it is none."""
        publication = serialized_publication(data) if self.subscriptions.has_bytes else None
        if publication is not None:
            self.subscriptions.deliver_bytes(*publication)
        return publication is not None

    def _receive_undecoded(self, data: Wire) -> bool:
        """Counts the arrival of a large message; returns False if it has to be decoded."""
        topic = topic_of_message(data)
        too_large = len(data) > self.limits.message_bytes
        if topic is not None and (too_large or self.subscriptions.arrivals_only(topic)):
            self.subscriptions.deliver_undecoded(topic, len(data))
            return True
        if too_large:
            sizes = f"{len(data) / 1e6:.1f} MB (limit {self.limits.message_bytes / 1e6:.1f} MB)"
            self._log.write("too large", Severity.WARN, f"dropped a message from {self.address}: {sizes}")
        return too_large
