"""The rosbridge server: shows one node's middleware to any number of clients over WebSockets.

Theory of operation. One event loop does everything. A topic is subscribed to once, however many clients want it, and
each of its messages is encoded and framed once per encoding (`topics.py`). Each client has a session (`session.py`) and
a bounded outbox (`outbox.py`); while any outbox holds something, `_attend` empties it as fast as its client reads,
and cuts off a client that stays behind. What the middleware is asked goes through `node_access.py`, so that nothing in
it can stop the loop.

aiohttp carries the WebSockets: its interface has been the same from Python 3.8 to today, and of the three libraries
that ROS has keys for it costs the least CPU per message. Compression of frames (permessage-deflate) stays off: it
costs more than small messages gain.
"""

from __future__ import annotations

import asyncio
import ssl
import time
from typing import Any, Callable, Dict, Mapping, Optional, Set

from aiohttp import WSCloseCode, WSMsgType, web

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import (
    Graph,
    Message,
    NodeInfo,
    ServedMiddleware,
    Severity,
    Subscription,
    resolve_name,
)

from ..protocol.connection import CBOR_SUBPROTOCOL
from ..protocol.definitions import canonical, full_text, serializer
from ..protocol.errors import Id, ProtocolError
from ..protocol.limits import DEFAULT_LIMITS, Limits
from .access import Access, allowed, is_loopback
from .client_services import Offers
from .frames import FrameMaker
from .node_access import NodeAccess
from .rosapi import PREFIX, Rosapi
from .session import Session
from .subscriptions import Options
from .topics import Topic

ROSOUT = "/rosout"
ROSOUT_TYPE = "rosgraph_msgs/Log"
_LOG_LEVELS = {Severity.DEBUG: 1, Severity.INFO: 2, Severity.WARN: 4, Severity.ERROR: 8, Severity.FATAL: 16}
"""Severity as rosgraph_msgs/Log has it."""
_ATTEND_PERIOD_S = 0.02
_SWEEP_PERIOD_S = 1.0
_LOG_PERIOD_S = 1.0
_GRACE_S = 0.5
"""For a middleware to say itself that a service did not answer."""


class _Feed:
    """A topic and the middleware's subscriptions that feed it."""

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.messages: Optional[Subscription] = None
        self.raw: Optional[Subscription] = None
        self.lock = asyncio.Lock()


