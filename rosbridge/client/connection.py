"""One connection to a rosbridge server that comes back by itself, with everything that was subscribed and offered.

Theory of operation. `run` connects, says again whatever `subscribe`, `advertise` and `advertise_service` were told,
and reads until the connection ends; then it waits a little, longer each time up to `_LAST_RETRY_S`, and connects
again. What is published while the link is down is dropped: health is about now, and a flood of old messages helps
nobody.

Between this package's own client and server CBOR goes both ways (they agree on it as a WebSocket subprotocol), so that
NaN and infinities arrive as they are. With any other server it is JSON, where they travel as null.

All of it runs in one event loop; the methods without `async` may be called from any thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import random
import ssl
import threading
from collections import deque
from typing import Any, Callable, Deque, Dict, List, Mapping, Optional, Set, Tuple

import aiohttp

from robot_health_monitor.core.errors import ServiceError

from .. import protocol
from ..protocol import CBOR_SUBPROTOCOL, Connection, Operation
from ..protocol.definitions import canonical
from ..protocol.errors import Id, ProtocolError
from ..protocol.limits import DEFAULT_LIMITS, Limits

Deliver = Callable[[Mapping[str, Any]], None]
Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]

_CONNECT_TIMEOUT_S = 5.0
_GOODBYE_TIMEOUT_S = 1.0
_FIRST_RETRY_S = 0.2
_LAST_RETRY_S = 2.0
_TYPE_PERIOD_S = 1.0
_MOST_QUEUED = 10_000
"""Most operations that wait to be sent; then the oldest are dropped."""
_WATCH_PERIOD_S = 0.5
_STANDSTILL_S = 2.0


class Link:
    """A connection to one server, kept up."""

    def __init__(
        self,
        url: str,
        *,
        token: str = "",
        ssl_context: Optional[ssl.SSLContext] = None,
        heartbeat_s: float = 5.0,
        limits: Limits = DEFAULT_LIMITS,
        on_change: Callable[[bool], None],
        on_problem: Callable[[str], None],
    ) -> None:
        """Makes a link that is down; `run` brings it up.

        Args:
            url: `ws://host:port` or `wss://host:port`.
            token: shown to the server as `Authorization: Bearer TOKEN`; empty: none.
            ssl_context: for `wss://`; None trusts the system's certificate authorities.
            heartbeat_s: period of pings in s; without an answer for half of it the link is down.
            limits: what the server may send.
            on_change: called in the loop with True when the link is up and with False when it is down, first when
                the first attempt has succeeded or failed.
            on_problem: told in one line why the link is down, when the reason is a new one.
        """
        self.url = url
        self.up = False
        """Whether the server can be talked to now."""
        self._token = token
        self._ssl_context = ssl_context
        self._heartbeat_s = heartbeat_s
        self._limits = limits
        self._on_change = on_change
        self._on_problem = on_problem
        self._lock = threading.RLock()
        self._loop: Optional[asyncio.AbstractEventLoop] = None
        self._connection = Connection(limits, nan_as_null=False)
        self._compression = "none"
        self._known: Optional[bool] = None
        self._problem = ""
        self._topics: Dict[str, str] = {}
        self._deliveries: Dict[str, Tuple[Deliver, ...]] = {}
        self._advertised: Dict[str, str] = {}
        self._services: Dict[str, Tuple[str, Handler]] = {}
        self._untyped: Set[str] = set()
        self._queue: Deque[protocol.Wire] = deque()
        self._queued: Optional[asyncio.Event] = None
        self._thread = 0
        self._closed = False
        self._calls: Dict[Id, asyncio.Future[Any]] = {}
        self._numbers = itertools.count()

    # What nodes ask for, from any thread

    def subscribe(self, topic: str, type_name: str, deliver: Deliver) -> None:
        """Has `deliver(message)` called in the loop for every message; the type may be empty: it is then asked for."""
        with self._lock:
            first = topic not in self._deliveries
            self._deliveries[topic] = (*self._deliveries.get(topic, ()), deliver)
            if first or (type_name and not self._topics[topic]):
                self._topics[topic] = canonical(type_name)
                self._say_subscribe(topic)

    def unsubscribe(self, topic: str, deliver: Deliver) -> None:
        """Ends one `subscribe`."""
        with self._lock:
            left = tuple(other for other in self._deliveries.get(topic, ()) if other is not deliver)
            if left:
                self._deliveries[topic] = left
            elif self._deliveries.pop(topic, None) is not None:
                del self._topics[topic]
                self._untyped.discard(topic)
                self.send(protocol.Unsubscribe(topic, _subscription_id(topic)))

    def advertise(self, topic: str, type_name: str) -> None:
        """Announces a topic to publish on, now and after every reconnection."""
        with self._lock:
            if topic not in self._advertised:
                self._advertised[topic] = canonical(type_name)
                self.send(protocol.Advertise(topic, canonical(type_name)))

    def unadvertise(self, topic: str) -> None:
        """Ends an `advertise`."""
        with self._lock:
            if self._advertised.pop(topic, None) is not None:
                self.send(protocol.Unadvertise(topic))

    def advertise_service(self, service: str, type_name: str, handler: Handler) -> None:
        """Offers a service, now and after every reconnection; a ValueError of `handler` is a failure."""
        with self._lock:
            self._services[service] = canonical(type_name), handler
            self.send(protocol.AdvertiseService(service, canonical(type_name)))

    def unadvertise_service(self, service: str) -> None:
        """Ends an `advertise_service`."""
        with self._lock:
            if self._services.pop(service, None) is not None:
                self.send(protocol.UnadvertiseService(service))

    def send(self, operation: Operation) -> None:
        """Sends an operation; while the link is down it is dropped."""
        if not self.up or self._loop is None:
            return
        wires = self._connection.send(operation, compression=self._compression)
        if threading.get_ident() == self._thread:
            self._enqueue(wires)
        else:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self._loop.call_soon_threadsafe(self._enqueue, wires)

    def publish(self, topic: str, message: Mapping[str, Any]) -> None:
        """Publishes on an advertised topic."""
        self.send(protocol.Publish(topic, message))

    def close(self) -> None:
        """Has `run` end when it is cancelled, or when it looks next: before Python 3.12 a cancellation can get lost."""
        self._closed = True

    # In the loop

    async def call_service(self, service: str, request: Mapping[str, Any], timeout_s: float) -> Mapping[str, Any]:
        """Calls a service of the server's side and returns the response.

        Raises:
            ValueError: the link is down, the call failed, or there was no answer in time.
        """
        if not self.up:
            raise ValueError(f"{service} cannot be called: the link to {self.url} is down")
        id = f"call:{next(self._numbers)}"  # noqa: A001 - the protocol's own word
        future: asyncio.Future[Any] = asyncio.get_event_loop().create_future()
        self._calls[id] = future
        try:
            self.send(protocol.CallService(service, request, id))
            values = await asyncio.wait_for(future, timeout_s)
        except asyncio.TimeoutError:
            raise ValueError(f"{service} did not answer within {timeout_s:g} s") from None
        finally:
            del self._calls[id]
        return values if isinstance(values, dict) else {}

    async def run(self) -> None:
        """Keeps the link up until it is cancelled."""
        self._loop = asyncio.get_event_loop()
        self._thread = threading.get_ident()
        watch = asyncio.ensure_future(self._watch_own_pace())
        types = asyncio.ensure_future(self._ask_for_types())
        retry_s = _FIRST_RETRY_S
        try:
            while not self._closed:
                was_up = await self._connect_once()
                retry_s = _FIRST_RETRY_S if was_up else min(retry_s * 2.0, _LAST_RETRY_S)
                # Spread out: a fleet must not come back all at once.
                await asyncio.sleep(retry_s * random.uniform(0.5, 1.0))
        finally:
            watch.cancel()
            types.cancel()
            self.up = False

    async def _connect_once(self) -> bool:
        """Connects and reads until the connection ends; returns whether it was up."""
        headers = {"Authorization": f"Bearer {self._token}"} if self._token else {}
        was_up = False
        async with aiohttp.ClientSession(headers=headers) as session:
            try:
                socket = await asyncio.wait_for(self._open(session), _CONNECT_TIMEOUT_S)
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError, ValueError) as error:
                self._go_down(_reason(error))
                return False
            try:
                if not self._closed:
                    was_up = True
                    await self._talk(socket)
                    self._go_down(_ending(socket))
            except (aiohttp.ClientError, OSError) as error:
                self._go_down(_reason(error))
            finally:
                self.up = False
                goodbye = asyncio.ensure_future(socket.close())
                try:
                    await asyncio.wait({goodbye}, timeout=_GOODBYE_TIMEOUT_S)
                finally:
                    goodbye.cancel()
                    goodbye.add_done_callback(_forget)
        return was_up

    async def _open(self, session: aiohttp.ClientSession) -> aiohttp.ClientWebSocketResponse:
        options: Dict[str, Any] = {} if self._ssl_context is None else {"ssl": self._ssl_context}
        url = self.url.replace("wss:", "https:", 1).replace("ws:", "http:", 1)
        socket: aiohttp.ClientWebSocketResponse[Any] = await session.ws_connect(
            url,
            protocols=[CBOR_SUBPROTOCOL],
            heartbeat=self._heartbeat_s,
            max_msg_size=self._limits.message_bytes,
            **options,
        )
        return socket

    async def _talk(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._compression = "cbor" if socket.protocol == CBOR_SUBPROTOCOL else "none"
        self._connection = Connection(self._limits, nan_as_null=False)
        self._queue.clear()
        self._queued = asyncio.Event()
        writer = asyncio.ensure_future(self._write(socket, self._queued))
        try:
            self._go_up()
            now_s = asyncio.get_event_loop().time
            async for message in socket:
                if message.type in (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY):
                    self._receive(message.data, now_s())
        finally:
            writer.cancel()

    async def _write(self, socket: aiohttp.ClientWebSocketResponse, queued: asyncio.Event) -> None:
        while True:
            await queued.wait()
            queued.clear()
            while self._queue:
                wire = self._queue.popleft()
                try:
                    if isinstance(wire, bytes):
                        await socket.send_bytes(wire)
                    else:
                        await socket.send_str(wire)
                except (ConnectionError, RuntimeError, aiohttp.ClientError):
                    return  # the connection has ended: whoever reads from it sees that too

    def _enqueue(self, wires: List[protocol.Wire]) -> None:
        self._queue.extend(wires)
        while len(self._queue) > _MOST_QUEUED:
            self._queue.popleft()
        if self._queued is not None:
            self._queued.set()

    def _go_up(self) -> None:
        self.up = True
        with self._lock:
            for topic, type_name in self._advertised.items():
                self.send(protocol.Advertise(topic, type_name))
            for service, (type_name, _) in self._services.items():
                self.send(protocol.AdvertiseService(service, type_name))
            for topic in self._topics:
                self._say_subscribe(topic)
        self._problem = ""
        self._tell(True)

    def _go_down(self, reason: str) -> None:
        self.up = False
        for future in self._calls.values():
            if not future.done():
                future.set_exception(ValueError(f"the link to {self.url} went down"))
        if reason != self._problem:
            self._problem = reason
            self._on_problem(f"the link to {self.url} is down: {reason}")
        self._tell(False)

    def _tell(self, up: bool) -> None:
        if up != self._known:
            self._known = up
            self._on_change(up)

    def _say_subscribe(self, topic: str) -> None:
        type_name = self._topics[topic]
        if not type_name and self._compression != "cbor":
            # Only this project's server waits for a topic whose type nobody knows yet; others refuse it.
            self._untyped.add(topic)
            return
        self._untyped.discard(topic)
        self.send(protocol.Subscribe(topic, type_name, _subscription_id(topic), compression=self._compression))

    def _receive(self, data: protocol.Wire, now_s: float) -> None:
        try:
            operation = self._connection.receive(data, now_s)
        except ProtocolError as error:
            self._on_problem(f"{self.url} sent what is not understood: {error}")
            return
        if isinstance(operation, protocol.Publish):
            if self._untyped:
                self._untyped.discard(operation.topic)
            for deliver in self._deliveries.get(operation.topic, ()):
                deliver(operation.msg)
        elif isinstance(operation, protocol.CallService):
            self._answer(operation)
        elif isinstance(operation, protocol.ServiceResponse):
            self._take_answer(operation)

    def _answer(self, request: protocol.CallService) -> None:
        _, handler = self._services.get(request.service, ("", None))
        arguments = request.args if isinstance(request.args, dict) else {}
        if handler is None:
            response = protocol.ServiceResponse(request.service, "is not offered", False, request.id)
        else:
            try:
                response = protocol.ServiceResponse(request.service, dict(handler(arguments)), True, request.id)
            except (ValueError, ServiceError) as error:
                response = protocol.ServiceResponse(request.service, str(error), False, request.id)
        self.send(response)

    def _take_answer(self, response: protocol.ServiceResponse) -> None:
        future = self._calls.get(response.id)
        if future is None or future.done():
            return
        if response.result:
            future.set_result(response.values)
        else:
            future.set_exception(ValueError(f"{response.service} failed: {response.values}"))

    async def _ask_for_types(self) -> None:
        """Finds out the types of topics that were subscribed to without one."""
        while True:
            await asyncio.sleep(_TYPE_PERIOD_S if self.up else _FIRST_RETRY_S)
            if self.up and self._untyped:
                await asyncio.gather(*(self._ask_for_type(topic) for topic in tuple(self._untyped)))

    async def _ask_for_type(self, topic: str) -> None:
        try:
            answer = await self.call_service("/rosapi/topic_type", {"topic": topic}, _CONNECT_TIMEOUT_S)
        except ValueError:
            # No rosapi there. A server that knows the topic by now takes a subscription without a type, too.
            self.send(protocol.Subscribe(topic, "", _subscription_id(topic)))
            return
        found = answer.get("type")
        with self._lock:
            if isinstance(found, str) and found and topic in self._untyped:
                self._topics[topic] = canonical(found)
                self._say_subscribe(topic)

    async def _watch_own_pace(self) -> None:
        """Says so when it is this process that stood still: signals look stale then, though the robot is well."""
        loop = asyncio.get_event_loop()
        while True:
            before_s = loop.time()
            await asyncio.sleep(_WATCH_PERIOD_S)
            late_s = loop.time() - before_s - _WATCH_PERIOD_S
            if late_s > _STANDSTILL_S:
                self._on_problem(f"own fault: this process stood still for {late_s:.1f} s")


def _forget(task: asyncio.Future[Any]) -> None:
    """Looks at how a task ended, which asyncio complains of otherwise: the connection is gone either way."""
    if not task.cancelled():
        task.exception()


def _subscription_id(topic: str) -> str:
    return f"subscribe:{topic}"


def _ending(socket: aiohttp.ClientWebSocketResponse) -> str:
    error = socket.exception()
    if error is not None:
        return _reason(error)
    if socket.close_code in (1000, 1001):
        return "the server says goodbye"
    return "the connection broke off" if socket.close_code in (None, 1006) else f"closed with code {socket.close_code}"


def _reason(error: BaseException) -> str:
    """Says whose fault it is, as far as that can be told, and what it is."""
    if isinstance(error, aiohttp.WSServerHandshakeError):
        if error.status in (401, 403):
            return f"own fault: the server refuses this client ({error.status}): is the token right?"
        return f"the server at this address answers {error.status}: it is no rosbridge server, or a busy one"
    if isinstance(error, (aiohttp.ClientConnectorCertificateError, aiohttp.ClientSSLError)):
        return f"own fault: the server's certificate is not trusted ({error})"
    if isinstance(error, (aiohttp.InvalidURL, ValueError)) and not isinstance(error, OSError):
        return f"own fault: this is no address of a rosbridge server ({error})"
    if isinstance(error, asyncio.TimeoutError):
        return "the robot cannot be reached: no answer"
    cause = error.os_error if isinstance(error, aiohttp.ClientConnectorError) else error
    if isinstance(cause, ConnectionResetError):
        return "the connection broke off"
    if isinstance(cause, ConnectionRefusedError):
        return "the robot can be reached, but no server listens there"
    return f"the robot cannot be reached: {str(cause) or type(cause).__name__}"
