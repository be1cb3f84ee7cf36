"""One connection to a rosbridge server, re-established whenever it ends.

Theory of operation. `run` connects, sends everything that was subscribed, advertised and offered, and reads until the
connection ends; then it waits (`ConnectBackoff`) and connects again. Messages published meanwhile are dropped: only the
present state matters. Nothing that a server sends ends more than this connection.

    websocket.py       opening, what waits to be sent, whether the server still answers
    subscriptions.py   where a subscription is sent, and where its messages arrive
    services.py        calls of the server's services
    cause.py           why the connection is down

This project's client and server use CBOR in both directions (they agree on it as a WebSocket subprotocol), which keeps
NaN and infinities. With other servers it is JSON, where both are null.

All of this runs in one event loop. Methods without `async` may be called from any thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import random
import ssl
import threading
from typing import Any, Awaitable, Callable, Dict, Mapping, Optional, Tuple

import aiohttp

from robot_health_monitor.core.errors import MessageError, ServiceError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.middleware import Severity, canonical_type
from robot_health_monitor.runtime.backoff import Backoff
from robot_health_monitor.runtime.event_loops import run_in_daemon_thread
from robot_health_monitor.runtime.log_limit import LimitedLog

from ..address import host_and_port, shown_address
from ..protocol import CBOR_SUBPROTOCOL, DEFAULT_LIMITS, Connection, Limits, Operation, ProtocolError, Wire, operations
from ..protocol.codec import HEAD_BYTES, decode, serialized_publication, topic_of_message
from ..sockets import FloodError, Incoming, ignore_result, within
from .cause import UP, Cause, cause_of_close, cause_of_error
from .services import ServiceCalls
from .subscriptions import Subscriptions
from .websocket import HostLookup, SendQueue, Socket, close_socket, create_session, open_socket, wait_until_unanswered

LARGEST_MESSAGE_BYTES = 64_000_000
"""Default size above which a message ends the connection."""

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]

_LONGEST_TEXT = 200
_LARGE_CBOR_BYTES = 65_536
_MESSAGES = (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY)
_FLOODED = Cause("connection closed: the server floods it with pings or empty messages")
_HELD_S = 10.0
"""A connection that lasted this long, in s, is a good one: the delays start again from the shortest."""
_FIRST_DELAY_S = 0.2
_LONGEST_DELAY_S = 1.2
"""Longest delay while the server cannot be reached or connections break: short, so that a robot that can be reached
again is soon judged again."""
_SHORT_LIVED_S = 1.0
_LONGEST_AFTER_CLOSE_S = 30.0
"""Longest delay for a server that accepts connections only to close them within `_SHORT_LIVED_S`."""


class ConnectBackoff:
    """Delays that double with every attempt until a connection has held for `_HELD_S`.

    Each delay is shortened by a random part of up to half, so that a fleet does not reconnect all at once.
    """

    def __init__(self, chance: Callable[[], float] = random.random) -> None:
        """Starts with the shortest delay; `chance` returns a random number from 0 to 1."""
        self._backoff = Backoff(_FIRST_DELAY_S, _LONGEST_DELAY_S, spread=0.5, chance=chance)

    def next_s(self, held_s: Optional[float]) -> float:
        """Returns the delay before the next attempt, in s; the last connection held for `held_s`, or failed: None."""
        if held_s is not None and held_s >= _HELD_S:
            self._backoff.reset()
        closed_at_once = held_s is not None and held_s < _SHORT_LIVED_S
        return self._backoff.next_s(_LONGEST_AFTER_CLOSE_S if closed_at_once else None)


class ServerConnection:
    """A connection to one server, kept up."""

    def __init__(
        self,
        url: str,
        *,
        token: str = "",
        ssl_context: Optional[ssl.SSLContext] = None,
        heartbeat_s: float = 5.0,
        limits: Limits = DEFAULT_LIMITS,
        largest_message_bytes: int = LARGEST_MESSAGE_BYTES,
        probation_s: float = 0.5,
        on_change: Callable[[bool, Cause], None],
        on_log: Callable[[Severity, str], None],
        clock: Callable[[], float],
    ) -> None:
        """Creates a connection that is down; `run` connects. `RosbridgeClient` describes the other arguments.

        `on_change` is called in the loop with (True, `UP`) or (False, cause) at every change, first when the first
        attempt has succeeded or failed; `on_log` with lines about what the server sends, bounded to a few per minute.
        """
        host_and_port(url)
        self.address = shown_address(url)
        """The URL without credentials."""
        self.up = False
        """Whether operations can be sent."""
        self.calls = ServiceCalls(self.send, lambda: None if self.up else f"no connection to {self.address}")
        self.subscriptions = Subscriptions(self.send, self.calls.call)
        self.limits = limits
        """Bounds for messages that are decoded."""
        self._url = url
        self._token = token
        self._ssl_context = ssl_context
        self._heartbeat_s = heartbeat_s
        self._largest_message_bytes = largest_message_bytes
        self._probation_s = probation_s
        self._on_change = on_change
        self._on_log = on_log
        self._log = LimitedLog(on_log, clock)
        self._lock = threading.RLock()
        self._loop: Optional[asyncio.AbstractEventLoop] = None
        self._thread = 0
        self._closed = False
        self._protocol = Connection(limits, nan_as_null=False)
        self._compression = "none"
        self._queue: Optional[SendQueue] = None
        self._reported: Optional[Tuple[bool, Cause]] = None
        self._moved: Optional[asyncio.Event] = None
        self._lookup = HostLookup()
        self._advertised: Dict[str, str] = {}
        self._services: Dict[str, Tuple[str, Handler]] = {}

    def advertise(self, topic: str, type_name: str) -> None:
        """Announces a topic to publish on, now and after every reconnection."""
        with self._lock:
            if topic not in self._advertised:
                self._advertised[topic] = canonical_type(type_name)
                self.send(operations.Advertise(topic, canonical_type(type_name)))

    def unadvertise(self, topic: str) -> None:
        """Ends an `advertise`."""
        with self._lock:
            if self._advertised.pop(topic, None) is not None:
                self.send(operations.Unadvertise(topic))

    def offer(self, service: str, type_name: str, handler: Handler) -> None:
        """Offers a service, now and after every reconnection; the handler runs in the loop and raises ServiceError."""
        with self._lock:
            self._services[service] = canonical_type(type_name), handler
            self.send(operations.AdvertiseService(service, canonical_type(type_name)))

    def withdraw(self, service: str) -> None:
        """Ends an `offer`."""
        with self._lock:
            if self._services.pop(service, None) is not None:
                self.send(operations.UnadvertiseService(service))

    def send(self, operation: Operation) -> None:
        """Sends an operation; raises MessageError if it cannot be encoded.

        Drops it while the connection is down, and a `publish` while the send queue is full.
        """
        if not self.up or self._loop is None:
            return
        # A lost subscription would be a silent failure; after a reconnection all of them are sent again.
        may_drop = isinstance(operation, operations.Publish)
        for wire in self._protocol.send(operation, compression=self._compression):
            if threading.get_ident() == self._thread:
                self._enqueue(wire, may_drop)
            else:
                with contextlib.suppress(RuntimeError):  # the loop has ended
                    self._loop.call_soon_threadsafe(self._enqueue, wire, may_drop)

    def move(self, url: str, *, token: str, ssl_context: Optional[ssl.SSLContext]) -> None:
        """Connects again, to another address or with another token or trust. Called in the loop.

        The end of the present connection is not reported, so that a successful move raises no alert. ConfigError: `url`
        is not the address of a WebSocket server; nothing has changed.
        """
        host_and_port(url)
        self.address = shown_address(url)
        self._url = url
        self._token = token
        self._ssl_context = ssl_context
        self._reported = None
        if self._moved is not None:
            self._moved.set()

    def close(self) -> None:
        """Makes `run` end at its next attempt; cancel its task to end it at once."""
        self._closed = True

    async def run(self) -> None:
        """Keeps the connection up until it is cancelled or `close` is called."""
        self._loop = asyncio.get_event_loop()
        self._thread = threading.get_ident()
        types = asyncio.ensure_future(self.subscriptions.find_types())
        moved = self._moved = asyncio.Event()
        backoff = ConnectBackoff()
        try:
            while not self._closed:
                if moved.is_set():
                    moved.clear()
                    backoff = ConnectBackoff()
                held_s = None
                try:
                    held_s = await self._connect_once(moved)
                except Exception as error:  # any failure: the connection must be re-established
                    text = f"internal error in the connection to {self.address}: {_text(error)}"
                    self._on_log(Severity.ERROR, text)
                    self._report(False, Cause(f"internal error: {type(error).__name__}"))
                if not self._closed:
                    with contextlib.suppress(asyncio.TimeoutError):
                        await within(backoff.next_s(held_s), moved.wait())
        finally:
            self.up = False
            types.cancel()

    async def _connect_once(self, moved: asyncio.Event) -> Optional[float]:
        """Connects and reads until the connection ends; returns how long it lasted, in s, or None if there was none."""
        headers = {"Authorization": f"Bearer {self._token}"} if self._token else {}
        has_token = bool(self._token)
        async with create_session(self._lookup, headers) as session:
            try:
                socket = await open_socket(session, self._url, self._ssl_context, self._largest_message_bytes)
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError, ValueError) as error:
                self._report(False, cause_of_error(error, has_token))
                return None
            start_s = asyncio.get_event_loop().time()
            cause = UP
            try:
                cause = await self._talk(socket, moved)
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                cause = cause_of_error(error, has_token)
            finally:
                self.up = False
                self.calls.fail_all(f"the connection to {self.address} went down")
                if cause is not UP:
                    self._report(False, cause)
                if cause is not _FLOODED:  # a closing handshake would read the whole flood
                    await close_socket(socket)
            return asyncio.get_event_loop().time() - start_s

    async def _talk(self, socket: Socket, moved: asyncio.Event) -> Cause:
        """Uses a new connection until it ends; returns why it ended."""
        self._compression = "cbor" if socket.protocol == CBOR_SUBPROTOCOL else "none"
        self._protocol = Connection(self.limits, nan_as_null=False)
        queue = self._queue = SendQueue()
        incoming = Incoming(socket)
        silent = functools.partial(wait_until_unanswered, socket, self._heartbeat_s, lambda: incoming.received_s)
        ends = (
            self._read(socket, incoming),
            _after(functools.partial(queue.write_to, socket), UP),
            _after(queue.overflowed.wait, Cause("the server does not read what is sent to it")),
            _after(moved.wait, Cause("the address has changed")),
            _after(silent, cause_of_error(asyncio.TimeoutError(), bool(self._token))),
        )
        tasks = {asyncio.ensure_future(end) for end in ends}
        probation = asyncio.get_event_loop().call_later(self._probation_s, self._report, True, UP)
        try:
            self.up = True
            with self._lock:
                for topic, type_name in self._advertised.items():
                    self.send(operations.Advertise(topic, type_name))
                for service, (type_name, _) in self._services.items():
                    self.send(operations.AdvertiseService(service, type_name))
            self.subscriptions.send_all(self._compression)
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            return next(iter(done)).result()
        finally:
            probation.cancel()
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
            self._queue = None

    async def _read(self, socket: Socket, incoming: Incoming) -> Cause:
        while True:
            try:
                message = await incoming.next()
            except FloodError:
                return _FLOODED
            kind = message.type
            if kind is aiohttp.WSMsgType.BINARY and self._receive_serialized(message.data):
                continue
            if kind is aiohttp.WSMsgType.BINARY and len(message.data) > _LARGE_CBOR_BYTES:
                await self._receive_large(message.data, incoming.received_s)
            elif kind in _MESSAGES:
                self._receive(message.data, incoming.received_s)
            else:
                error = message.data if isinstance(message.data, BaseException) else socket.exception()
                if error is not None:
                    return cause_of_error(error, bool(self._token))
                reason = message.extra if isinstance(message.extra, str) else ""
                return cause_of_close(socket.close_code, reason, bool(self._token))

    async def _receive_large(self, data: bytes, now_s: float) -> None:
        """Does what `_receive` does, but decodes in a thread: CBOR takes up to a second per megabyte."""
        topic = topic_of_message(data)
        arrivals_only = topic is not None and self.subscriptions.arrivals_only(topic)
        if arrivals_only or len(data) > self.limits.message_bytes:
            self._receive(data, now_s)  # is not decoded
            return
        decoding = asyncio.ensure_future(run_in_daemon_thread(functools.partial(decode, data, self.limits)))
        decoding.add_done_callback(ignore_result)
        await asyncio.wait({decoding})
        self._receive(data, now_s, lambda data, limits: decoding.result())

    def _receive(self, data: Wire, now_s: float, read: Callable[[Wire, Limits], Dict[str, Any]] = decode) -> None:
        try:
            if len(data) > HEAD_BYTES and self._receive_undecoded(data):
                return
            fields = read(data, self.limits)
            topic, message = fields.get("topic"), fields.get("msg")
            if fields.get("op") == "publish" and type(topic) is str and type(message) is dict:
                self.subscriptions.deliver(topic, message)  # by far the most frequent
                return
            operation = self._protocol.receive_decoded(fields, now_s)
            if isinstance(operation, operations.Publish):
                self.subscriptions.deliver(operation.topic, operation.msg)
            elif isinstance(operation, operations.CallService):
                self._answer(operation)
            elif isinstance(operation, operations.ServiceResponse):
                self.calls.receive(operation)
        except ProtocolError as error:
            text = printable(str(error))[:_LONGEST_TEXT]
            self._log.write("invalid", Severity.WARN, f"invalid message from {self.address}: {text}")
        except Exception as error:  # one message must not end the connection
            text = f"a message from {self.address} was not processed: {_text(error)}"
            self._log.write("failed", Severity.ERROR, text)

    def _receive_serialized(self, data: bytes) -> bool:
        """Passes a serialized message on; returns False if it is none."""
        found = serialized_publication(data) if self.subscriptions.has_bytes else None
        if found is not None:
            self.subscriptions.deliver_bytes(*found)
        return found is not None

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

    def _answer(self, request: operations.CallService) -> None:
        """Sends the response to a request for a service that is offered here."""
        _, handler = self._services.get(request.service, ("", None))
        values: object = "this service is not offered here"
        answered = False
        if handler is not None:
            try:
                values, answered = dict(handler(request.args if isinstance(request.args, dict) else {})), True
            except (ServiceError, MessageError) as error:
                values = str(error)
        self.send(operations.ServiceResponse(request.service, values, answered, request.id))

    def _enqueue(self, wire: Wire, may_drop: bool) -> None:
        if self._queue is not None:
            self._queue.put(wire, may_drop=may_drop)

    def _report(self, up: bool, cause: Cause) -> None:
        if (up, cause) == self._reported or (self._moved is not None and self._moved.is_set()):
            return  # known, or of the address before a `move`
        self._reported = up, cause
        try:
            self._on_change(up, cause)
        except Exception as error:
            text = f"a change of the connection to {self.address} was not processed: {_text(error)}"
            self._on_log(Severity.ERROR, text)


async def _after(end: Callable[[], Awaitable[object]], cause: Cause) -> Cause:
    await end()
    return cause


def _text(error: Exception) -> str:
    return printable(f"{type(error).__name__}: {error}")[:_LONGEST_TEXT]