class Server:
    """Serves one node to rosbridge clients."""

    def __init__(
        self,
        middleware: ServedMiddleware,
        *,
        host: str = "127.0.0.1",
        port: int = 9090,
        access: Optional[Access] = None,
        limits: Limits = DEFAULT_LIMITS,
        threads: bool = True,
        queue_bytes: int = 1_000_000,
        behind_s: float = 10.0,
        heartbeat_s: float = 10.0,
        call_timeout_s: float = 10.0,
        most_clients: int = 500,
        ssl_context: Optional[ssl.SSLContext] = None,
        parameters: Optional[Callable[[], Mapping[str, Mapping[str, Any]]]] = None,
    ) -> None:
        """Prepares a server; `start` opens the port.

        Args:
            middleware: a node of its own for the server; the server does not close it.
            host: address to listen on. Other than loopback, it needs a token or certificates of clients.
            port: 0 picks a free one.
            access: what clients may do besides reading; None: nothing.
            limits: what one client may ask for.
            threads: whether the middleware has threads of its own (ROS); False for one that lives in the loop.
            queue_bytes: most bytes that wait for one client that reads slowly; then its oldest are dropped.
            behind_s: a client that has had messages waiting for so long without a break is cut off, in s.
            heartbeat_s: period of pings, in s; a client that does not answer one within half of it is gone.
            call_timeout_s: how long a service call may take, in s, when the client does not say.
            most_clients: more connections than this are refused.
            ssl_context: serve TLS (`wss://`) with it.
            parameters: per node the parameters that clients may look at; None: those of `middleware`.

        Raises:
            ConfigError: `host` is open to others, and neither a token nor clients' certificates protect it.
        """
        self.access = access or Access()
        verified = ssl_context is not None and ssl_context.verify_mode == ssl.CERT_REQUIRED
        if not is_loopback(host) and not self.access.token and not verified:
            raise ConfigError(
                f"found the address {host}, which others can reach, without protection; allowed is 127.0.0.1, or a "
                "token, or TLS that asks clients for a certificate"
            )
        self.limits = limits
        self.queue_bytes = queue_bytes
        self.frame_maker = FrameMaker()
        self.offers = Offers()
        self.port = port
        """The port; after `start` the real one."""
        self._middleware = middleware
        self._host = host
        self._threads = threads
        self._behind_s = behind_s
        self._heartbeat_s = heartbeat_s
        self._call_timeout_s = call_timeout_s
        self._most_clients = most_clients
        self._ssl_context = ssl_context
        self._rosapi = Rosapi(self._graph, self._definition, parameters or self._own_parameters, time.time)
        self._sessions: Set[Session] = set()
        self._sockets: Dict[Session, web.WebSocketResponse] = {}
        self._feeds: Dict[str, _Feed] = {}
        self._advertised: Dict[str, str] = {}
        self._behind: Set[Session] = set()
        self._attending = False
        self._seen_s: Dict[Any, float] = {}
        self._logged_s: Dict[str, float] = {}

    async def start(self) -> None:
        """Opens the port.

        Raises:
            OSError: it is taken, or the address is not this machine's.
        """
        self._loop = asyncio.get_event_loop()
        self._node = NodeAccess(self._loop, threads=self._threads)
        application = web.Application()
        application.router.add_get("/{path:.*}", self._accept)
        self._runner = web.AppRunner(application, access_log=None, handle_signals=False)
        await self._runner.setup()
        site = web.TCPSite(self._runner, self._host, self.port, ssl_context=self._ssl_context)
        await site.start()
        self.port = self._runner.addresses[0][1]
        self._sweeper = self._loop.call_later(_SWEEP_PERIOD_S, self._sweep)

    async def close(self) -> None:
        """Says goodbye to every client and closes the port."""
        self._sweeper.cancel()
        goodbyes = [socket.close(code=WSCloseCode.GOING_AWAY) for socket in self._sockets.values()]
        if goodbyes:
            await asyncio.wait([asyncio.ensure_future(goodbye) for goodbye in goodbyes], timeout=0.5)
        for session in tuple(self._sessions):
            session.transport.abort()
        await self._runner.cleanup()
        self._node.close()

    @property
    def clients(self) -> int:
        """How many clients are connected."""
        return len(self._sessions)

    def publish_log(self, line: LogLine) -> None:
        """Shows a log line on `/rosout`, for a middleware that has no such topic. Called in the loop's thread."""
        feed = self._feeds.get(ROSOUT)
        if feed is not None:
            nanoseconds = time.time_ns()
            stamp = {"secs": nanoseconds // 1_000_000_000, "nsecs": nanoseconds % 1_000_000_000}
            feed.topic.deliver(
                {
                    "header": {"seq": 0, "stamp": stamp, "frame_id": ""},
                    "level": _LOG_LEVELS[line.severity],
                    "name": line.node,
                    "msg": line.text,
                    "file": "",
                    "function": "",
                    "line": 0,
                    "topics": [],
                }
            )

    def log(self, text: str) -> None:
        """Writes a WARN line, the same one at most once a second: clients must not flood the log."""
        now_s = time.monotonic()
        if now_s - self._logged_s.get(text, float("-inf")) < _LOG_PERIOD_S:
            return
        if len(self._logged_s) >= 100:
            self._logged_s.clear()
        self._logged_s[text] = now_s
        self._middleware.log(Severity.WARN, f"rosbridge: {text}")

    # What sessions ask for

    async def subscribe(self, session: Session, topic: str, type_name: str, options: Optional[Options]) -> None:
        """Has a topic's messages sent to a session as `options` say; None: not any more.

        Raises:
            ProtocolError: the type is not known, or is not the topic's.
        """
        while True:
            feed = self._feeds.get(topic)
            if feed is None:
                if options is None:
                    return
                feed = self._feeds.setdefault(topic, _Feed(await self._new_topic(topic, type_name)))
            elif options is not None:
                _require_same_type(topic, feed.topic.type_name, type_name)
            async with feed.lock:
                if self._feeds.get(topic) is feed:
                    await self._set_options(feed, session, options)
                    return
            # Its last client has left while this one waited: once more, from the start.

    def resolve(self, name: str) -> str:
        """Returns the absolute name of a topic or service that a client may have named relatively, as roslibjs does."""
        return resolve_name(name, self._middleware.name)

    async def topic_type(self, topic: str) -> str:
        """Returns the type of a topic, empty when it is not known."""
        graph = await self._node.call(self._graph)
        return graph.topics.get(self.resolve(topic), "")

    async def advertise(self, topic: str, type_name: str, id: Id) -> None:  # noqa: A002 - the protocol's own word
        """Announces that a client will publish.

        Raises:
            ProtocolError: it may not, or the type is not known, or is not the topic's.
        """
        topic = self.resolve(topic)
        if not allowed(topic, self.access.publish):
            raise ProtocolError(f"{topic} may not be published on from here", "advertise", id)
        known = self._advertised.get(topic) or await self.topic_type(topic)
        if known and canonical(known) != canonical(type_name):
            raise ProtocolError(f"{topic} is of type {known}, not {type_name}", "advertise", id)
        try:
            await self._node.call(self._middleware.advertise, topic, type_name)
        except ConfigError as error:
            raise ProtocolError(str(error), "advertise", id) from None
        self._advertised[topic] = type_name

    async def publish(self, topic: str, message: Message, id: Id) -> None:  # noqa: A002 - the protocol's own word
        """Publishes a client's message.

        Raises:
            ProtocolError: it does not fit its type.
        """
        try:
            await self._node.call(self._middleware.publish, topic, message)
        except (ValueError, TypeError) as error:
            raise ProtocolError(str(error), "publish", id) from None

    async def call(self, service: str, request: Mapping[str, Any], timeout_s: Optional[float]) -> Any:
        """Calls a service for a client and returns the response.

        Raises:
            ValueError: it may not be called, is not there, failed or did not answer in time.
        """
        timeout_s = min(timeout_s or self._call_timeout_s, self._call_timeout_s)
        service = self.resolve(service.partition("#")[0])  # an older way to send an id: /service#id
        if service.startswith(PREFIX):
            return await self._node.call(self._rosapi.answer, service, request.get("", request))
        if service in self.offers.types:
            return await self.offers.call(service, request, timeout_s)
        if not allowed(service, self.access.services):
            raise ValueError(f"{service} may not be called from here")
        return await self._node.call_service(
            self._middleware.call_service, service, "", request, timeout_s, timeout_s=timeout_s + _GRACE_S
        )

    def watch(self, session: Session) -> None:
        """Attends to a session that is behind."""
        if session.outbox.behind_since_s is None:
            session.outbox.behind_since_s = self._loop.time()
        self._behind.add(session)
        if not self._attending:
            self._attending = True
            self._loop.call_later(_ATTEND_PERIOD_S, self._attend)

    # Connections

    async def _accept(self, request: web.Request) -> web.StreamResponse:
        refusal = self._refusal(request)
        if refusal is not None:
            return refusal
        socket = web.WebSocketResponse(
            heartbeat=self._heartbeat_s,
            max_msg_size=self.limits.message_bytes,
            compress=False,
            protocols=[CBOR_SUBPROTOCOL],
        )
        if not socket.can_prepare(request):
            return web.Response(status=426, text="This is a rosbridge server: connect with a WebSocket.\n")
        await socket.prepare(request)
        transport = request.transport
        if transport is None:
            return socket
        cbor = socket.ws_protocol == CBOR_SUBPROTOCOL
        session = Session(self, transport, authenticated=self._shows_token(request), cbor=cbor)
        self._sessions.add(session)
        self._sockets[session] = socket
        try:
            async for message in socket:
                if message.type in (WSMsgType.TEXT, WSMsgType.BINARY):
                    await session.receive(message.data)
        finally:
            self._sessions.discard(session)
            self._behind.discard(session)
            del self._sockets[session]
            await asyncio.shield(session.close())
        return socket

    def _refusal(self, request: web.Request) -> Optional[web.Response]:
        origin = request.headers.get("Origin", "")
        if not self.access.origin_allowed(origin):
            self.log(f"a page of {origin[:100]} was refused")
            return web.Response(status=403, text="Pages of this origin may not connect.\n")
        if len(self._sessions) >= self._most_clients:
            self.log(f"a client was refused: there are {self._most_clients}")
            return web.Response(status=503, text="Too many clients.\n")
        offers_token = "Authorization" in request.headers or "token" in request.query
        if offers_token and not self._shows_token(request):
            self.log(f"a client at {request.remote} was refused: wrong token")
            return web.Response(status=401, text="Wrong token.\n", headers={"WWW-Authenticate": "Bearer"})
        return None

    def _shows_token(self, request: web.Request) -> bool:
        return self.access.token_allowed(request.headers, request.query)

    def _attend(self) -> None:
        """Empties outboxes as far as their clients read, and cuts off those that stay behind."""
        now_s = self._loop.time()
        for session in tuple(self._behind):
            outbox = session.outbox
            outbox.flush()
            if not outbox.behind:
                outbox.behind_since_s = None
                self._behind.discard(session)
                session.tell_of_losses()
            elif outbox.behind_since_s is not None and now_s - outbox.behind_since_s > self._behind_s:
                self._behind.discard(session)
                self.log(f"a client was cut off: it stayed behind for {self._behind_s:g} s")
                session.transport.abort()
        self._attending = bool(self._behind)
        if self._attending:
            self._loop.call_later(_ATTEND_PERIOD_S, self._attend)

    def _sweep(self) -> None:
        """Ends connections that have not become a WebSocket for `heartbeat_s`, or have not shown a token in that time.

        aiohttp waits for a first request without end.
        """
        now_s = self._loop.time()
        ready = {session.transport for session in self._sessions if session.authenticated}
        server = self._runner.server
        handlers = {handler for handler in (server.connections if server else ()) if handler.transport not in ready}
        self._seen_s = {handler: self._seen_s.get(handler, now_s) for handler in handlers}
        for handler, seen_s in self._seen_s.items():
            if now_s - seen_s > self._heartbeat_s and handler.transport is not None:
                handler.transport.abort()
        self._sweeper = self._loop.call_later(_SWEEP_PERIOD_S, self._sweep)

    # The middleware's side

    async def _new_topic(self, name: str, type_name: str) -> Topic:
        known = await self.topic_type(name)
        _require_same_type(name, known, type_name)
        type_name = known or type_name
        text = await self._node.call(self._definition, type_name) if type_name else ""
        return Topic(name, type_name, self.frame_maker, serializer(type_name, text), self.log)

    async def _set_options(self, feed: _Feed, session: Session, options: Optional[Options]) -> None:
        feed.topic.set_options(session, options)
        try:
            await self._feed(feed)
        except ConfigError as error:
            feed.topic.set_options(session, None)
            raise ProtocolError(str(error), "subscribe") from None
        finally:
            if not feed.topic.compressions:
                del self._feeds[feed.topic.name]

    async def _feed(self, feed: _Feed) -> None:
        """Subscribes to what the topic's clients want, and ends what none wants any more."""
        topic = feed.topic
        if topic.name == ROSOUT and topic.type_name == ROSOUT_TYPE and not self._threads:
            return
        wanted = set(topic.compressions)
        if "cbor-raw" in wanted and feed.raw is None and self._threads:
            try:
                feed.raw = await self._node.call(
                    self._middleware.subscribe_raw,
                    topic.name,
                    topic.type_name,
                    self._node.hand_over(topic.deliver_raw),
                )
                topic.native_raw = True
            except ConfigError:
                topic.native_raw = False
        if topic.native_raw:
            wanted.discard("cbor-raw")
        if wanted and feed.messages is None:
            feed.messages = await self._node.call(
                self._middleware.subscribe, topic.name, topic.type_name, self._node.hand_over(topic.deliver)
            )
        if not wanted and feed.messages is not None:
            subscription, feed.messages = feed.messages, None
            await self._node.call(self._middleware.unsubscribe, subscription)
        if feed.raw is not None and "cbor-raw" not in topic.compressions:
            subscription, feed.raw = feed.raw, None
            topic.native_raw = False
            await self._node.call(self._middleware.unsubscribe, subscription)

    def _own_parameters(self) -> Mapping[str, Mapping[str, Any]]:
        return {self._middleware.name: self._middleware.given_parameters()}

    def _graph(self) -> Graph:
        """Returns the middleware's graph with what the server itself adds."""
        graph = self._middleware.graph()
        topics, services, nodes = dict(graph.topics), dict(graph.services), dict(graph.nodes)
        own = nodes.get(self._middleware.name, NodeInfo((), (), ()))
        publishes = list(own.publishes)
        if not self._threads:
            topics[ROSOUT] = ROSOUT_TYPE
            publishes.append(ROSOUT)
        added = {**self._rosapi.services, **self.offers.types}
        services.update(added)
        nodes[self._middleware.name] = NodeInfo(publishes, own.subscribes, [*own.services, *added])
        return Graph(topics, services, nodes)

    def _definition(self, type_name: str) -> str:
        return self._middleware.message_definition(type_name) or full_text(type_name)


def _require_same_type(topic: str, known: str, asked: str) -> None:
    """Raises ProtocolError when both types are told and differ."""
    if known and asked and canonical(known) != canonical(asked):
        raise ProtocolError(f"{topic} is of type {known}, not {asked}", "subscribe")
