"""A connection that is lost and re-established, over real sockets."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import json
import socket as sockets
import ssl
import threading
from typing import Any, AsyncIterator

import aiohttp
import cbor2
import pytest
from aiohttp import web
from harness.rosbridge_client import ForeignServer, Watched, scenario, until
from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.core.port.local import LogLine
from robot_health_monitor.core.values.errors import ConfigError, LinkError
from robot_health_monitor.core.values.field_path import ABSENT
from robot_health_monitor.rosbridge.client import RosbridgeClient
from robot_health_monitor.rosbridge.protocol.codec import decode
from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.rosbridge.server.sending import frame
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.runtime.access import Access
from robot_health_monitor.runtime.bridge.connection import ConnectBackoff
from robot_health_monitor.runtime.sockets import READ_BYTES

EVERYTHING = Access(publish=("*",), services=("*",), offer=("*",))


@contextlib.asynccontextmanager
async def foreign_robot(**options: Any) -> AsyncIterator[Any]:
    """Yields a foreign server and a client that is connected to it."""
    server = ForeignServer()
    watched = Watched(await server.start(), **options)
    try:
        await until(lambda: watched.ups == [True])
        yield server, watched
    finally:
        await watched.close()
        await server.close()


@with_robot(EVERYTHING)
async def test_after_a_restart_everything_is_there_again(robot: Robot) -> None:
    watched = Watched(robot.url)
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")

    async def all_works() -> None:
        await robot.until(lambda: watched.ups[-1:] == [True])
        await watched.settle()
        watched.heard.clear()
        robot.publish(19.5)
        await robot.until(lambda: watched.heard == [19.5])

    await all_works()
    await robot.server.close()
    await robot.until(lambda: watched.ups == [True, False])
    node, limits = robot.bus.node("rosbridge2"), Limits(heartbeat_s=60.0)
    second = Server(node, port=robot.server.port, threads=False, access=EVERYTHING, limits=limits)
    await second.start()
    try:
        await all_works()
        assert watched.ups == [True, False, True]
        assert not watched.problems()
    finally:
        await watched.close()
        await second.close()


@scenario
async def test_a_server_that_stays_away_is_one_report_however_often_it_is_tried() -> None:
    attempts = 0

    async def refuse(request: web.Request) -> web.Response:
        nonlocal attempts
        attempts += 1
        return web.Response(status=404)

    application = web.Application()
    application.router.add_get("/", refuse)
    runner = web.AppRunner(application)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    watched = Watched(f"ws://127.0.0.1:{runner.addresses[0][1]}")
    try:
        await until(lambda: attempts >= 3)
        assert watched.ups == [False]
        assert watched.causes == ["not a rosbridge server (HTTP 404)"]
    finally:
        await watched.close()
        await runner.cleanup()


@pytest.mark.parametrize(
    ("url", "cause"),
    [
        ("ws://127.0.0.1:1", "connection refused: no server listens on this port"),
        ("ws://no-such-robot.invalid:9090", "host name not found"),
    ],
)
def test_the_cause_of_a_failed_attempt_is_reported(monkeypatch: pytest.MonkeyPatch, url: str, cause: str) -> None:
    look_up = sockets.getaddrinfo

    def answer(host: str, *arguments: Any, **options: Any) -> Any:
        """Answers as a name server does that does not know the name; a real one may take longer than an attempt."""
        if host == "no-such-robot.invalid":
            raise sockets.gaierror(sockets.EAI_NONAME, "Name or service not known")
        return look_up(host, *arguments, **options)

    monkeypatch.setattr(sockets, "getaddrinfo", answer)

    @scenario
    async def run() -> None:
        watched = Watched(url)
        await until(lambda: watched.ups == [False])
        await watched.close()
        assert watched.causes == [cause]

    run()


def test_an_invalid_address_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError, match="got 'http://robot/'"):
        RosbridgeClient("http://user:secret@robot/?token=secret", on_link=lambda *link: None, on_log=lambda line: None)


@scenario
async def test_a_server_that_falls_silent_is_noticed_by_its_missing_pongs() -> None:
    """A robot that loses its radio sends no close frame: its socket just does not answer any more."""
    accepted: list[sockets.socket] = []
    listener = sockets.create_server(("127.0.0.1", 0))
    listener.setblocking(False)
    loop = asyncio.get_event_loop()

    async def accept_and_shake_hands() -> None:
        connection, _ = await loop.sock_accept(listener)
        accepted.append(connection)
        request = (await loop.sock_recv(connection, 65536)).decode()
        key = next(line.split(": ")[1] for line in request.split("\r\n") if line.startswith("Sec-WebSocket-Key"))
        answer = base64.b64encode(hashlib.sha1((key + "258EAFA5-E914-47DA-95CA-C5AB0DC85B11").encode()).digest())
        await loop.sock_sendall(
            connection,
            b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Accept: " + answer + b"\r\n\r\n",
        )

    shaking = asyncio.ensure_future(accept_and_shake_hands())
    watched = Watched(f"ws://127.0.0.1:{listener.getsockname()[1]}", heartbeat_s=0.4)
    await until(lambda: watched.ups == [True, False])
    await watched.close()
    await shaking
    for connection in (*accepted, listener):
        connection.close()
    assert watched.causes[0] in ("no answer from the host", "connection lost")  # by version of aiohttp


@pytest.mark.parametrize("frame", [b"\x89\0", b"\x8a\0", b"\x81\0", b"\x82\0"], ids=["ping", "pong", "text", "binary"])
def test_a_server_that_floods_the_connection_with_empty_frames_is_disconnected(frame: bytes) -> None:
    @scenario
    async def run() -> None:
        server = ForeignServer()

        async def flood(socket: web.WebSocketResponse) -> None:
            transport = server.requests[-1].transport
            assert isinstance(transport, asyncio.WriteTransport)
            transport.write(101 * frame)

        server.on_connect = flood
        watched = Watched(await server.start(), probation_s=0.0)
        await until(lambda: bool(watched.causes))
        await watched.close()
        await server.close()
        assert watched.causes[0] == "connection closed: the server floods it with pings or empty messages"

    run()


@scenario
async def test_a_hundred_pings_in_a_second_are_answered() -> None:
    server = ForeignServer()
    pongs: list[bytes] = []

    async def ping(socket: web.WebSocketResponse) -> None:
        socket._autoping = False  # shows the pongs
        for number in range(100):
            await socket.ping(b"%d" % number)
        while len(pongs) < 100:
            message = await socket.receive(timeout=20.0)
            if message.type is aiohttp.WSMsgType.PONG:
                pongs.append(bytes(message.data))

    server.on_connect = ping
    watched = Watched(await server.start(), probation_s=0.0)
    await until(lambda: len(pongs) == 100)
    await watched.close()
    await server.close()
    assert pongs == [b"%d" % number for number in range(100)]
    assert watched.ups == [True]


@scenario
async def test_a_server_is_read_in_pieces_so_that_a_flood_delays_no_other_robot() -> None:
    """256 kB at once, asyncio's default, are 130,000 empty frames."""
    sizes: list[int] = []

    class Measured(aiohttp.client_proto.ResponseHandler):
        def data_received(self, data: bytes) -> None:
            sizes.append(len(data))
            super().data_received(data)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("aiohttp.connector.ResponseHandler", Measured)
        async with foreign_robot() as (server, watched):
            await server.sockets[0].send_str(" " * 500_000 + "{}")
            await watched.settle()
    assert sum(sizes) > 500_000
    assert max(sizes) <= READ_BYTES


