"""One client of the server: its subscriptions, topics, services and pending calls."""

from __future__ import annotations

import asyncio
import functools
from typing import Dict, Optional, Set

from ...core.values.errors import ConfigError, MessageError, ServiceError
from ..protocol import CBOR_PROBLEM, Connection, Id, Operation, ProtocolError, Wire, operations
from .access import matches
from .rosapi import SERVICES
from .sending import LARGE_BYTES, ClientQueue, estimated_bytes, frame
from .served_node import ServedNode
from .services import Services
from .topics import ByteBudget, Topics, merge

_NO_STATUS = operations.STATUS_LEVELS.index("none")
_FAILURES = (ServiceError, MessageError, ConfigError, OSError)
"""What an operation may fail with."""
_ABORTED = 6
"""STATUS_ABORTED of action_msgs/GoalStatus."""
_LARGE_RECEIVED_BYTES = 10_000
"""Longer messages are decoded in a thread."""


class ServerParts:
    """The parts of the server that sessions use."""

    def __init__(self, node: ServedNode) -> None:
        """Starts without clients. Called in the event loop."""
        self.node = node
        self.topics = Topics(node)
        self.services = Services(node)


class Session:
    """The server's side of one connection. Used in the event loop only."""

    def __init__(self, parts: ServerParts, transport: asyncio.WriteTransport, *, cbor: bool = False) -> None:
        """Starts a session over `transport`; with `cbor`, every operation is sent as CBOR."""
        self._parts = parts
        self._node = parts.node
        self._limits = limits = parts.node.limits
        self.queue = ClientQueue(transport, limits.queue_bytes)
        self.throttled = ByteBudget(limits.queue_bytes)
        self._transport = transport
        self._connection = Connection(limits)
        self._compression = "cbor" if cbor else "none"
        self._level = _NO_STATUS
        self._closed = False
        self._cut_off: Optional[asyncio.TimerHandle] = None
        """Disconnects a client that is behind."""
        self._reported = 0
        """Dropped messages that were reported to the client."""
        self._subscriptions: Dict[str, Dict[Id, operations.Subscribe]] = {}
        self._advertised: Set[str] = set()
        self._provided: Set[str] = set()
        self._calls: Set[asyncio.Task[None]] = set()

    def read_auth(self, data: Wire) -> Optional[operations.Auth]:
        """Returns the operation `auth` in the first message of a client; None if it is another message."""
        if not isinstance(data, str) or len(data) > self._limits.first_message_bytes:
            return None
        try:
            operation = self._connection.receive(data, 0.0)
        except ProtocolError:
            return None
        return operation if isinstance(operation, operations.Auth) else None

    async def receive(self, data: Wire) -> None:
        """Takes one message of the client. No message ends the session."""
        operation: Optional[Operation] = None
        try:
            operation = await self._decode(data)
            if operation is not None:
                # `status`, `auth` and `action_result` need no action.
                handler = getattr(self, f"_{operations.name_of(operation)}", None)
                if handler is not None:
                    await handler(operation)
        except _FAILURES as error:
            text = str(error) if operation is None else f"{operations.name_of(operation)}: {error}"
            self.send_status("error", text, getattr(operation or error, "id", None))
        except Exception as error:
            self._node.log(f"an operation of a client failed: {type(error).__name__}: {error}")
            self.send_status("error", "internal error")

    def put(self, frames: bytes) -> None:
        """Sends frames or queues them."""
        if self._closed or self._transport.is_closing():
            return
        if self.queue.put(frames) and self._cut_off is None:
            timeout_s = self._limits.slow_client_timeout_s
            self._cut_off = asyncio.get_event_loop().call_later(timeout_s, self._disconnect)

    def _disconnect(self) -> None:
        self._node.log(f"disconnected a client: behind for more than {self._limits.slow_client_timeout_s:g} s")
        self._transport.abort()

    def resume(self) -> None:
        """Sends what waits, and how many messages were dropped, once the client reads again."""
        self.queue.flush()
        if self._cut_off is None or self.queue.behind:
            return
        self._cut_off.cancel()
        self._cut_off = None
        count, self._reported = self.queue.dropped - self._reported, self.queue.dropped
        if count:
            self.send_status("warning", f"{count} messages were dropped: this client reads too slowly")

    def send(self, operation: Operation) -> None:
        """Sends an operation in the client's own encoding; raises MessageError if it cannot be encoded."""
        for wire in self._connection.send(operation, compression=self._compression):
            self.put(frame(wire))

    def send_status(self, level: str, text: str, id: Id = None) -> None:  # noqa: A002 - the protocol's word
        """Sends a `status` if the client requested this level: other clients treat it as an error."""
        if operations.STATUS_LEVELS.index(level) <= self._level:
            self.send(operations.Status(level, text, id))

    async def close(self) -> None:
        """Ends everything that the client has requested."""
        self._closed = True
        self.queue.clear()
        if self._cut_off is not None:
            self._cut_off.cancel()
        for call in tuple(self._calls):
            call.cancel()
        for service in self._provided:
            self._parts.services.remove(service, self)
        for topic in tuple(self._subscriptions):
            del self._subscriptions[topic]
            try:
                await self._parts.topics.subscribe(self, topic, "", None)
            except _FAILURES as error:
                self._node.log(f"unsubscribing from {topic} failed: {error}")

    async def _decode(self, data: Wire) -> Optional[Operation]:
        now_s = asyncio.get_event_loop().time()
        if len(data) + self._connection.reassembly.chars <= _LARGE_RECEIVED_BYTES:
            return self._connection.receive(data, now_s)
        return await self._node.codec.run(self._connection.receive, data, now_s)

    async def _subscribe(self, request: operations.Subscribe) -> None:
        requests = self._subscriptions.get(request.topic, {})
        limit = self._limits.subscriptions
        if sum(map(len, self._subscriptions.values())) >= limit and request.id not in requests:
            raise MessageError(f"more than {limit} subscriptions")
        if CBOR_PROBLEM and request.compression in ("cbor", "cbor-raw"):
            raise MessageError(f"compression {request.compression}: {CBOR_PROBLEM}")
        every = {**requests, request.id: request}
        await self._parts.topics.subscribe(self, request.topic, request.type, merge(every.values(), self._limits))
        self._subscriptions[request.topic] = every
        self.send_status("info", f"subscribed to {request.topic}", request.id)

    async def _unsubscribe(self, request: operations.Unsubscribe) -> None:
        requests = self._subscriptions.get(request.topic)
        if requests is None:
            self.send_status("warning", f"{request.topic} is not subscribed to", request.id)
            return
        if request.id is None:
            requests.clear()
        requests.pop(request.id, None)
        if not requests:
            del self._subscriptions[request.topic]
        merged = merge(requests.values(), self._limits) if requests else None
        await self._parts.topics.subscribe(self, request.topic, "", merged)

    async def _advertise(self, request: operations.Advertise) -> None:
        await self._open(request.topic, request.type)

    async def _open(self, topic: str, type_name: str = "") -> None:
        if topic not in self._advertised:
            self._require_room()
        await self._parts.topics.advertise(topic, type_name)
        self._advertised.add(topic)

    async def _unadvertise(self, request: operations.Unadvertise) -> None:
        if request.topic not in self._advertised:
            self.send_status("warning", f"{request.topic} is not advertised", request.id)
        self._advertised.discard(request.topic)

    async def _publish(self, request: operations.Publish) -> None:
        if request.topic not in self._advertised:
            await self._open(request.topic)
        await self._parts.topics.publish(request.topic, request.msg)

    async def _call_service(self, request: operations.CallService) -> None:
        if len(self._calls) >= self._limits.calls:
            await self._respond(request, f"more than {self._limits.calls} calls are pending", result=False)
            return
        # Not awaited: a slow service must not delay other messages of the client.
        call = asyncio.ensure_future(self._call(request))
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)

    async def _call(self, request: operations.CallService) -> None:
        try:
            values = await self._parts.services.call(request.service, request.args, request.timeout)
            await self._respond(request, values, result=True)
        except Exception as error:
            if not isinstance(error, _FAILURES):
                self._node.log(f"a service call of a client failed: {type(error).__name__}: {error}")
            await self._respond(request, str(error) or type(error).__name__, result=False)

    async def _respond(self, request: operations.CallService, values: object, *, result: bool) -> None:
        send = functools.partial(
            self._connection.send,
            operations.ServiceResponse(request.service, values, result, request.id),
            fragment_size=request.fragment_size,
            compression="png" if request.compression == "png" else self._compression,
        )
        wires = await self._node.codec.run(send) if estimated_bytes(values) > LARGE_BYTES else send()
        self.put(b"".join(map(frame, wires)))

    async def _advertise_service(self, request: operations.AdvertiseService) -> None:
        self._require_room()
        service = self._node.resolve(request.service)
        if not matches(service, self._node.access.offer):
            raise ServiceError(f"clients may not provide {service}")
        if service in {**(await self._node.call(self._node.middleware.graph)).services, **SERVICES}:
            raise ServiceError(f"{service} exists already")
        self._parts.services.add(service, request.type, self)
        self._provided.add(service)

    async def _unadvertise_service(self, request: operations.UnadvertiseService) -> None:
        service = self._node.resolve(request.service)
        self._provided.discard(service)
        self._parts.services.remove(service, self)

    async def _service_response(self, response: operations.ServiceResponse) -> None:
        self._parts.services.respond(response, self)

    async def _set_level(self, request: operations.SetLevel) -> None:
        self._level = operations.STATUS_LEVELS.index(request.level)

    async def _send_action_goal(self, request: operations.SendActionGoal) -> None:
        self.send(operations.ActionResult(request.action, "actions are not supported", _ABORTED, False, request.id))

    def _require_room(self) -> None:
        limit = self._limits.advertisements
        if len(self._advertised) + len(self._provided) >= limit:
            raise MessageError(f"more than {limit} topics and services")
