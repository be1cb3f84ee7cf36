"""One client of the server: its subscriptions, topics, services and pending calls."""

from __future__ import annotations

import asyncio
from typing import Any

from ...core.values import ConfigError, JsonObject, MessageError, ServiceError
from ...runtime.access import matches
from ..protocol import CBOR_COMPRESSIONS, CBOR_PROBLEM, Id, Wire, decode, encode, operations, read_operation
from .rosapi import SERVICES
from .sending import LARGE_BYTES, ClientQueue, estimated_bytes, frame
from .served_node import ServedNode
from .services import Services
from .topics import Topics, merge

_FAILURES = (ServiceError, MessageError, ConfigError, OSError)
"""What an operation may fail with."""
_ABORTED = 6
"""STATUS_ABORTED of action_msgs/GoalStatus."""
_LARGE_RECEIVED_BYTES = 10_000
"""Longer messages are decoded in a thread."""


class Session:
    """The server's side of one connection. Used in the event loop only."""

    def __init__(
        self,
        node: ServedNode,
        topics: Topics,
        services: Services,
        transport: asyncio.WriteTransport,
        *,
        cbor: bool = False,
    ) -> None:
        """Starts a session over `transport`; with `cbor`, every operation is sent as CBOR."""
        self._node = node
        self._topics = topics
        self._services = services
        self._limits = limits = node.limits
        self.queue = ClientQueue(transport, limits.queue_bytes)
        self._transport = transport
        self._compression = "cbor" if cbor else "none"
        self._level = "none"
        self._closed = False
        self._cut_off: asyncio.TimerHandle | None = None
        """Disconnects a client that is behind."""
        self._reported = 0
        """Dropped messages that were reported to the client."""
        self._subscriptions: dict[str, dict[Id, operations.Subscribe]] = {}
        self._advertised: set[str] = set()
        self._provided: set[str] = set()
        self._calls: set[asyncio.Task[None]] = set()

    async def receive(self, data: Wire) -> None:
        """Takes one message of the client. No message ends the session."""
        name, id = "", None  # noqa: A001 - the protocol's word
        try:
            is_large = len(data) > _LARGE_RECEIVED_BYTES
            fields = await self._node.codec.run(decode, data, self._limits) if is_large else decode(data, self._limits)
            id = fields.get("id")  # noqa: A001
            operation = read_operation(fields)
            if operation is not None:
                name = fields["op"]
                await getattr(self, f"_{name}")(operation)
        except _FAILURES as error:
            self._send_status("error", f"{name}: {error}" if name else str(error), id)
        except Exception as error:
            self._node.log(f"an operation of a client failed: {type(error).__name__}: {error}")
            self._send_status("error", "internal error")

    def put(self, frame: bytes) -> None:
        """Sends a frame or queues it."""
        if self._closed or self._transport.is_closing():
            return
        if self.queue.put(frame) and self._cut_off is None:
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
            self._send_status("warning", f"{count} messages were dropped: this client reads too slowly")

    def send(self, operation: JsonObject) -> None:
        """Sends an operation in the client's own encoding; raises MessageError if it cannot be encoded."""
        self.put(frame(encode(operation, self._compression)))

    def _send_status(self, level: str, text: str, id: object = None) -> None:  # noqa: A002 - the protocol's word
        """Sends a `status` if the client requested this level: other clients treat it as an error."""
        levels = operations.STATUS_LEVELS
        if levels.index(level) <= levels.index(self._level):
            status = {"op": "status", "level": level, "msg": text}
            self.send(_with_id(status, id if isinstance(id, (str, int)) else None))

    async def close(self) -> None:
        """Ends everything that the client has requested."""
        self._closed = True
        self.queue.clear()
        if self._cut_off is not None:
            self._cut_off.cancel()
        for call in tuple(self._calls):
            call.cancel()
        for service in self._provided:
            self._services.remove(service, self)
        for topic in tuple(self._subscriptions):
            del self._subscriptions[topic]
            try:
                await self._topics.subscribe(self, topic, "", None)
            except Exception as error:
                self._node.log(f"unsubscribing from {topic} failed: {error}")

    async def _subscribe(self, request: operations.Subscribe) -> None:
        requests = self._subscriptions.get(request.topic, {})
        limit = self._limits.subscriptions
        if sum(map(len, self._subscriptions.values())) >= limit and request.id not in requests:
            raise MessageError(f"more than {limit} subscriptions")
        if CBOR_PROBLEM and request.compression in CBOR_COMPRESSIONS:
            raise MessageError(f"compression {request.compression}: {CBOR_PROBLEM}")
        every = {**requests, request.id: request}
        await self._topics.subscribe(self, request.topic, request.type, merge(every.values()))
        self._subscriptions[request.topic] = every

    async def _unsubscribe(self, request: operations.Unsubscribe) -> None:
        requests = self._subscriptions.pop(request.topic, {})
        requests.pop(request.id, None)
        if requests and request.id is not None:
            self._subscriptions[request.topic] = requests
            await self._topics.subscribe(self, request.topic, "", merge(requests.values()))
        else:
            await self._topics.subscribe(self, request.topic, "", None)

    async def _advertise(self, request: operations.Advertise) -> None:
        if request.topic not in self._advertised:
            self._require_room()
        await self._topics.advertise(request.topic, request.type)
        self._advertised.add(request.topic)

    async def _unadvertise(self, request: operations.Unadvertise) -> None:
        self._advertised.discard(request.topic)

    async def _publish(self, request: operations.Publish) -> None:
        if request.topic not in self._advertised:
            await self._advertise(operations.Advertise(request.topic, ""))
        await self._topics.publish(request.topic, request.msg)

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
            values = await self._services.call(request.service, request.args, request.timeout)
            await self._respond(request, values, result=True)
        except Exception as error:
            if not isinstance(error, _FAILURES):
                self._node.log(f"a service call of a client failed: {type(error).__name__}: {error}")
            await self._respond(request, str(error) or type(error).__name__, result=False)

    async def _respond(self, request: operations.CallService, values: object, *, result: bool) -> None:
        response = {"op": "service_response", "service": request.service, "values": values, "result": result}
        fields = _with_id(response, request.id)
        if estimated_bytes(values) > LARGE_BYTES:
            self.put(frame(await self._node.codec.run(encode, fields, self._compression)))
        else:
            self.send(fields)

    async def _advertise_service(self, request: operations.AdvertiseService) -> None:
        self._require_room()
        service = self._node.resolve(request.service)
        if not matches(service, self._node.access.offer):
            raise ServiceError(f"clients may not provide {service}")
        if service in {**(await self._node.call(self._node.middleware.graph)).services, **SERVICES}:
            raise ServiceError(f"{service} exists already")
        self._services.add(service, request.type, self)
        self._provided.add(service)

    async def _unadvertise_service(self, request: operations.UnadvertiseService) -> None:
        service = self._node.resolve(request.service)
        self._provided.discard(service)
        self._services.remove(service, self)

    async def _service_response(self, response: operations.ServiceResponse) -> None:
        self._services.pending.receive(response, self, str(response.values))

    async def _set_level(self, request: operations.SetLevel) -> None:
        self._level = request.level

    async def _send_action_goal(self, request: operations.SendActionGoal) -> None:
        result = {"values": "actions are not supported", "status": _ABORTED, "result": False}
        self.send(_with_id({"op": "action_result", "action": request.action, **result}, request.id))

    def _require_room(self) -> None:
        limit = self._limits.advertisements
        if len(self._advertised) + len(self._provided) >= limit:
            raise MessageError(f"more than {limit} topics and services")


def _with_id(fields: dict[str, Any], id: Id) -> JsonObject:  # noqa: A002 - the protocol's word
    return fields if id is None else {**fields, "id": id}