@scenario
async def test_a_server_that_accepts_only_to_close_is_never_up_and_tried_less_and_less() -> None:
    server = ForeignServer()
    loop = asyncio.get_event_loop()
    accepted_s: list[float] = []

    async def close_at_once(socket: web.WebSocketResponse) -> None:
        accepted_s.append(loop.time())
        await socket.close()

    server.on_connect = close_at_once
    watched = Watched(await server.start(), probation_s=0.5)
    await until(lambda: len(accepted_s) >= 5)
    waits_s = [later - before for before, later in zip(accepted_s, accepted_s[1:])]
    await watched.close()
    await server.close()
    assert watched.ups == [False]
    assert watched.causes == ["the server closed the connection"]
    assert waits_s[3] >= 0.8  # at least half of 0.2 s, doubled three times
    assert waits_s[3] > waits_s[0]


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
def test_a_redirect_is_not_followed(status: int) -> None:
    """It may lead to another robot, whose state would be taken for this one's, or from TLS to none."""

    @scenario
    async def run() -> None:
        other = ForeignServer()
        target = (await other.start()).replace("ws:", "http:")
        application = web.Application()

        async def redirect(request: web.Request) -> web.Response:
            return web.Response(status=status, headers={"Location": f"{target}/?token=s3cret"})

        application.router.add_get("/", redirect)
        runner = web.AppRunner(application)
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        watched = Watched(f"ws://127.0.0.1:{runner.addresses[0][1]}")
        await until(lambda: bool(watched.causes))
        await watched.close()
        await runner.cleanup()
        await other.close()
        assert other.requests == []
        assert (watched.ups, watched.causes) == (
            [False],
            [f"the server redirects to {target}/ (HTTP {status}); redirects are not followed"],
        )

    run()


