"""One connection to a rosbridge server, re-established whenever it ends.

Theory of operation. `run` connects, sends everything that was subscribed, advertised and offered, and reads until the
connection ends; then it waits (`backoff.py`) and connects again. Messages published meanwhile are dropped: only the
present state matters. Nothing that a server sends ends more than this connection.

    subscriptions.py   where a subscription is sent, and where its messages arrive
    services.py        calls of the server's services, and services offered here
    send_queue.py      what waits to be sent
    liveness.py        whether the server still answers
    cause.py           why the connection is down

This project's client and server use CBOR in both directions (they agree on it as a WebSocket subprotocol), which keeps
NaN and infinities. With other servers it is JSON, where both are null.

All of this runs in one event loop. Methods without `async` may be called from any thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import ssl
import threading
from typing import Any, Callable, Dict, Mapping, Optional, Tuple

import aiohttp

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.middleware import Severity, canonical_type
from robot_health_monitor.runtime.log_limit import LimitedLog
from robot_health_monitor.runtime.threads import run_in_daemon_thread

from ..address import host_and_port, http_address, shown_address
from ..protocol import CBOR_SUBPROTOCOL, DEFAULT_LIMITS, Connection, Limits, Operation, ProtocolError, Wire, operations
from ..protocol.codec import HEAD_BYTES, decode, topic_of_message
from ..sockets import FloodError, Incoming, ignore_result, limit_reads, within
from .backoff import ConnectBackoff
from .cause import UP, Cause, RedirectError, cause_of_close, cause_of_error
from .host_lookup import HostLookup
from .liveness import wait_until_unanswered
from .send_queue import SendQueue
from .services import OfferedServices, ServiceCalls
from .subscriptions import Subscriptions

LARGEST_MESSAGE_BYTES = 64_000_000
"""Default size above which a message ends the connection."""

_CONNECT_TIMEOUT_S = 5.0
_CLOSE_TIMEOUT_S = 1.0
_LONGEST_TEXT = 200
_LARGE_CBOR_BYTES = 65_536
_MESSAGES = (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY)
_FLOODED = Cause("connection closed: the server floods it with pings or empty messages")


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
        """Creates a connection that is down; `run` connects.

        Args:
            url: `ws://host:port` or `wss://host:port`.
            token: presented to the server as `Authorization: Bearer TOKEN`; empty: none.
            ssl_context: for `wss://`; None trusts the system's certificate authorities.
            heartbeat_s: period of pings in s; the connection is down when one is not answered within half of it.
            limits: bounds for messages that are decoded. Of larger ones only the arrival counts.
            largest_message_bytes: a message above this size ends the connection.
            probation_s: how long a connection must last before `on_change` reports it as up, in s: a server that
                accepts connections only to close them is not up.
            on_change: called in the loop with (True, `UP`) or (False, cause) at every change, first when the first
                attempt has succeeded or failed.
            on_log: called in the loop with lines about what the server sends; bounded to a few per minute.
            clock: monotonic seconds.

        Raises:
            ConfigError: `url` is not the address of a WebSocket server.
        """
        host_and_port(url)
        self.address = shown_address(url)
        """The URL without credentials."""
        self.up = False
        """Whether operations can be sent."""
        self.calls = ServiceCalls(self.send, lambda: None if self.up else f"no connection to {self.address}")
        self.services = OfferedServices(self.send)
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
        self._overflowed: Optional[asyncio.Event] = None
        self._reported: Optional[Tuple[bool, Cause]] = None
        self._moved: Optional[asyncio.Event] = None
        self._probation: Optional[asyncio.TimerHandle] = None
        self._lookup = HostLookup()
        self._advertised: Dict[str, str] = {}

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

    def send(self, operation: Operation) -> None:
        """Sends an operation; drops it while the connection is down.

        A `publish` is also dropped while the send queue is full.

        Raises:
            MessageError: the operation cannot be encoded.
        """
        if not self.up or self._loop is None:
            return
        wires = self._protocol.send(operation, compression=self._compression)
        may_drop = isinstance(operation, operations.Publish)
        for wire in wires:
            if threading.get_ident() == self._thread:
                self._enqueue(wire, may_drop)
            else:
                with contextlib.suppress(RuntimeError):  # the loop has ended
                    self._loop.call_soon_threadsafe(self._enqueue, wire, may_drop)

    def publish(self, topic: str, message: Mapping[str, Any]) -> None:
        """Publishes on an advertised topic.

        Raises:
            MessageError: the message cannot be encoded.
        """
        self.send(operations.Publish(topic, message))

    def move(self, url: str, *, token: str, ssl_context: Optional[ssl.SSLContext]) -> None:
        """Connects again, to another address or with another token or trust. Called in the loop.

        The end of the present connection is not reported, so that a successful move raises no alert.

        Raises:
            ConfigError: `url` is not the address of a WebSocket server; nothing has changed.
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
                    held_s = await self._connect_once()
                except Exception as error:  # any failure: the connection must be re-established
                    text = printable(f"{type(error).__name__}: {error}")[:_LONGEST_TEXT]
                    self._on_log(Severity.ERROR, f"internal error in the connection to {self.address}: {text}")
                    self._report(False, Cause(f"internal error: {type(error).__name__}"))
                if not self._closed:
                    with contextlib.suppress(asyncio.TimeoutError):
                        await within(backoff.next_s(held_s), moved.wait())
        finally:
            self.up = False
            types.cancel()

    async def _connect_once(self) -> Optional[float]:
        """Connects and reads until the connection ends.

        Returns:
            How long the connection lasted, in s; None if there was none.
        """
        headers = {"Authorization": f"Bearer {self._token}"} if self._token else {}
        has_token = bool(self._token)
        connector = _Connector(resolver=self._lookup, use_dns_cache=False)
        traces = [_refusing_redirects()]
        async with aiohttp.ClientSession(headers=headers, connector=connector, trace_configs=traces) as session:
            try:
                socket = await within(_CONNECT_TIMEOUT_S, self._open(session))
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError, ValueError) as error:
                self._report(False, cause_of_error(error, has_token))
                return None
            start_s = asyncio.get_event_loop().time()
            cause = UP
            try:
                cause = await self._talk(socket)
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                cause = cause_of_error(error, has_token)
            finally:
                self.up = False
                self._cancel_probation()
                self.calls.fail_all(f"the connection to {self.address} went down")
                if cause is not UP:
                    self._report(False, cause)
                if cause is not _FLOODED:  # a closing handshake would read the whole flood
                    await _close(socket)
            return asyncio.get_event_loop().time() - start_s

    async def _open(self, session: aiohttp.ClientSession) -> aiohttp.ClientWebSocketResponse:
        options: Dict[str, Any] = {} if self._ssl_context is None else {"ssl": self._ssl_context}
        socket: aiohttp.ClientWebSocketResponse[Any] = await session.ws_connect(
            http_address(self._url),
            protocols=[CBOR_SUBPROTOCOL],
            autoping=False,
            max_msg_size=self._largest_message_bytes,
            **options,
        )
        return socket

    async def _talk(self, socket: aiohttp.ClientWebSocketResponse) -> Cause:
        """Uses a new connection until it ends; returns why it ended."""
        self._compression = "cbor" if socket.protocol == CBOR_SUBPROTOCOL else "none"
        self._protocol = Connection(self.limits, nan_as_null=False)
        self._queue = SendQueue()
        self._overflowed = asyncio.Event()
        incoming = Incoming(socket)
        tasks = {
            asyncio.ensure_future(self._read(socket, incoming)),
            asyncio.ensure_future(_write(socket, self._queue)),
            asyncio.ensure_future(self._wait_for_overflow(self._overflowed)),
            asyncio.ensure_future(self._wait_for_move()),
            asyncio.ensure_future(self._watch(socket, incoming)),
        }
        try:
            self._start_talking()
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            return next(iter(done)).result()
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
            self._queue = None

    def _start_talking(self) -> None:
        self.up = True
        with self._lock:
            for topic, type_name in self._advertised.items():
                self.send(operations.Advertise(topic, type_name))
        self.services.send_all()
        self.subscriptions.send_all(self._compression)
        self._probation = asyncio.get_event_loop().call_later(self._probation_s, self._report, True, UP)

    async def _read(self, socket: aiohttp.ClientWebSocketResponse, incoming: Incoming) -> Cause:
        while True:
            try:
                message = await incoming.next()
            except FloodError:
                return _FLOODED
            kind = message.type
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

    async def _watch(self, socket: aiohttp.ClientWebSocketResponse, incoming: Incoming) -> Cause:
        """Waits until the server does not answer."""
        await wait_until_unanswered(socket, self._heartbeat_s, lambda: incoming.received_s)
        return cause_of_error(asyncio.TimeoutError(), bool(self._token))

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
                self.services.answer(operation)
            elif isinstance(operation, operations.ServiceResponse):
                self.calls.receive(operation)
        except ProtocolError as error:
            text = printable(str(error))[:_LONGEST_TEXT]
            self._log.write("invalid", Severity.WARN, f"invalid message from {self.address}: {text}")
        except Exception as error:  # one message must not end the connection
            text = printable(f"{type(error).__name__}: {error}")[:_LONGEST_TEXT]
            self._log.write("failed", Severity.ERROR, f"a message from {self.address} was not processed: {text}")

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

    def _enqueue(self, wire: Wire, may_drop: bool) -> None:
        if self._queue is not None and not self._queue.put(wire) and not may_drop and self._overflowed is not None:
            # A lost subscription would be a silent failure; after a reconnection all of them are sent again.
            self._overflowed.set()

    async def _wait_for_overflow(self, overflowed: asyncio.Event) -> Cause:
        await overflowed.wait()
        return Cause("the server does not read what is sent to it")

    async def _wait_for_move(self) -> Cause:
        assert self._moved is not None
        await self._moved.wait()
        return Cause("the address has changed")

    def _cancel_probation(self) -> None:
        if self._probation is not None:
            self._probation.cancel()
            self._probation = None

    def _report(self, up: bool, cause: Cause) -> None:
        if (up, cause) == self._reported or (self._moved is not None and self._moved.is_set()):
            return  # known, or of the address before a `move`
        self._reported = up, cause
        try:
            self._on_change(up, cause)
        except Exception as error:
            text = printable(f"{type(error).__name__}: {error}")[:_LONGEST_TEXT]
            self._on_log(Severity.ERROR, f"a change of the connection to {self.address} was not processed: {text}")


