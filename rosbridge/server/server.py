"""The rosbridge server: serves one node's middleware to any number of clients over WebSockets.

One event loop does everything except what takes long: calls of the middleware, and encoding and decoding of large
messages, run in worker threads. A topic is subscribed to once and each message is encoded once per encoding
(`topics.py`). Each client has a session (`session.py`) with a bounded send queue (`sending.py`).

aiohttp carries the WebSockets: its interface is stable from Python 3.8 on, and it costs the least CPU per message of
the libraries that have rosdep keys. Frames are not compressed (permessage-deflate), which costs more than it saves for
small messages.
"""

from __future__ import annotations

import asyncio
import concurrent.futures
import contextlib
import functools
import logging
import ssl
import time
from typing import Any, Awaitable, Callable, Mapping, Sequence

from aiohttp import WSCloseCode, WSMsgType, web

from ...core.port import LimitedLog, LogLine, ServedMiddleware, Severity
from ...core.values import ConfigError, JsonObject, MessageError, ServiceError, printable
from ...runtime.access import READ_ONLY, Access, Client, Credentials, TokenCheck, is_loopback, refusal_of
from ...runtime.event_loops import LoopThread
from ...runtime.http_answers import json_error
from ...runtime.sockets import FloodError, Incoming, limit_reads
from ..protocol import CBOR_SUBPROTOCOL, DEFAULT_LIMITS, SUBPROTOCOLS, Limits
from .connections import Connections, HttpConnection, connection_limit
from .served_node import ServedNode
from .services import Services
from .session import Session
from .topics import Topics

_LOG_LINES_PER_MINUTE = 10
_LONGEST_LOG_LINE = 500
_CLOSE_HANDSHAKE_S = 0.5
_CLOSE_S = 1.0
_CLOSE_THREAD_S = 4.0
# It warns about the subprotocols of every client that offers others than the server's, and quotes them.
logging.getLogger("aiohttp.websocket").setLevel(logging.ERROR)