# The token


@with_robot(Access(token="s3cret"))
async def test_a_wrong_token_is_a_mistake_on_this_side(robot: Robot) -> None:
    watched = Watched(robot.url, token="guessed")
    await robot.until(lambda: bool(watched.causes))
    await watched.close()
    assert watched.causes == ["check this computer's settings: wrong token"]


@with_robot(Access(token="s3cret"))
async def test_the_right_token_connects(robot: Robot) -> None:
    watched = Watched(robot.url, token="s3cret")
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    await robot.until(lambda: watched.ups == [True])
    await watched.settle()
    robot.publish(19.5)
    await robot.until(lambda: watched.heard == [19.5])
    await watched.close()


@scenario
async def test_a_missing_token_is_a_mistake_on_this_side() -> None:
    server = ForeignServer()

    async def require_token(socket: web.WebSocketResponse) -> None:
        await socket.close(code=1008, message=b"token required")

    server.on_connect = require_token
    watched = Watched(await server.start(), probation_s=0.5)
    await until(lambda: bool(watched.causes))
    await watched.close()
    await server.close()
    assert (watched.ups, watched.causes) == ([False], ["check this computer's settings: no token"])


@scenario
async def test_no_line_and_no_cause_shows_the_token_or_credentials() -> None:
    server = ForeignServer()
    url = (await server.start()).replace("ws://", "ws://user:s3cret@") + "/?token=s3cret"
    watched = Watched(url)
    await until(lambda: watched.ups == [True])
    assert server.requests[0].query == {"token": "s3cret"}
    await server.sockets[0].send_str("not JSON")
    await server.sockets[0].send_str('{"op": "publish", "topic": "/big", "msg": "' + "x" * 2_000_000 + '"}')
    await server.sockets[0].send_bytes(b'{"op": "publish", "msg": "' + b"x" * 2_000_000)
    await until(lambda: len(watched.problems()) == 2)
    await server.close()
    await until(lambda: watched.ups == [True, False])
    with pytest.raises(LinkError) as error:
        await watched.settle()
    await watched.close()
    for text in (*watched.problems(), *watched.causes, str(error.value), watched.client.connection.address):
        assert "s3cret" not in text


@scenario
async def test_a_token_beside_credentials_in_the_address_is_no_crash() -> None:
    watched = Watched("ws://user:s3cret@127.0.0.1:1", token="t0ken")
    await until(lambda: bool(watched.causes))
    await watched.close()
    assert "s3cret" not in watched.causes[0] and not watched.problems()


# What a server sends


