"""One connection to a server of a robot's bridge, re-established whenever it ends.

Theory of operation. `run` connects, lets the subclass send what is wanted (`_begin`), and reads until the connection
ends; then it waits (`ConnectBackoff`) and connects again. Nothing that a server sends ends more than this connection.

    websocket.py       opening, what waits to be sent, whether the server still answers
    cause.py           why the connection is down

All of this runs in one event loop. `send` may be called from any thread.
"""

from __future__ import annotations

import abc
import asyncio
import contextlib
import functools
import random
import ssl
import threading
from typing import Any, Awaitable, Callable, ClassVar, Sequence

import aiohttp

from ...core.port import LimitedLog, Severity
from ...core.values import Clock, MessageError, printable
from ..backoff import Backoff
from ..sockets import FloodError, Incoming, within
from .address import host_and_port, http_address, shown_address
from .cause import UP, Cause, cause_of_close, cause_of_error
from .websocket import HostLookup, Socket, Wire, create_session, wait_until_unanswered, write

LARGEST_MESSAGE_BYTES = 64_000_000
"""Default size above which a message ends the connection."""

LONGEST_TEXT = 200
"""Characters of an error of a server that are shown."""
_MESSAGES = (aiohttp.WSMsgType.TEXT, aiohttp.WSMsgType.BINARY)
_FLOODED = Cause("connection closed: the server floods it with pings or empty messages")
_CONNECT_TIMEOUT_S = 5.0
_CLOSE_TIMEOUT_S = 1.0
_MOST_WAITING = 10_000
"""Messages that may wait to be sent. A lost subscription would be a silent failure: one more ends the connection."""
_HELD_S = 10.0
"""A connection that lasted this long, in s, is a good one: the delays start again from the shortest."""
_FIRST_DELAY_S = 0.2
_LONGEST_DELAY_S = 1.2
"""Longest delay while the server cannot be reached or connections break: short, so that a robot that can be reached
again is soon judged again."""
_SHORT_LIVED_S = 1.0
_LONGEST_AFTER_CLOSE_S = 30.0
"""Longest delay for a server that accepts connections only to close them within `_SHORT_LIVED_S`."""


class ConnectBackoff(Backoff):
    """Delays that double with every attempt until a connection has held for `_HELD_S`.

    Each delay is shortened by a random part of up to half, so that a fleet does not reconnect all at once.
    """

    def __init__(self, chance: Clock = random.random) -> None:
        """Starts with the shortest delay; `chance` returns a random number from 0 to 1."""
        super().__init__(_FIRST_DELAY_S, _LONGEST_DELAY_S, spread=0.5, chance=chance)

    def after_s(self, held_s: float | None) -> float:
        """Returns the delay before the next attempt, in s; the last connection held for `held_s`, or failed: None."""
        if held_s is not None and held_s >= _HELD_S:
            self.reset()
        return self.next_s(_LONGEST_AFTER_CLOSE_S if held_s is not None and held_s < _SHORT_LIVED_S else None)


