"""One client of the server: what it has asked for, and what it gets."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, Awaitable, Callable, Dict, Mapping, Optional, Set, Type

from robot_health_monitor.core.errors import ServiceError

from .. import protocol
from ..protocol import Connection, Operation, Wire
from ..protocol.definitions import canonical, service_definition
from ..protocol.errors import Id, ProtocolError
from .access import allowed
from .rosapi import PREFIX
from .send_queue import Outbox
from .subscriptions import Options, merge, options_of

if TYPE_CHECKING:
    from .server import Server

_NO_STATUS = protocol.STATUS_LEVELS.index("none")
_ABORTED = 6
"""STATUS_ABORTED of action_msgs/GoalStatus."""


class Session:
    """The server's side of one connection. All of it runs in the server's event loop."""

    def __init__(
        self, server: Server, transport: asyncio.WriteTransport, *, authenticated: bool, cbor: bool = False
    ) -> None:
        """Starts a session.

        Args:
            server: whom to ask.
            transport: where frames go.
            authenticated: whether the client has shown the token, or need not.
            cbor: whether the client wants every operation in CBOR.
        """
        self.connection = Connection(server.limits)
        self.transport = transport
        self.outbox = Outbox(transport, server.queue_bytes)
        self.authenticated = authenticated
        self._compression = "cbor" if cbor else "none"
        self._server = server
        self._level = _NO_STATUS
        self._subscriptions: Dict[str, Dict[Id, Options]] = {}
        self._advertised: Dict[str, str] = {}
        self._offered: Set[str] = set()
        self._calls: Set[asyncio.Task[None]] = set()

    async def receive(self, data: Wire) -> None:
        """Takes one message of the client. Whatever it is, the session goes on."""
        try:
            operation = self.connection.receive(data, asyncio.get_event_loop().time())
            if operation is not None:
                await self._handle(operation)
        except ProtocolError as error:
            self.tell("error", str(error), error.id)

    def put(self, frame: bytes) -> None:
        """Sends a frame, or lets it wait its turn."""
        if self.outbox.put(frame):
            self._server.watch(self)

    def send(self, operation: Operation, fragment_size: Optional[int] = None, compression: str = "") -> None:
        """Sends an operation; the compression is the client's own when it is left out."""
        compression = compression or self._compression
        for wire in self.connection.send(operation, fragment_size=fragment_size, compression=compression):
            self.put(self._server.frame_maker.frame(wire))

    def tell(self, level: str, text: str, id: Id = None) -> None:  # noqa: A002 - the protocol's own word
        """Sends a `status` to a client that asked for this level: others treat it as an error of the server."""
        if protocol.STATUS_LEVELS.index(level) <= self._level:
            self.send(protocol.Status(level, text, id))

    def tell_of_losses(self) -> None:
        """Tells a client that reads again how many of its messages were dropped meanwhile."""
        if self.outbox.dropped:
            count, self.outbox.dropped = self.outbox.dropped, 0
            self.tell("warning", f"{count} messages were dropped: this client reads too slowly")

    async def close(self) -> None:
        """Takes back everything that the client has asked for."""
        for call in tuple(self._calls):
            call.cancel()
        for topic in tuple(self._subscriptions):
            del self._subscriptions[topic]
            await self._server.subscribe(self, topic, "", None)
        for service in self._offered:
            self._server.offers.withdraw(service, self)

    async def _handle(self, operation: Operation) -> None:
        if isinstance(operation, protocol.Auth):
            self._authenticate(operation)
            return
        if not self.authenticated:
            raise ProtocolError("this server wants the operation auth first")
        handler = _HANDLERS.get(type(operation))
        if handler is not None:
            await handler(self, operation)

    def _authenticate(self, auth: protocol.Auth) -> None:
        if not self.authenticated and not self._server.access.auth_allowed(auth, time.time()):
            self.tell("error", "auth: refused")
            self._server.log("a client was refused: its operation auth does not prove the token")
            self.transport.abort()
            return
        self.authenticated = True

    async def _subscribe(self, request: protocol.Subscribe) -> None:
        requests = self._subscriptions.get(request.topic, {})
        limits = self.connection.limits
        if sum(map(len, self._subscriptions.values())) >= limits.subscriptions and request.id not in requests:
            raise ProtocolError(f"more than {limits.subscriptions} subscriptions", "subscribe", request.id)
        wanted = self._subscriptions[request.topic] = {**requests, request.id: options_of(request, limits)}
        try:
            await self._server.subscribe(self, request.topic, request.type, merge(wanted.values()))
        except ProtocolError:
            if requests:
                self._subscriptions[request.topic] = requests
            else:
                del self._subscriptions[request.topic]
            raise
        self.tell("info", f"subscribed to {request.topic}", request.id)

    async def _unsubscribe(self, request: protocol.Unsubscribe) -> None:
        requests = self._subscriptions.get(request.topic)
        if requests is None:
            self.tell("warning", f"{request.topic} is not subscribed to", request.id)
            return
        if request.id is None:
            requests.clear()
        requests.pop(request.id, None)
        if not requests:
            del self._subscriptions[request.topic]
        await self._server.subscribe(self, request.topic, "", merge(requests.values()) if requests else None)

    async def _advertise(self, request: protocol.Advertise) -> None:
        known = self._advertised.get(request.topic)
        if known is not None and canonical(known) == canonical(request.type):
            return
        self._check_offers("advertise", request.id)
        await self._server.advertise(request.topic, request.type, request.id)
        self._advertised[request.topic] = request.type

    async def _unadvertise(self, request: protocol.Unadvertise) -> None:
        if self._advertised.pop(request.topic, None) is None:
            self.tell("warning", f"{request.topic} is not advertised", request.id)

    async def _publish(self, request: protocol.Publish) -> None:
        if request.topic not in self._advertised:
            self._check_offers("publish", request.id)
            type_name = await self._server.topic_type(request.topic)
            if not type_name:
                raise ProtocolError(f"{request.topic} is not advertised", "publish", request.id)
            await self._server.advertise(request.topic, type_name, request.id)
            self._advertised[request.topic] = type_name
        await self._server.publish(request.topic, request.msg, request.id)

    async def _call_service(self, request: protocol.CallService) -> None:
        if len(self._calls) >= self.connection.limits.calls:
            self._answer(request, "too many calls wait for their answer", result=False)
            return
        # Awaited by nobody: one slow service must not keep the client's other messages waiting.
        call = asyncio.ensure_future(self._call(request))
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)

    async def _call(self, request: protocol.CallService) -> None:
        try:
            values = await self._server.call(request.service, _request_fields(request, self._server), request.timeout)
        except (ValueError, ServiceError, asyncio.TimeoutError) as error:
            self._answer(request, str(error) or "no answer in time", result=False)
        else:
            self._answer(request, values, result=True)

    def _answer(self, request: protocol.CallService, values: object, *, result: bool) -> None:
        response = protocol.ServiceResponse(request.service, values, result, request.id)
        compression = "png" if request.compression == "png" else ""
        try:
            self.send(response, request.fragment_size, compression)
        except (TypeError, ValueError) as error:
            self.send(protocol.ServiceResponse(request.service, f"cannot be encoded: {error}", False, request.id))

    async def _advertise_service(self, request: protocol.AdvertiseService) -> None:
        self._check_offers("advertise_service", request.id)
        service = self._server.resolve(request.service)
        if not allowed(service, self._server.access.offer):
            raise ProtocolError(f"{service} may not be offered here", "advertise_service", request.id)
        self._server.offers.offer(service, request.type, self)
        self._offered.add(service)

    async def _unadvertise_service(self, request: protocol.UnadvertiseService) -> None:
        service = self._server.resolve(request.service)
        self._offered.discard(service)
        self._server.offers.withdraw(service, self)

    async def _service_response(self, response: protocol.ServiceResponse) -> None:
        self._server.offers.answer(response, self)

    async def _set_level(self, request: protocol.SetLevel) -> None:
        self._level = protocol.STATUS_LEVELS.index(request.level)

    async def _send_action_goal(self, request: protocol.SendActionGoal) -> None:
        self.send(protocol.ActionResult(request.action, "there are no actions here", _ABORTED, False, request.id))

    async def _no_actions(self, request: Operation) -> None:
        raise ProtocolError("there are no actions here")

    def _check_offers(self, op: str, id: Id) -> None:  # noqa: A002 - the protocol's own word
        limit = self.connection.limits.advertisements
        if len(self._advertised) + len(self._offered) >= limit:
            raise ProtocolError(f"more than {limit} topics and services", op, id)