class Server:
    """Serves one node to rosbridge clients, and further HTTP routes on the same port."""

    def __init__(
        self,
        middleware: ServedMiddleware,
        *,
        host: str = "127.0.0.1",
        port: int = 9090,
        access: Access | None = None,
        limits: Limits = DEFAULT_LIMITS,
        threads: bool = True,
        ssl_context: ssl.SSLContext | None = None,
        parameters: Callable[[], Mapping[str, JsonObject]] | None = None,
        routes: Callable[[Callable[[web.Request], Client]], Sequence[web.RouteDef]] = lambda client_of: (),
        on_close: Callable[[], None] = lambda: None,
    ) -> None:
        """Prepares a server; `start` opens the port.

        Args:
            middleware: a node for the server; not closed here.
            host: address to listen on. All except loopback require a token.
            port: 0 picks a free one.
            access: what clients may do; they may only read if it is None.
            limits: limits for one client and for all of them.
            threads: whether the middleware calls back from its own threads (ROS), not in the server's loop.
            ssl_context: serve TLS (`wss://`) with it.
            parameters: returns the parameters that clients may read, per node; None for those of `middleware`.
            routes: returns HTTP routes. Host, origin and a wrong token are checked here; a handler that needs a token
                gets the `Client` of the request from the function that is passed.
            on_close: called in the loop before connections are closed, to end the long answers of `routes`.

        Raises:
            ConfigError: `host` is reachable from other machines, but no token is required.
        """
        self.access = access or READ_ONLY
        self.port = port
        """The port; after `start` the real one."""
        self._host = host
        self._require_protection(self.access.token)
        self._tokens = TokenCheck(self.access.token)
        self._client = functools.partial(Client, self._tokens)
        self._limits = limits
        self._ssl_context = ssl_context
        self._routes = routes
        self._on_close = on_close
        # Several nodes of one ROS 1 process share its log.
        self._log_prefix = "rosbridge: " if threads else ""
        self._client_log = LimitedLog(middleware.log, time.monotonic, _LOG_LINES_PER_MINUTE)
        self._sessions: dict[Session, web.WebSocketResponse] = {}
        self._runner: web.AppRunner | None = None
        self._node = ServedNode(
            middleware, threads=threads, access=self.access, limits=limits, parameters=parameters, log=self.log
        )

    async def start(self) -> None:
        """Opens the port; raises OSError if it is in use, or the address is not one of this machine."""
        loop = asyncio.get_event_loop()
        self._topics = Topics(self._node)
        self.services = Services(self._node)
        """The services as clients see them."""
        most = connection_limit(self._limits.clients)
        timeout_s = self._limits.request_timeout_s
        self._connections = Connections(most, timeout_s, self.log, loop.call_later, self._ssl_context)
        application = web.Application(middlewares=[self._check])
        application.add_routes(self._routes(self._client))
        runner = web.AppRunner(application, handle_signals=False)
        await runner.setup()
        assert runner.server is not None
        accept = functools.partial(HttpConnection, runner.server, self._connections)
        try:
            self._listener = await loop.create_server(accept, self._host, self.port)
        except OSError:
            await runner.cleanup()
            raise
        self._runner = runner
        self.port = self._listener.sockets[0].getsockname()[1]

    def use_token(self, token: str) -> None:
        """Requires another token, and disconnects every client; raises ConfigError as `Server`. Call in the loop."""
        self._require_protection(token)
        self._tokens.use(token)
        self._connections.abort_all()

    async def close(self) -> None:
        """Closes the port, then every connection, within two seconds. May be called twice."""
        runner, self._runner = self._runner, None
        if runner is None:
            return
        self._on_close()
        for listening in self._listener.sockets:
            asyncio.get_event_loop().remove_reader(listening.fileno())
        await asyncio.sleep(0)  # asyncio fails if it closes the listener before it has created the last transport
        self._listener.close()
        closing = [
            asyncio.ensure_future(socket.close(code=WSCloseCode.GOING_AWAY)) for socket in self._sessions.values()
        ]
        if closing:
            await asyncio.wait(closing, timeout=_CLOSE_HANDSHAKE_S)
        self._connections.abort_all()
        await asyncio.wait({asyncio.ensure_future(runner.cleanup())}, timeout=_CLOSE_S)
        self._connections.abort_all()
        await asyncio.sleep(0)  # aborted connections are closed in the next turn of the loop
        self._node.close()

    @property
    def clients(self) -> int:
        """Number of connected clients."""
        return len(self._sessions)

    @property
    def dropped(self) -> int:
        """Messages that were dropped, because a client reads too slowly or a message is too large or too frequent."""
        sessions = sum(session.queue.dropped for session in self._sessions)
        return self._node.dropped + self._node.messages.dropped + sessions

    def publish_log(self, line: LogLine) -> None:
        """Publishes a log line on `/rosout`, for a middleware without this topic. Called in the loop's thread."""
        self._topics.publish_log(line)

    def log(self, text: str) -> None:
        """Writes a WARN line, unless clients, who choose the texts, have caused too many in this minute."""
        line = " ".join(text[:_LONGEST_LOG_LINE].split())
        self._client_log.write("", Severity.WARN, printable(f"{self._log_prefix}{line}"))

    def _require_protection(self, token: str) -> None:
        if not is_loopback(self._host) and not token:
            raise ConfigError(f"address {self._host} is reachable from other machines: expected a token")

    @web.middleware
    async def _check(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Serves a request, unless its host, origin or token is wrong, or it is for a WebSocket and has no token.

        The cookie does not open a WebSocket: pages of other origins may connect.
        """
        problem = refusal_of(request, self.access, check_host=not self._tokens.required)
        client = self._client(request)
        is_socket = request.method == "GET" and bool(web.WebSocketResponse().can_prepare(request))
        if problem:
            refusal = json_error(403, problem)
        elif client.token is Credentials.WRONG or (is_socket and client.token is Credentials.MISSING):
            problem, refusal = f"{client.token.value} token", client.refusal()
        if problem:
            self.log(f"refused a client at {request.remote}: {problem}")
            return refusal
        connection = request.protocol
        assert isinstance(connection, HttpConnection)
        connection.set_in_use(client.admitted)
        try:
            response = await (self._serve(request, connection) if is_socket else handler(request))
            await response.prepare(request)  # aiohttp would send it when the connection is no longer in use
            await response.write_eof()
            return response
        except (web.HTTPException, ConfigError, MessageError, ServiceError) as error:
            return _refuse(error)
        finally:
            connection.set_in_use(False)

    async def _serve(self, request: web.Request, connection: HttpConnection) -> web.StreamResponse:
        """Serves one WebSocket until it is closed."""
        socket = web.WebSocketResponse(
            timeout=_CLOSE_S,
            heartbeat=self._limits.heartbeat_s,
            autoping=False,
            max_msg_size=self._limits.message_bytes,
            compress=False,
            protocols=SUBPROTOCOLS,
        )
        await socket.prepare(request)
        transport = request.transport
        if transport is None:
            return socket
        limit_reads(transport)
        cbor = socket.ws_protocol == CBOR_SUBPROTOCOL
        session = Session(self._node, self._topics, self.services, transport, cbor=cbor)
        connection.on_resume = session.resume
        incoming = Incoming(socket)
        self._sessions[session] = socket
        try:
            message = await incoming.next()
            while message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                await session.receive(message.data)
                message = await incoming.next()
        except FloodError:
            self.log(f"disconnected a client at {request.remote}: it floods the server with pings or empty messages")
            transport.abort()
        finally:
            del self._sessions[session]
            self._node.dropped += session.queue.dropped
            await asyncio.shield(session.close())
        return socket


class ServerThread:
    """Runs a server in a thread until `close`, for processes whose main thread runs ROS."""

    def __init__(self, server: Server) -> None:
        """Starts a server; raises OSError as `Server.start` does."""
        self.server = server
        self._thread = LoopThread()
        self._thread.loop.set_exception_handler(self._log_failure)
        try:
            self._thread.call(server.start())
        except BaseException:
            self._thread.close()
            raise

    def close(self) -> None:
        """Closes the port, then every connection. May be called twice."""
        if not self._thread.alive:
            return
        with contextlib.suppress(concurrent.futures.TimeoutError):  # the thread's end closes what is left
            self._thread.call(self.server.close(), _CLOSE_THREAD_S)
        self._thread.close()

    def _log_failure(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        cause = f": {type(error).__name__}: {error}" if error else ""
        self.server.log(f"{context.get('message', 'unexpected error')}{cause}")


def _refuse(error: Exception) -> web.Response:
    """Answers a request for which there is no route, or whose handler failed."""
    status = 503 if isinstance(error, ServiceError) else getattr(error, "status", 400)
    headers = {"Allow": error.headers["Allow"]} if isinstance(error, web.HTTPMethodNotAllowed) else {}
    return json_error(status, error.problem if isinstance(error, ConfigError) else str(error), headers)
