"""The open connections: a limited number, TLS, a limit for incomplete requests, errors as JSON, and their log lines.

If the limit is reached, a new connection replaces the oldest one that has presented least: first connections that have
not presented the token (or, where none is required, no complete request), whatever they have begun; then those that
wait for the next request; then WebSockets that have sent no operation. The first two are also closed after a timeout.

asyncio's own TLS servers do not show a connection before its handshake is complete; here TLS is started on a connection
that is already counted, so that it can be replaced by others.
"""

from __future__ import annotations

import asyncio
import enum
import json
import logging
import resource
import ssl
import time
from typing import Callable, Dict, List, Mapping, Optional, Tuple

from aiohttp import web
from aiohttp.http import HttpProcessingError
from aiohttp.http_exceptions import LineTooLong

from ...core.port.log_limit import LogLimit
from ...core.values.formatting import printable

MOST_REQUEST_BYTES = 131_072
"""Size of a request, or of its head if its body is read later, and of a first message with the token."""
_LONGEST_LOG_LINE = 500

CallLater = Callable[[float, Callable[[], None]], asyncio.TimerHandle]


class Stage(enum.IntEnum):
    """What a connection has presented. Lower ones are closed first."""

    OPENED = 0
    """Nothing yet, or not the token: in the TLS handshake, within a request, or served without a token. Closed after
    the timeout."""
    KNOWN = 1
    """It has presented the token, and waits for its next request. Closed after the timeout."""
    ACCEPTED = 2
    """It may send operations, but has sent none."""
    ACTIVE = 3
    """It is in use. Never closed for others."""


class Connections:
    """The open connections, in each stage the oldest first."""

    def __init__(self, limit: int, timeout_s: float, call_later: CallLater, on_full: Callable[[], None]) -> None:
        """Starts without connections.

        Those in the stages OPENED and KNOWN are closed after `timeout_s`. `on_full` is called when the limit is
        reached, once until the number falls below nine tenths of it. `call_later` is that of the loop.
        """
        self._limit = limit
        self._timeout_s = timeout_s
        self._call_later = call_later
        self._on_full = on_full
        self._full = False
        self._stages: Dict[HttpConnection, Tuple[Stage, Optional[asyncio.TimerHandle]]] = {}
        """Stage and timeout of each, in the order in which they entered their stage."""

    def __len__(self) -> int:
        return len(self._stages)

    def add(self, connection: HttpConnection) -> bool:
        """Adds a connection, in stage OPENED; returns False if there is no room for it."""
        if len(self._stages) < 0.9 * self._limit:
            self._full = False
        if len(self._stages) >= self._limit:
            if not self._full:
                self._full = True
                self._on_full()
            oldest = min(self._stages, key=lambda one: self._stages[one][0])  # the first of those with the lowest stage
            if self._stages[oldest][0] is Stage.ACTIVE:
                return False
            self.abort(oldest)
        self._enter(connection, Stage.OPENED)
        return True

    def set_stage(self, connection: HttpConnection, stage: Stage) -> None:
        """Changes the stage of a connection; its timeout begins anew, also in the same stage."""
        before, timeout = self._stages.get(connection, (None, None))
        if before is None:
            return
        if timeout is not None:
            timeout.cancel()
        if before is not stage:
            del self._stages[connection]  # in the same stage it keeps its place
        self._enter(connection, stage)

    def _enter(self, connection: HttpConnection, stage: Stage) -> None:
        waits = stage <= Stage.KNOWN
        timeout = self._call_later(self._timeout_s, lambda: self.abort(connection)) if waits else None
        self._stages[connection] = stage, timeout

    def timeout(self, connection: HttpConnection) -> Optional[asyncio.TimerHandle]:
        """Returns what closes a connection in stage OPENED or KNOWN; None in any other stage."""
        return self._stages.get(connection, (None, None))[1]

    def abort(self, connection: HttpConnection) -> None:
        """Closes a connection at once."""
        self.remove(connection)
        connection.abort()

    def abort_all(self) -> None:
        """Closes every connection at once."""
        for connection in tuple(self._stages):
            self.abort(connection)

    def remove(self, connection: HttpConnection) -> None:
        """Removes a connection that is closed."""
        _, timeout = self._stages.pop(connection, (None, None))
        if timeout is not None:
            timeout.cancel()


def connection_limit(requested: int) -> int:
    """Returns a limit that leaves at least half of the process's file descriptors to others."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return requested if descriptors == resource.RLIM_INFINITY else max(1, min(requested, descriptors // 2))


class HttpConnection(web.RequestHandler):
    """A connection of aiohttp that one of `Connections` may be."""

    def __init__(
        self,
        create: web.Server,
        connections: Connections,
        log: ClientLog,
        ssl_context: Optional[ssl.SSLContext],
        handshake_timeout_s: float,
    ) -> None:
        """Starts before the connection is made; without TLS if `ssl_context` is None."""
        loop = asyncio.get_event_loop()
        super().__init__(create, loop=loop, access_log=None, logger=log.logger)  # type: ignore[arg-type]  # no log
        self._connections = connections
        self._log = log
        self._ssl_context = ssl_context
        self._handshake_timeout_s = handshake_timeout_s
        self._tcp: Optional[asyncio.Transport] = None
        self._early: Optional[List[bytes]] = []
        """What came before aiohttp knew of the connection; None: it does."""
        self._counted: Optional[asyncio.TimerHandle] = None
        """The timeout during which data is counted."""
        self._received = 0
        self.on_resume: Callable[[], None] = lambda: None
        """Called when a client that has read too slowly reads again."""

    def resume_writing(self) -> None:
        """The buffer of the transport has emptied."""
        super().resume_writing()
        self.on_resume()

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
        timeout = self._connections.timeout(self)
        if timeout is not None:
            if timeout is not self._counted:
                self._counted, self._received = timeout, 0
            self._received += len(data)
            if self._received > MOST_REQUEST_BYTES:
                text = f"request is larger than {MOST_REQUEST_BYTES} bytes"
                self._log.write(f"disconnected a client: its {text}")
                if self.transport is not None:
                    self.transport.write(_plain_error(413, "Request Entity Too Large", f"the {text}"))
                    self.transport.close()
                return
        super().data_received(data)

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


class ClientLog(logging.Handler):
    """Writes at most a number of lines per minute, in total: clients choose the texts. Used in the event loop only."""

    def __init__(
        self, write: Callable[[str], None], lines_per_minute: int = 10, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Starts with nothing written; `clock` returns monotonic seconds."""
        super().__init__()
        self._write = write
        self._limit = LogLimit(lines_per_minute, clock)
        self.logger = logging.Logger("rosbridge", logging.WARNING)
        """For a library: each record of level WARN or worse is one line, without traceback."""
        self.logger.addHandler(self)

    def write(self, text: str) -> None:
        """Writes a line, unless too many were written in the current minute."""
        left_out = self._limit.take()
        if left_out:
            self._write(f"{left_out} more lines about clients were suppressed")
        if left_out is not None:
            self._write(printable(" ".join(text[:_LONGEST_LOG_LINE].split())))

    def emit(self, record: logging.LogRecord) -> None:
        """Writes a record of `logger`."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, ConnectionError):
            return  # the client has gone
        if isinstance(error, HttpProcessingError):
            self.write(f"refused a malformed HTTP request ({type(error).__name__})")
            return
        text = next(iter(record.getMessage().splitlines()), "")[:200]
        self.write(f"{text}: {type(error).__name__}" if error else text)