def _request_fields(request: protocol.CallService, server: Server) -> Mapping[str, Any]:
    """Returns a request's fields; those of a list by the order in which the service's definition has them."""
    if isinstance(request.args, Mapping):
        return request.args
    service = server.resolve(request.service)
    if service.startswith(PREFIX):
        return {"": request.args}
    if not request.args:
        return {}
    if len(request.args) == 1 and isinstance(request.args[0], dict):
        return request.args[0]
    type_name = server.offers.types.get(service, "")
    for definition in service_definition(type_name, response=False).values():
        names = [field.name for field in definition.fields]
        if len(request.args) <= len(names):
            return dict(zip(names, request.args))
    raise ValueError(f"the arguments of {service} are needed by name")


_HANDLERS: Dict[Type[Any], Callable[[Session, Any], Awaitable[None]]] = {
    protocol.Subscribe: Session._subscribe,
    protocol.Unsubscribe: Session._unsubscribe,
    protocol.Advertise: Session._advertise,
    protocol.Unadvertise: Session._unadvertise,
    protocol.Publish: Session._publish,
    protocol.CallService: Session._call_service,
    protocol.AdvertiseService: Session._advertise_service,
    protocol.UnadvertiseService: Session._unadvertise_service,
    protocol.ServiceResponse: Session._service_response,
    protocol.SetLevel: Session._set_level,
    protocol.SendActionGoal: Session._send_action_goal,
    protocol.AdvertiseAction: Session._no_actions,
    protocol.CancelActionGoal: Session._no_actions,
    protocol.ActionFeedback: Session._no_actions,
    protocol.ActionResult: Session._no_actions,
}
"""What a client's operations do; those not named (`status`, `unadvertise_action`) ask for nothing."""