class BridgeConnection(abc.ABC):
    """A connection to one server, kept up. A subclass speaks a protocol."""

    receivers: Any
    """The subscriptions, by `add` and `remove`, each with what receives the messages; may be called in any thread."""
    subprotocols: ClassVar[Sequence[str]]
    """WebSocket subprotocols that are offered, the preferred one first."""
    server_kind: ClassVar[str]
    """What the server is, for causes: `rosbridge server`."""

    def __init__(
        self,
        url: str,
        *,
        token: str = "",
        ssl_context: ssl.SSLContext | None = None,
        heartbeat_s: float = 5.0,
        largest_message_bytes: int = LARGEST_MESSAGE_BYTES,
        probation_s: float = 0.5,
        on_change: Callable[[bool, Cause], None],
        on_log: Callable[[Severity, str], None],
        clock: Clock,
    ) -> None:
        """Creates a connection that is down; `run` connects.

        Args:
            url: `ws://host:port` or `wss://host:port`, or with the scheme of the subclass.
            token: presented to the server, if it is not empty.
            ssl_context: for TLS; None trusts the system's certificate authorities.
            heartbeat_s: period of pings in s; the connection is down when one is not answered within half of it.
            largest_message_bytes: a message above this size ends the connection.
            probation_s: how long a new connection must last before it is reported as up, in s: a server that accepts
                connections only to close them is not up.
            on_change: called in the loop with (True, `UP`) or (False, cause) at every change, first when the first
                attempt has succeeded or failed.
            on_log: called with lines about what the server sends, bounded to a few per minute.
            clock: monotonic seconds.

        Raises:
            ConfigError: `url` is not the address of a WebSocket server.
        """
        host_and_port(url)
        self.address = shown_address(url)
        """The URL without credentials."""
        self.up = False
        """Whether operations can be sent."""
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
        self.tasks: list[Callable[[], Awaitable[None]]] = []
        """Run beside the connection, whether it is up or down."""
        self.loop: asyncio.AbstractEventLoop | None = None
        """That in which `run` runs; None before."""
        self._thread = 0
        self._closed = False
        self._wires: asyncio.Queue[Wire] | None = None
        """Messages that wait to be sent; None while the connection is down."""
        self._overflowed: asyncio.Event
        self._reported: tuple[bool, Cause] | None = None
        self._moved: asyncio.Event | None = None
        self._lookup = HostLookup()

    @abc.abstractmethod
    def _begin(self, subprotocol: str | None) -> bool:
        """Sends what is wanted on a new connection, for which the server chose a subprotocol.

        Returns whether the server can be used; if not, `_refusal` says why.
        """

    @abc.abstractmethod
    def _receive(self, data: Wire) -> Awaitable[None] | None:
        """Processes a message; returns what has to be awaited before the next one, if anything.

        Raises MessageError if the message is not valid, which becomes a log line.
        """

    @abc.abstractmethod
    def _went_down(self) -> None:
        """Called when a connection has ended."""

    async def _refusal(self) -> Cause:
        """Returns why a server that accepts the connection cannot be used, once that is known."""
        await asyncio.Event().wait()
        return UP

    def send_wire(self, wire: Wire) -> None:
        """Sends a message, and drops it while the connection is down; may be called from any thread.

        The connection ends if the send queue is full.
        """
        if self.up:
            self.run_in_loop(self._enqueue, wire)

    def run_in_loop(self, function: Callable[..., object], *arguments: Any) -> None:
        """Calls a function in the loop: there at once, from other threads soon; never before `run` or after its end."""
        if threading.get_ident() == self._thread:
            function(*arguments)
        elif self.loop is not None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                self.loop.call_soon_threadsafe(function, *arguments)

    def move(self, url: str, *, token: str, ssl_context: ssl.SSLContext | None) -> None:
        """Connects again, to another address or with another token or trust. Called in the loop.

        The end of the present connection is not reported, so that a successful move raises no alert. Raises ConfigError
        and changes nothing if `url` is not the address of a server.
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

    def enter_loop(self) -> None:
        """Begins to use the running loop; `run` does so first."""
        self.loop = asyncio.get_event_loop()
        self._thread = threading.get_ident()

    async def run(self) -> None:
        """Keeps the connection up until it is cancelled or `close` is called."""
        self.enter_loop()
        moved = self._moved = asyncio.Event()
        backoff = ConnectBackoff()
        tasks = [asyncio.ensure_future(task()) for task in self.tasks]
        try:
            while not self._closed:
                if moved.is_set():
                    moved.clear()
                    backoff.reset()
                held_s = None
                try:
                    held_s = await self._connect_once(moved)
                except Exception as error:  # any failure: the connection must be re-established
                    text = f"internal error in the connection to {self.address}: {_text(error)}"
                    self._on_log(Severity.ERROR, text)
                    self._report(False, Cause(f"internal error: {type(error).__name__}"))
                if not self._closed:
                    with contextlib.suppress(asyncio.TimeoutError):
                        await within(backoff.after_s(held_s), moved.wait())
        finally:
            for task in tasks:
                task.cancel()
            self.up = False
            self._thread = 0

    async def _connect_once(self, moved: asyncio.Event) -> float | None:
        """Connects and reads until the connection ends; returns how long it lasted, in s, or None if there was none."""
        headers = {"Authorization": f"Bearer {self._token}"} if self._token else {}
        async with create_session(self._lookup, headers) as session:
            try:
                socket = await within(_CONNECT_TIMEOUT_S, self._open(session))
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError, ValueError) as error:
                self._report(False, self._cause_of(error))
                return None
            start_s = asyncio.get_event_loop().time()
            cause = UP
            try:
                cause = await self._talk(socket, moved)
            except (aiohttp.ClientError, OSError, asyncio.TimeoutError) as error:
                cause = self._cause_of(error)
            finally:
                self.up = False
                self._went_down()
                if cause is not UP:
                    self._report(False, cause)
                if cause is not _FLOODED:  # a closing handshake would read the whole flood
                    with contextlib.suppress(Exception):
                        await within(_CLOSE_TIMEOUT_S, socket.close())
            return asyncio.get_event_loop().time() - start_s

    async def _open(self, session: aiohttp.ClientSession) -> Socket:
        tls: dict[str, Any] = {} if self._ssl_context is None else {"ssl": self._ssl_context}
        size = self._largest_message_bytes
        socket: aiohttp.ClientWebSocketResponse[Any] = await session.ws_connect(
            http_address(self._url), protocols=self.subprotocols, autoping=False, max_msg_size=size, **tls
        )
        return socket

    async def _talk(self, socket: Socket, moved: asyncio.Event) -> Cause:
        """Uses a new connection until it ends; returns why it ended."""
        wires = self._wires = asyncio.Queue(_MOST_WAITING)
        self._overflowed = asyncio.Event()
        silent = functools.partial(wait_until_unanswered, socket, self._heartbeat_s)
        ends = (
            self._read(socket),
            self._refusal(),
            _after(functools.partial(write, wires, socket), UP),
            _after(self._overflowed.wait, Cause("the server does not read what is sent to it")),
            _after(moved.wait, Cause("the address has changed")),
            _after(silent, self._cause_of(asyncio.TimeoutError())),
        )
        tasks = {asyncio.ensure_future(end) for end in ends}
        probation = asyncio.get_event_loop().call_later(self._probation_s, self._report, True, UP)
        try:
            self.up = True
            if not self._begin(socket.protocol):
                probation.cancel()
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            return next(iter(done)).result()
        finally:
            probation.cancel()
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
            self._wires = None

    async def _read(self, socket: Socket) -> Cause:
        incoming = Incoming(socket)
        while True:
            try:
                message = await incoming.next()
            except FloodError:
                return _FLOODED
            if message.type in _MESSAGES:
                try:
                    slow = self._receive(message.data)
                    if slow is not None:
                        await slow
                except MessageError as error:
                    text = printable(str(error))[:LONGEST_TEXT]
                    self._log.write("invalid", Severity.WARN, f"invalid message from {self.address}: {text}")
                except Exception as error:  # one message must not end the connection
                    text = f"a message from {self.address} was not processed: {_text(error)}"
                    self._log.write("failed", Severity.ERROR, text)
            else:
                failure = message.data if isinstance(message.data, BaseException) else socket.exception()
                if failure is not None:
                    return self._cause_of(failure)
                reason = message.extra if isinstance(message.extra, str) else ""
                return cause_of_close(socket.close_code, reason, bool(self._token))

    def _cause_of(self, error: BaseException) -> Cause:
        return cause_of_error(error, bool(self._token), self.server_kind)

    def _enqueue(self, wire: Wire) -> None:
        if self._wires is not None:
            try:
                self._wires.put_nowait(wire)
            except asyncio.QueueFull:
                self._overflowed.set()

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
    return printable(f"{type(error).__name__}: {error}")[:LONGEST_TEXT]
