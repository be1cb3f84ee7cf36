"""The open connections: a limited number, TLS, a limit for incomplete requests, and errors as JSON.

If the limit is reached, a new connection replaces the one that has waited for the longest time: for the token (or,
where none is required, for a complete request), whatever it has begun, or for its next request. Those that wait are
also closed after a timeout. WebSockets with the token, and requests with it that are being answered, are closed only if
their client reads nothing for a minute.

asyncio's own TLS servers do not show a connection before its handshake is complete; here TLS is started on a connection
that is already counted, so that it can be replaced by others.
"""

from __future__ import annotations

import asyncio
import logging
import resource
import socket
import ssl
from typing import Any, Callable

from aiohttp import web
from aiohttp.http_exceptions import LineTooLong

from ...runtime.http_answers import json_error

MOST_REQUEST_BYTES = 131_072
"""Size of a request, or of its head if its body is read later, and of a first message with the token."""
STALL_MS = 60_000
"""A client that takes nothing of what is sent to it for this long is disconnected, in ms.

Linux measures it: asyncio sees no progress while it sends a large answer.
"""
_NO_LOG = logging.Logger("rosbridge", logging.CRITICAL + 1)
"""aiohttp's own lines, which have tracebacks and quote what clients send."""


class Connections:
    """The open connections. Those that wait have presented nothing yet, or wait for the next request."""

    def __init__(
        self,
        limit: int,
        timeout_s: float,
        log: Callable[[str], None],
        call_later: Callable[..., Any],
        tls: ssl.SSLContext | None = None,
    ) -> None:
        """Starts without connections.

        Those that wait are closed after `timeout_s`. `log` bounds its lines. `call_later` is that of the loop. With
        `tls`, connections begin with a handshake.
        """
        self._limit = limit
        self.timeout_s = timeout_s
        self.log = log
        self.tls = tls
        self._call_later = call_later
        self._timeouts: dict[HttpConnection, asyncio.TimerHandle | None] = {}
        """What closes each; None for those in use. Those that have been waiting for the longest time come first."""

    def add(self, connection: HttpConnection) -> bool:
        """Adds a connection that waits; returns False if there is no room for it."""
        if len(self._timeouts) >= self._limit:
            self.log(f"connection limit reached; closing the oldest idle one (limit {self._limit})")
            oldest = next(filter(self.waits, self._timeouts), None)
            if oldest is None:
                return False
            oldest.abort()
        self._timeouts[connection] = self._timeout(connection)
        return True

    def set_in_use(self, connection: HttpConnection, in_use: bool) -> None:
        """Notes whether a connection is in use or waits: its timeout then begins anew."""
        if connection not in self._timeouts:
            return
        timeout = self._timeouts[connection]
        if timeout is not None:
            timeout.cancel()
        else:
            del self._timeouts[connection]  # one that has waited before keeps its place
        self._timeouts[connection] = None if in_use else self._timeout(connection)

    def waits(self, connection: HttpConnection) -> bool:
        """Returns whether a connection is open and not in use."""
        return self._timeouts.get(connection) is not None

    def abort_all(self) -> None:
        """Closes every connection at once."""
        for connection in tuple(self._timeouts):
            connection.abort()

    def remove(self, connection: HttpConnection) -> None:
        """Removes a connection that is closed."""
        timeout = self._timeouts.pop(connection, None)
        if timeout is not None:
            timeout.cancel()

    def _timeout(self, connection: HttpConnection) -> asyncio.TimerHandle:
        timeout: asyncio.TimerHandle = self._call_later(self.timeout_s, connection.abort)
        return timeout


def connection_limit(requested: int) -> int:
    """Returns a limit that leaves at least half of the process's file descriptors to others."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return requested if descriptors == resource.RLIM_INFINITY else max(1, min(requested, descriptors // 2))


class HttpConnection(web.RequestHandler):
    """A connection of aiohttp that one of `Connections` may be."""

    def __init__(self, create: web.Server, connections: Connections) -> None:
        """Starts before the connection is made."""
        loop = asyncio.get_event_loop()
        super().__init__(create, loop=loop, access_log=None, logger=_NO_LOG)  # type: ignore[arg-type]  # no access log
        self._connections = connections
        self._early: list[bytes] | None = []
        """What came before aiohttp knew of the connection; None once it does."""
        self._received = 0
        """Bytes since it began to wait."""
        self.on_resume: Callable[[], None] = lambda: None
        """Called when a client that has read too slowly reads again."""

    def set_in_use(self, in_use: bool) -> None:
        """Notes that it is in use, or that it waits for a request or the token."""
        self._received = 0
        self._connections.set_in_use(self, in_use)

    def resume_writing(self) -> None:
        """The buffer of the transport has emptied."""
        super().resume_writing()
        self.on_resume()

    def abort(self) -> None:
        """Closes the connection at once, at any stage."""
        self._connections.remove(self)
        self._tcp.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Counts the connection, and begins TLS; closes it if there is no room."""
        assert isinstance(transport, asyncio.Transport)
        self._tcp = transport
        transport.get_extra_info("socket").setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, STALL_MS)
        if not self._connections.add(self):
            transport.abort()
        elif self._connections.tls is None:
            self._begin(transport)
        else:
            self._tls_start = asyncio.ensure_future(self._start_tls(transport, self._connections.tls))

    async def _start_tls(self, tcp: asyncio.Transport, context: ssl.SSLContext) -> None:
        try:
            transport = await asyncio.get_event_loop().start_tls(
                tcp, self, context, server_side=True, ssl_handshake_timeout=self._connections.timeout_s
            )
        except OSError:
            transport = None
        # The connection may have ended during the handshake, which Python 3.8 reports as success.
        if transport is None or tcp.is_closing():
            self.abort()
        else:
            self._begin(transport)

    def _begin(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        early, self._early = self._early, None
        for data in early or ():
            self.data_received(data)

    def connection_lost(self, exc: BaseException | None) -> None:
        """The connection is closed."""
        self._connections.remove(self)
        if self._early is None:
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Takes data, up to the limit while the server waits for a request or the token."""
        if self._early is not None:
            self._early.append(data)
            return
        if self._connections.waits(self):
            self._received += len(data)
            if self._received > MOST_REQUEST_BYTES:
                self._connections.log(f"disconnected a client: its request is larger than {MOST_REQUEST_BYTES} bytes")
                self.abort()
                return
        super().data_received(data)

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = 500,
        exc: BaseException | None = None,
        message: str | None = None,
    ) -> web.StreamResponse:
        """Answers a request that is malformed, or whose handler failed, in the form of docs/reference/api.md."""
        super().handle_error(request, status, exc, message)
        text = "malformed request" if status < 500 else "internal error"
        if not isinstance(exc, ConnectionError):  # otherwise the client has gone
            self._connections.log(f"refused a request of {request.remote}: {text} ({type(exc).__name__})")
        response = json_error(status, "address or header too long" if isinstance(exc, LineTooLong) else text)
        response.force_close()
        return response