@scenario
async def test_no_message_ends_the_connection() -> None:
    lone_surrogate = '"\\ud800"'
    digits = "1" + "0" * 5_000
    shared = cbor2.loads(b"\x80")
    texts: list[Any] = [
        '{"op": "call_service", "service": "/x", "id": ' + lone_surrogate + "}",
        '{"op": "publish", "topic": "/battery_level", "msg": {"data": ' + digits + "}}",
        '{"op": "publish", "topic": "/battery_level", "msg": {"data": 1e400}}',
        '{"op": "publish", "topic": "/battery_level", "msg": {"data": "' + "x" * 5_000 + '"}}',
        '{"op": "publish", "topic": ' + lone_surrogate + ', "msg": {}}',
        '{"op": "service_response", "id": ' + lone_surrogate + ', "values": ' + digits + "}",
        '{"op": "service_response", "id": "call:0", "service": "\\u001b[2J", "values": ' + lone_surrogate + "}",
        '{"op": "call_service", "service": "/watcher/reset", "id": ' + digits + "}",
        '{"op": "png", "data": "x"}',
        '{"op": "fragment", "data": "x", "num": 0, "total": 1e9, "id": "x"}',
        "[" * 10_000,
        '{"a":' * 5_000,
        "null",
        "",
        b"",
        b"\xff",
        b"\xd8\x1c\x80" * 1_000,
        b"\xa1\x62op\x9f" * 500,
        cbor2.dumps({"op": "publish", "topic": "/battery_level", "msg": {"data": 10**5_000}}),
        cbor2.dumps({"op": "call_service", "service": "/x", "id": 2**70}),
        cbor2.dumps({"op": "publish", "topic": 5, "msg": shared}),
        cbor2.dumps({b"op": "publish"}),
        # Shared references (tags 28 and 29), each level twice the one before.
        b"\x82" + b"\xd8\x1c\x82" * 40 + b"\x00" + b"\xd8\x1d\x00" * 41,
    ]
    async with foreign_robot() as (server, watched):
        watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
        for text in texts:
            if isinstance(text, str):
                await server.sockets[0].send_str(text)
            else:
                await server.sockets[0].send_bytes(text)
        await server.publish("/battery_level", {"data": 19.5})
        await until(lambda: watched.heard[-1:] == [19.5])
        await watched.settle()
        assert watched.ups == [True]
        assert len(server.sockets) == 1
        assert 1 <= len(watched.problems()) <= 2
        assert all(text.isprintable() for text in watched.problems())


@scenario
async def test_a_callback_that_fails_does_not_end_the_connection() -> None:
    async with foreign_robot() as (server, watched):

        def fail(value: Any, now_s: float) -> None:
            raise RuntimeError("broken \x1b[2J")

        watched.node.subscribe("/battery_level", FLOAT32, fail, field="data")
        watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
        await server.publish("/battery_level", {"data": 19.5})
        await until(lambda: watched.heard == [19.5])
        assert watched.problems() == ["RuntimeError in a callback: broken ?[2J"]


@scenario
async def test_an_internal_error_is_one_line_and_the_connection_comes_back() -> None:
    server = ForeignServer()
    url = await server.start()
    watched = Watched(url)
    subscriptions = watched.client.connection.subscriptions
    send_all, failures = subscriptions.send_all, [RuntimeError("bug")]

    def fail_once(compression: str) -> None:
        if failures:
            raise failures.pop()
        send_all(compression)

    subscriptions.send_all = fail_once  # type: ignore[method-assign]
    await until(lambda: watched.ups[-1:] == [True])
    await watched.close()
    await server.close()
    assert watched.causes == ["internal error: RuntimeError"]
    assert len(watched.problems()) == 1 and "RuntimeError: bug" in watched.problems()[0]


@scenario
async def test_an_observer_of_the_link_that_fails_does_not_end_the_connection() -> None:
    server = ForeignServer()
    url = await server.start()

    def fail(up: bool, cause: object) -> None:
        raise RuntimeError("broken")

    lines: list[LogLine] = []
    client = RosbridgeClient(url, on_link=fail, on_log=lines.append, probation_s=0.0)
    heard: list[float] = []
    client.node("watcher").subscribe("/a", FLOAT32, lambda value, now_s: heard.append(value), field="data")
    task = asyncio.ensure_future(client.run())
    await until(lambda: bool(server.received) and bool(lines))
    await server.publish("/a", {"data": 1.0})
    await until(lambda: heard == [1.0])
    client.close()
    task.cancel()
    await asyncio.wait({task})
    await server.close()


# Large messages