class _Connector(aiohttp.TCPConnector):
    """Opens connections that are read in small pieces."""

    async def connect(self, *arguments: Any, **options: Any) -> aiohttp.connector.Connection:
        """As in `aiohttp.TCPConnector`."""
        connection = await super().connect(*arguments, **options)
        limit_reads(connection.transport)
        return connection


def _refusing_redirects() -> aiohttp.TraceConfig:
    """Returns hooks that end a request at a redirect: `ws_connect` has no option for it."""

    async def refuse(session: Any, context: Any, redirect: aiohttp.TraceRequestRedirectParams) -> None:
        raise RedirectError(redirect.response.status, redirect.response.headers.get("Location", ""))

    trace = aiohttp.TraceConfig()
    trace.on_request_redirect.append(refuse)
    return trace


async def _write(socket: aiohttp.ClientWebSocketResponse, queue: SendQueue) -> Cause:
    while True:
        wire = await queue.get()
        try:
            if isinstance(wire, bytes):
                await socket.send_bytes(wire)
            else:
                await socket.send_str(wire)
        except UnicodeEncodeError:
            continue  # a lone surrogate in a text: this one operation cannot be sent
        except (ConnectionError, RuntimeError, aiohttp.ClientError):
            # The connection has ended. `_read` finds out why.
            await asyncio.Event().wait()


async def _close(socket: aiohttp.ClientWebSocketResponse) -> None:
    """Closes a connection; a server that does not answer does not delay this for long."""
    with contextlib.suppress(Exception):
        await within(_CLOSE_TIMEOUT_S, socket.close())
