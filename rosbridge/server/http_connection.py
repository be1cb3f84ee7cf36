"""One accepted connection: counted from the first moment, TLS, a limit for incomplete requests, errors as JSON.

asyncio's own TLS servers do not show a connection before its handshake is complete; here TLS is started on a connection
that is already counted, so that it can be replaced by others.
"""

from __future__ import annotations

import asyncio
import json
import ssl
from typing import Any, Callable, List, Mapping, Optional

from aiohttp import web
from aiohttp.http_exceptions import LineTooLong

from .connections import Connections

MOST_REQUEST_BYTES = 131_072
"""Size of a request, or of its head if its body is read later, and of a first message with the token."""


class HttpConnection(web.RequestHandler):
    """A connection of aiohttp that one of `Connections` may be."""

    def __init__(
        self,
        create: web.Server,
        connections: Connections,
        log: Callable[[str], None],
        ssl_context: Optional[ssl.SSLContext],
        handshake_timeout_s: float,
        **options: Any,
    ) -> None:
        """Starts before the connection is made.

        Args:
            create: the server of aiohttp.
            connections: the open ones.
            log: writes one line.
            ssl_context: for TLS; None: without.
            handshake_timeout_s: longest handshake, in s.
            options: those of aiohttp's RequestHandler.
        """
        super().__init__(create, **options)
        self._connections = connections
        self._log = log
        self._ssl_context = ssl_context
        self._handshake_timeout_s = handshake_timeout_s
        self._tcp: Optional[asyncio.Transport] = None
        self._early: Optional[List[bytes]] = []
        """What came before aiohttp knew of the connection; None: it does."""
        self._counted_since_s: Optional[float] = None
        self._received = 0

    def abort(self) -> None:
        """Closes the connection at once, at any stage."""
        if self._tcp is not None:
            self._tcp.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Counts the connection, and begins TLS."""
        assert isinstance(transport, asyncio.Transport)
        if not self._connections.add(self):
            if self._ssl_context is None:
                transport.write(_plain_error(503, "Service Unavailable", "too many clients"))
            transport.close()
            return
        self._tcp = transport
        if self._ssl_context is None:
            self._begin(transport)
        else:
            self._tls_start = asyncio.ensure_future(self._start_tls(transport, self._ssl_context))

    async def _start_tls(self, tcp: asyncio.Transport, context: ssl.SSLContext) -> None:
        loop = asyncio.get_event_loop()
        try:
            transport = await loop.start_tls(
                tcp, self, context, server_side=True, ssl_handshake_timeout=self._handshake_timeout_s
            )
        except OSError:
            transport = None
        # The connection may have ended during the handshake, which Python 3.8 reports as success.
        if transport is None or tcp.is_closing():
            self._connections.remove(self)
            tcp.abort()
        else:
            self._begin(transport)

    def _begin(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        early, self._early = self._early, None
        for data in early or ():
            self.data_received(data)

    def connection_lost(self, exc: Optional[BaseException]) -> None:
        """The connection is closed."""
        self._connections.remove(self)
        if self._early is None:
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Takes data, up to the limit while the server waits for a request or the token."""
        if self._early is not None:
            self._early.append(data)
            return
        since_s = self._connections.waiting_since_s(self)
        if since_s is not None:
            if since_s != self._counted_since_s:
                self._counted_since_s, self._received = since_s, 0
            self._received += len(data)
            if self._received > MOST_REQUEST_BYTES:
                self._refuse_size()
                return
        super().data_received(data)

    def _refuse_size(self) -> None:
        text = f"request is larger than {MOST_REQUEST_BYTES} bytes"
        self._log(f"disconnected a client: its {text}")
        if self.transport is not None:
            self.transport.write(_plain_error(413, "Request Entity Too Large", f"the {text}"))
            self.transport.close()

    def handle_error(
        self,
        request: web.BaseRequest,
        status: int = 500,
        exc: Optional[BaseException] = None,
        message: Optional[str] = None,
    ) -> web.StreamResponse:
        """Answers a request that is malformed, or whose handler failed, in the form of docs/reference/api.md."""
        super().handle_error(request, status, exc, message)
        text = "malformed request" if status < 500 else "internal error"
        response = json_error(status, "address or header too long" if isinstance(exc, LineTooLong) else text)
        response.force_close()
        return response


def json_error(status: int, text: str, headers: Optional[Mapping[str, str]] = None) -> web.Response:
    """Returns a refusal as docs/reference/api.md describes it: HTTP status, reason, further headers."""
    return web.json_response({"error": text}, status=status, headers={"Cache-Control": "no-store", **(headers or {})})


def _plain_error(status: int, phrase: str, text: str) -> bytes:
    """Returns the same as `json_error`, for a connection whose request is not read."""
    body = json.dumps({"error": text})
    head = f"HTTP/1.1 {status} {phrase}\r\nConnection: close\r\nContent-Type: application/json"
    return f"{head}\r\nContent-Length: {len(body)}\r\n\r\n{body}".encode("ascii")