@pytest.mark.parametrize("size", [1_200_000, 5_000_000])
def test_a_large_message_of_which_only_the_arrival_is_wanted_is_counted(size: int) -> None:
    @scenario
    async def run() -> None:
        async with foreign_robot() as (server, watched):
            watched.node.subscribe("/points", "sensor_msgs/PointCloud2", watched.hear, field=None)
            watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
            message = {"op": "publish", "topic": "/points", "msg": {"data": "A" * size}}
            await server.sockets[0].send_str(json.dumps(message))
            await server.sockets[0].send_bytes(cbor2.dumps(message))
            await server.publish("/battery_level", {"data": 19.5})
            await until(lambda: watched.heard == [1.0, 1.0, 19.5])
            assert watched.ups == [True] and not watched.problems()
            assert not watched.node.faults.current()

    run()


@with_robot()
async def test_a_large_message_of_this_projects_server_is_counted(robot: Robot) -> None:
    robot.node.advertise("/points", "sensor_msgs/PointCloud2")
    watched = Watched(robot.url)
    watched.node.subscribe("/points", "sensor_msgs/PointCloud2", watched.hear, field=None)
    await robot.until(lambda: watched.ups == [True])
    await watched.settle()
    for number, size in enumerate((900_000, 1_200_000, 5_000_000)):
        robot.node.publish("/points", {"data": "A" * size})
        await robot.until(lambda wanted=number + 1: len(watched.heard) == wanted)  # type: ignore[misc]
    await watched.close()
    assert watched.heard == [1.0, 1.0, 1.0]
    assert watched.ups == [True] and not watched.problems()


@scenario
async def test_a_message_too_large_to_read_is_a_fault_until_one_can_be_read() -> None:
    async with foreign_robot(limits=Limits(message_bytes=100_000)) as (server, watched):
        watched.node.subscribe("/map", "nav_msgs/OccupancyGrid", watched.hear, field="info.width")
        watched.node.subscribe("/map", "nav_msgs/OccupancyGrid", watched.hear, field=None)
        for _ in range(3):
            await server.publish("/map", {"info": {"width": 5}, "data": "A" * 200_000})
        await until(lambda: watched.heard == [ABSENT, 1.0] * 3)  # a sign of life without a value
        fault = watched.node.faults.current()["topic /map"]
        assert fault.text == "dropped 3 messages, the last of 0.2 MB (limit 0.1 MB)"
        assert watched.node.dropped == 3
        await server.publish("/map", {"info": {"width": 5}, "data": "A" * 50_000})
        await until(lambda: watched.heard == [*[ABSENT, 1.0] * 3, 5, 1.0])
        assert not watched.node.faults.current()
        assert watched.ups == [True]


@scenario
async def test_a_large_message_without_a_topic_is_one_line() -> None:
    async with foreign_robot(limits=Limits(message_bytes=100_000)) as (server, watched):
        for _ in range(3):
            await server.sockets[0].send_str(json.dumps({"msg": "A" * 200_000, "op": "publish", "topic": "/map"}))
        await watched.settle()
        assert watched.problems() == [
            f"dropped a message from {watched.client.connection.address}: 0.2 MB (limit 0.1 MB)"
        ]


@scenario
async def test_a_message_beyond_every_bound_ends_only_the_connection() -> None:
    server = ForeignServer()
    watched = Watched(await server.start(), largest_message_bytes=100_000)
    await until(lambda: watched.ups == [True])
    await server.publish("/points", {"data": "A" * 200_000})
    await until(lambda: watched.ups == [True, False, True])
    await watched.close()
    await server.close()
    assert watched.causes == ["connection closed: a message is larger than this client accepts"]


@with_robot()
async def test_a_large_cbor_message_is_decoded_outside_the_loop(robot: Robot) -> None:
    """A hostile robot's list of small numbers takes a second per megabyte: the other robots must not wait for it."""
    threads: list[int] = []

    def note_thread(data: Any, limits: Limits) -> Any:
        threads.append(threading.get_ident())
        return decode(data, limits)

    values: list[Any] = []
    robot.node.advertise("/costs", "std_msgs/Int8MultiArray")
    watched = Watched(f"ws://127.0.0.1:{robot.server.port}")
    watched.node.subscribe(
        "/costs", "std_msgs/Int8MultiArray", lambda value, now_s: values.append(value), field="data[7]"
    )
    await until(lambda: watched.ups == [True])
    await watched.settle()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("robot_health_monitor.rosbridge.client.connection.decode", note_thread)
        for cost in (1, 2):
            robot.node.publish("/costs", {"data": [cost] * 100_000})
        await until(lambda: values == [1, 2])
    await watched.close()
    assert len(threads) == 2
    assert threading.get_ident() not in threads


@with_robot()
async def test_a_large_cbor_message_that_is_not_valid_is_one_line(robot: Robot) -> None:
    watched = Watched(f"ws://127.0.0.1:{robot.server.port}")
    await until(lambda: watched.ups == [True])
    for session in robot.server._sessions:
        session.put(frame(b"\x9f" * 100_000))
    await watched.settle()
    await watched.close()
    assert watched.problems() == [
        f"invalid message from {watched.client.connection.address}: CBOR items of indefinite length are not supported"
    ]


# What is sent


@scenario
async def test_a_server_that_does_not_read_loses_the_connection() -> None:
    server = ForeignServer()
    finished = asyncio.Event()

    async def never_read(socket: web.WebSocketResponse) -> None:
        await finished.wait()

    server.on_connect = never_read
    watched = Watched(await server.start(), heartbeat_s=60.0)
    await until(lambda: watched.ups == [True])
    for _ in range(100):  # more than the sockets hold
        watched.client.connection.send_wire("A" * 1_000_000)
    for _ in range(10_000):
        watched.client.connection.send_wire("A")
    await until(lambda: watched.ups[:2] == [True, False])
    await watched.close()
    finished.set()
    await server.close()
    assert watched.causes[0] == "the server does not read what is sent to it"


# TLS


def test_tls_and_a_clients_certificate_carry_a_connection(tmp_path: Any) -> None:
    trustme = pytest.importorskip("trustme", reason="trustme, which makes certificates, is not installed")
    authority = trustme.CA()
    served = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert("localhost").configure_cert(served)
    authority.configure_trust(served)
    served.verify_mode = ssl.CERT_REQUIRED
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)

    @with_robot(ssl_context=served)
    async def run(robot: Robot) -> None:
        url = f"wss://localhost:{robot.server.port}"
        doubter = Watched(url)
        await robot.until(lambda: doubter.ups == [False])
        await doubter.close()
        assert doubter.causes[0].startswith("check this computer's settings: the server's certificate is not trusted: ")
        stranger = Watched(url, ssl_context=trusting)
        await robot.until(lambda: bool(stranger.ups) and not stranger.ups[-1])
        await stranger.close()
        mine = ssl.create_default_context()
        authority.configure_trust(mine)
        authority.issue_cert("laptop").configure_cert(mine)
        watched = Watched(url, ssl_context=mine)
        watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
        await robot.until(lambda: watched.ups == [True])
        await watched.settle()
        robot.publish(19.5)
        await robot.until(lambda: watched.heard == [19.5])
        await watched.close()

    run()


def delays(held: list[float | None]) -> list[float]:
    backoff = ConnectBackoff(chance=lambda: 1.0)
    return [backoff.after_s(held_s) for held_s in held]


def test_delays_grow_while_a_server_cannot_be_reached_but_stay_short() -> None:
    assert delays([None] * 7) == [0.2, 0.4, 0.8, 1.2, 1.2, 1.2, 1.2]


def test_delays_grow_to_half_a_minute_while_a_server_accepts_and_closes() -> None:
    assert delays([0.01] * 10) == pytest.approx([0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6, 30.0, 30.0])


def test_delays_grow_while_connections_break_within_ten_seconds() -> None:
    assert delays([9.9] * 6) == [0.2, 0.4, 0.8, 1.2, 1.2, 1.2]


def test_a_connection_that_held_for_ten_seconds_starts_the_delays_again() -> None:
    assert delays([None, None, None, 10.0, None]) == [0.2, 0.4, 0.8, 0.2, 0.4]


def test_a_server_that_becomes_unreachable_after_many_short_connections_is_tried_often_again() -> None:
    assert delays([0.01] * 9 + [None])[-2:] == [30.0, 1.2]


def test_delays_are_spread_between_half_and_all_of_their_length() -> None:
    firsts = [ConnectBackoff().after_s(None) for _ in range(200)]
    assert all(0.1 <= first <= 0.2 for first in firsts)
    assert len(set(firsts)) > 100
