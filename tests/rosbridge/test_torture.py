"""Hostile and faulty clients: the server keeps working, and a well-behaved client loses nothing."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import socket as sockets
import ssl
import threading
import weakref
from typing import Any, AsyncIterator, Callable

import aiohttp
import pytest
from aiohttp import web
from harness.rosbridge_peer import Peer, Robot, with_robot

from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.runtime.access import Access, Client


@contextlib.asynccontextmanager
async def well_behaved(robot: Robot) -> AsyncIterator[list[float]]:
    """A client that reads throughout; checks at the end that it lost nothing."""
    sent: list[float] = []
    received: list[float] = []

    async def read(peer: Peer) -> None:
        while True:
            received.append((await peer.receive())["msg"]["data"])

    async def publish() -> None:
        while True:
            sent.append(float(len(sent)))
            robot.publish(sent[-1])
            await asyncio.sleep(0.001)

    async with robot.peer() as peer:
        await peer.subscribe("/battery_level")
        tasks = [asyncio.ensure_future(read(peer)), asyncio.ensure_future(publish())]
        try:
            yield received
            await robot.until(lambda: len(received) > 200)
            tasks[1].cancel()
            await robot.until(lambda: len(received) >= len(sent))
        finally:
            for task in tasks:
                task.cancel()
        assert received == sent


def raw_socket(robot: Robot) -> sockets.socket:
    connection = sockets.create_connection(("127.0.0.1", robot.server.port), 10.0)
    connection.setsockopt(sockets.SOL_SOCKET, sockets.SO_RCVBUF, 4096)
    return connection


HANDSHAKE = (
    b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
)


def text_frame(text: bytes) -> bytes:
    """A client's frame, masked with zeros."""
    assert len(text) < 126
    return bytes([0x81, 0x80 | len(text)]) + bytes(4) + text


SUBSCRIBE = text_frame(b'{"op":"subscribe","topic":"/big","type":"std_msgs/String"}')


async def stalled_client(robot: Robot) -> sockets.socket:
    """Subscribes to /big and never reads again."""
    loop = asyncio.get_event_loop()
    connection = await loop.run_in_executor(None, raw_socket, robot)
    connection.setblocking(False)
    await loop.sock_sendall(connection, HANDSHAKE)
    await robot.until(lambda: robot.server.clients >= 1)
    await loop.sock_sendall(connection, SUBSCRIBE)
    await robot.until(lambda: "/big" in robot.bus.graph().nodes["/rosbridge"].subscribes)
    return connection


def _waiting(queue: Any) -> int:
    """Returns the bytes that wait for a client."""
    return int(queue._frames.size + len(queue._rest))


@with_robot(limits=Limits(queue_bytes=100_000), slow_client_timeout_s=2.0, heartbeat_s=60.0)
async def test_a_stalled_client_loses_its_own_messages_and_is_then_cut_off(robot: Robot) -> None:
    robot.node.advertise("/big", "std_msgs/String")
    stalled = await stalled_client(robot)
    async with well_behaved(robot):
        sessions = {session for session in robot.server._sessions if session._subscriptions.get("/big")}
        (session,) = sessions
        while session in robot.server._sessions:
            robot.node.publish("/big", {"data": "x" * 100_000})
            waiting = _waiting(session.queue) + session._transport.get_write_buffer_size()
            assert (
                waiting <= 100_000 + 2 * 65_536 + 2 * 101_000
            )  # the bound, the transport's buffer, the message that is being sent, one more
            await asyncio.sleep(0.001)
        assert session.queue.dropped > 5
        await robot.until(lambda: _waiting(session.queue) == 0)
    assert [text for text in robot.log if "disconnected" in text] == ["disconnected a client: behind for more than 2 s"]
    stalled.close()


@with_robot(limits=Limits(queue_bytes=50_000))
async def test_a_client_that_catches_up_receives_the_number_of_lost_messages_and_stays(robot: Robot) -> None:
    robot.node.advertise("/big", "std_msgs/String")
    async with robot.peer(max_msg_size=0) as peer:
        await peer.send("set_level", level="warning")
        await peer.subscribe("/big")
        # One call of the loop: nothing can be sent on between these.
        for number in range(1000):
            robot.node.publish("/big", {"data": f"{number:04d}" + "x" * 10_000})
        numbers = []
        while True:
            message = await peer.receive()
            if message["op"] == "status":
                break
            numbers.append(int(message["msg"]["data"][:4]))
        assert numbers == sorted(numbers) and numbers[0] == 0 and numbers[-1] == 999
        lost = 1000 - len(numbers)
        assert lost > 0
        assert message["msg"] == f"{lost} messages were dropped: this client reads too slowly"
        await peer.settle()


@with_robot(clients=450)
async def test_a_thousand_connections_are_opened_and_dropped(robot: Robot) -> None:
    async with well_behaved(robot):
        loop = asyncio.get_event_loop()
        for batch in range(20):
            connections = []
            for index in range(50):
                connection = await loop.run_in_executor(None, raw_socket, robot)
                if batch % 2:
                    connection.sendall(HANDSHAKE + (SUBSCRIBE if index % 2 else b""))
                connections.append(connection)
            for connection in connections:
                if batch % 4 == 3:  # a reset instead of a goodbye
                    connection.setsockopt(sockets.SOL_SOCKET, sockets.SO_LINGER, b"\1\0\0\0\0\0\0\0")
                connection.close()
        await robot.until(lambda: robot.server.clients == 1)
    await robot.until(lambda: robot.bus.graph().nodes["/rosbridge"].subscribes == ())


@with_robot(heartbeat_s=1.0, request_timeout_s=1.0)
async def test_half_open_sockets_are_closed(robot: Robot) -> None:
    """One sends nothing, one stops in the middle of its request, one stops answering pings."""
    loop = asyncio.get_event_loop()
    silent, half, dead = [await loop.run_in_executor(None, raw_socket, robot) for _ in range(3)]
    half.sendall(HANDSHAKE[:40])
    dead.sendall(HANDSHAKE)
    async with well_behaved(robot):
        for connection in (silent, half, dead):
            connection.settimeout(20.0)

            def until_closed(closing: sockets.socket = connection) -> None:
                with contextlib.suppress(ConnectionError):
                    while closing.recv(4096):
                        pass

            await loop.run_in_executor(None, until_closed)
            connection.close()
        await robot.until(lambda: robot.server.clients == 1)


@pytest.mark.parametrize(
    "garbage",
    [
        b"\x81\x85\0\0\0\0hello",
        b"\x82\x83\0\0\0\0\xff\xff\xff",
        b"\x81\x83\0\0\0\0\xff\xff\xff",  # text that is no UTF-8
        b"\xff\xff\xff\xff\xff\xff\xff\xff",  # no frame at all
        b"\x81\xff\x7f\xff\xff\xff\xff\xff\xff\xff\0\0\0\0",  # a frame of 2**63 - 1 bytes
        b"\x81\x05hello",  # not masked
        b"\x80\x80\0\0\0\0",  # the rest of nothing
        b"\x88\x81\0\0\0\0x",  # a goodbye that is cut
        os.urandom(4096),
    ],
)
def test_garbage_frames_affect_no_other_client(garbage: bytes) -> None:
    @with_robot()
    async def scenario(robot: Robot) -> None:
        async with well_behaved(robot):
            loop = asyncio.get_event_loop()
            for opening in (b"", HANDSHAKE):
                connection = await loop.run_in_executor(None, raw_socket, robot)
                connection.sendall(opening + garbage)
                connection.shutdown(sockets.SHUT_WR)
                connection.settimeout(20.0)

                def drain(closing: sockets.socket = connection) -> None:
                    with contextlib.suppress(ConnectionError):
                        while closing.recv(4096):
                            pass

                await loop.run_in_executor(None, drain)
                connection.close()
            await robot.until(lambda: robot.server.clients == 1)

    scenario()


@with_robot(limits=Limits(message_bytes=1000))
async def test_a_frame_above_the_limit_ends_its_own_connection_only(robot: Robot) -> None:
    async with well_behaved(robot), robot.peer() as peer:
        await peer.send("publish", topic="/in", msg={"data": "x" * 2000})
        assert await peer.closed() == aiohttp.WSCloseCode.MESSAGE_TOO_BIG


@with_robot(limits=Limits(subscriptions=3, calls=2, advertisements=2))
async def test_what_one_client_may_ask_for_is_bounded(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        for number in range(4):
            await peer.send("subscribe", topic="/battery_level", id=number)
        assert (await peer.receive())["msg"] == "subscribe: more than 3 subscriptions"
        await peer.settle()


# Expensive messages and subscriptions

BOMB = b"\xa1\x61a" + b"\xd8\x1c\x82" * 40 + b"\x80" + b"\xd8\x1d\x17" * 40
"""CBOR with shared references (tags 28 and 29): each level doubles the list below."""


@with_robot()
async def test_a_cbor_bomb_is_refused_without_work(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.send("set_level", level="error")
        await peer.socket.send_bytes(BOMB)
        assert (await peer.receive())["msg"] == "CBOR tag 28 is not supported"
        await peer.settle()


@with_robot()
async def test_one_bad_message_does_not_end_its_connection(robot: Robot) -> None:
    async with well_behaved(robot), robot.peer() as peer:
        for text in (
            r'{"op": "subscribe", "topic": "/battery_level", "id": "\ud800"}',
            r'{"op": "subscribe", "topic": "\udfff"}',
            '{"op": "call_service", "service": "/rosapi/get_time", "id": ' + "9" * 5000 + "}",
            '{"op": "publish", "topic": "/in", "msg": {"data": ' + "9" * 5000 + "}}",
            '{"op": "subscribe", "topic": "/battery_level", "throttle_rate": 1e400}',
            "[" * 100_000,
            "\0",
        ):
            await peer.socket.send_str(text)
        await peer.settle()


IMAGE = {"height": 480, "width": 640, "encoding": "rgb8", "step": 1920, "data": "A" * 1_228_800}
"""sensor_msgs/Image as rosbridge has it: 640 * 480 * 3 bytes in base64."""


@pytest.mark.parametrize(
    "options",
    [
        {"compression": "none"},
        {"throttle_rate": 10},
        {"compression": "cbor"},
    ],
    ids=str,
)
def test_an_expensive_subscription_is_bounded_and_disturbs_no_other_client(options: Any) -> None:
    limits = Limits(queue_bytes=3_000_000, encoding_bytes=3_000_000)

    @with_robot(limits=limits, slow_client_timeout_s=60.0)
    async def scenario(robot: Robot) -> None:
        robot.node.advertise("/image", "sensor_msgs/Image")
        async with robot.peer(max_msg_size=0) as reader, robot.peer() as other:
            await reader.subscribe("/image", type="sensor_msgs/Image", **options)
            (session,) = [one for one in robot.server._sessions if one._subscriptions]
            (topic,) = robot.server._topics._topics.values()
            for _ in range(30):
                robot.node.publish("/image", IMAGE)
                assert topic._waiting.size <= limits.encoding_bytes
                assert _waiting(session.queue) <= limits.queue_bytes + 2_500_000
                await other.settle()
            assert (await reader.receive())["op"] == "publish"
        await robot.until(lambda: robot.server.clients == 0)
        await robot.until(lambda: not robot.server._topics._topics)
        assert _waiting(session.queue) == 0
        await robot.until(lambda: robot.server._node.codec.pending == 0)
        message = weakref.ref(topic)
        del topic, session
        # A transport of asyncio lets go of its last buffer in a later turn of the loop.
        await robot.until(lambda: gc.collect() >= 0 and message() is None)

    scenario()


@with_robot()
async def test_large_messages_are_encoded_and_decoded_outside_the_loop(robot: Robot) -> None:
    threads: list[str] = []
    pool: Any = robot.server._node.codec
    run = pool.submit

    def submit(function: Any, *arguments: Any) -> Any:
        def called(*called_with: Any) -> Any:
            threads.append(threading.current_thread().name)
            return function(*called_with)

        return run(called, *arguments)

    pool.submit = submit
    robot.node.advertise("/image", "sensor_msgs/Image")
    async with robot.peer(max_msg_size=0) as peer:
        await peer.subscribe("/image")
        assert threads == []
        robot.node.publish("/image", IMAGE)
        assert (await peer.receive())["msg"]["width"] == 640
        await peer.send("publish", topic="/image", msg={"data": "x" * 500_000})
        await peer.settle()
    assert threads == ["rosbridge-codec", "rosbridge-codec"]


@with_robot(limits=Limits(sent_bytes=1_000_000))
async def test_a_message_above_the_limit_is_not_sent_and_logged(robot: Robot) -> None:
    robot.node.advertise("/image", "sensor_msgs/Image")
    async with robot.peer(max_msg_size=0) as peer:
        await peer.subscribe("/image")
        robot.node.publish("/image", IMAGE)
        robot.node.publish("/image", {"width": 1})
        assert (await peer.receive())["msg"]["width"] == 1
    (line,) = robot.log
    assert line.startswith("/image (sensor_msgs/Image): message of 12") and line.endswith(
        "bytes dropped (limit 1000000)"
    )
    assert robot.server.dropped == 1


# Many connections


@with_robot(clients=40, request_timeout_s=60.0)
async def test_idle_connections_lock_no_client_out_and_are_reported_a_few_times(robot: Robot) -> None:
    loop = asyncio.get_event_loop()
    async with well_behaved(robot):
        idle = [await loop.run_in_executor(None, raw_socket, robot) for _ in range(200)]
        async with robot.peer() as peer:
            await peer.settle()
            assert len(robot.server._connections._timeouts) <= 40
    assert robot.log == ["connection limit reached; closing the oldest idle one (limit 40)"] * 10
    for connection in idle:
        connection.close()


@with_robot(Access(token="s3cret"), clients=20, request_timeout_s=60.0)
async def test_websockets_without_a_token_lock_no_client_out(robot: Robot) -> None:
    loop = asyncio.get_event_loop()
    idle = []
    for _ in range(60):
        connection = await loop.run_in_executor(None, raw_socket, robot)
        connection.sendall(HANDSHAKE)
        idle.append(connection)
    async with robot.peer(headers={"Authorization": "Bearer s3cret"}) as peer:
        await peer.settle()
    assert robot.server.clients <= 1
    for connection in idle:
        connection.close()


HALF_BODY = b"POST /login HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 100\r\n\r\n{"
HALF_HEAD = b"GET / HTTP/1.1\r\nHost: loc"
HALF_HELLO = b"\x16\x03\x01\x02\x00\x01"


def with_login(client_of: Callable[[web.Request], Client]) -> list[web.RouteDef]:
    async def login(request: web.Request) -> web.Response:
        await request.read()
        return client_of(request).login("")

    async def state(request: web.Request) -> web.Response:
        return web.Response(status=200 if client_of(request).admitted else 401)

    return [web.post("/login", login), web.get("/state", state)]


@pytest.mark.parametrize("tls", [False, True])
def test_clients_without_the_token_never_keep_out_those_with_it(tls: bool) -> None:
    """They hold half-open connections of every kind, more than there is room for, and open lost ones again at once."""
    options: dict[str, Any] = {}
    trust = None
    if tls:
        trustme = pytest.importorskip("trustme", reason="trustme, which makes certificates, is not installed")
        authority = trustme.CA()
        options["ssl_context"] = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        authority.issue_cert("127.0.0.1").configure_cert(options["ssl_context"])
        trust = ssl.create_default_context()
        authority.configure_trust(trust)

    @with_robot(Access(token="s3cret"), clients=40, request_timeout_s=60.0, routes=with_login, **options)
    async def scenario(robot: Robot) -> None:
        begun = 0

        async def hold(opening: bytes, context: ssl.SSLContext | None) -> None:
            nonlocal begun
            while True:
                with contextlib.suppress(OSError):
                    reader, writer = await asyncio.open_connection("127.0.0.1", robot.server.port, ssl=context)
                    writer.write(opening)
                    begun += 1
                    await reader.read()
                    writer.close()
                await asyncio.sleep(0.01)

        kinds = [(opening, trust) for opening in (HALF_BODY, HALF_HEAD, HANDSHAKE, b"")]
        kinds += [(opening, None) for opening in (HALF_HELLO, b"")] if tls else []
        attackers = [asyncio.ensure_future(hold(*kinds[number % len(kinds)])) for number in range(60)]
        try:
            await robot.until(lambda: begun > 60)
            url = robot.url.replace("http:", "https:") if tls else robot.url
            for _ in range(10):
                session = aiohttp.ClientSession(headers={"Authorization": "Bearer s3cret"})
                async with session, session.get(f"{url}state", ssl=trust) as response:
                    assert response.status == 200
                assert len(robot.server._connections._timeouts) <= 40
        finally:
            for attacker in attackers:
                attacker.cancel()
            await asyncio.wait(attackers)

    scenario()


@with_robot(Access(token="s3cret"), request_timeout_s=0.3)
async def test_a_connection_that_presents_nothing_is_closed(robot: Robot) -> None:
    loop = asyncio.get_event_loop()
    idle = []
    for opening in (b"", b"GET / HTTP/1.1\r\n", HANDSHAKE):
        connection = await loop.run_in_executor(None, raw_socket, robot)
        connection.settimeout(20.0)
        connection.sendall(opening)
        idle.append(connection)
    for connection in idle:
        await loop.run_in_executor(None, read_to_the_end, connection)
        connection.close()
    assert robot.server.clients == 0


@with_robot(request_timeout_s=60.0)
async def test_a_request_without_an_end_is_closed_before_it_fills_the_memory(robot: Robot) -> None:
    """aiohttp 3.10 keeps any number of headers: 800 MB in six seconds."""
    loop = asyncio.get_event_loop()
    connection = await loop.run_in_executor(None, raw_socket, robot)
    connection.setblocking(False)
    await loop.sock_sendall(connection, b"GET / HTTP/1.1\r\nHost: localhost\r\n")
    headers = b"".join(b"X-%d: %s\r\n" % (number, b"x" * 1000) for number in range(1000))

    async def send_headers() -> None:
        while True:
            await loop.sock_sendall(connection, headers)

    with pytest.raises(ConnectionError):
        await asyncio.wait_for(send_headers(), 20.0)
    connection.close()
    async with robot.peer() as peer:
        await peer.settle()


@with_robot()
async def test_many_requests_over_one_connection_are_not_too_large_together(robot: Robot) -> None:
    async with aiohttp.ClientSession() as session:
        for _ in range(50):
            async with session.get(robot.url, headers={"X-Padding": "x" * 4000}) as response:
                assert response.status == 404
    assert robot.log == []


@with_robot()
async def test_topics_that_clients_invent_are_forgotten_when_they_unsubscribe(robot: Robot) -> None:
    async with robot.peer() as peer, robot.peer() as other:
        for number in range(50):
            await peer.send("subscribe", topic=f"/invented{number}", type="std_msgs/Float32")
            await other.send("subscribe", topic=f"/invented{number}", type="std_msgs/Float32")
        await peer.settle()
        await other.settle()
        assert len(robot.bus.graph().topics) > 50
        for number in range(50):
            await peer.send("unsubscribe", topic=f"/invented{number}")
        await peer.settle()
    await robot.until(lambda: robot.server.clients == 0)
    await robot.until(lambda: set(robot.bus.graph().topics) == {"/battery_level"})
    assert [topic.listeners for topic in robot.bus._topics.values()] == [[]]


def read_to_the_end(connection: sockets.socket) -> bytes:
    data = b""
    with contextlib.suppress(ConnectionError):
        while True:
            piece = connection.recv(4096)
            if not piece:
                break
            data += piece
    return data


@pytest.mark.parametrize(
    "request_text",
    [
        b"\x16\x03\x01\x02\x00\x01\x00\x01",  # a TLS handshake
        b"GARBAGE\r\n\r\n",
        b"GET / HTTP/9.9\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nContent-Length: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer \xff\r\n\r\n",
        b"GET /?token=%ff%ed%a0%80 HTTP/1.1\r\nHost: localhost\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: \x1b[31mforged\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: localhost\r\nOrigin: http://\xff[\r\n\r\n",
        b"GET / HTTP/1.1\r\n" + b"X: " + b"x" * 100_000 + b"\r\n\r\n",
        HANDSHAKE.replace(b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", b"Sec-WebSocket-Key: x"),
        HANDSHAKE[:-2] + b"Sec-WebSocket-Protocol: \x1b[31mforged\r\n\r\n",
        HANDSHAKE[:-2] + b"Sec-WebSocket-Protocol: forged\r\n\r\n",
        HANDSHAKE[:-2] + b"Sec-WebSocket-Protocol: rosbridge.v2.cborx, \xff\r\n\r\n",
    ],
)
def test_a_bad_request_is_refused_with_a_limited_number_of_lines(
    request_text: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    @with_robot(Access(token="s3cret"), request_timeout_s=0.2)
    async def scenario(robot: Robot) -> None:
        loop = asyncio.get_event_loop()
        for _ in range(30):
            connection = await loop.run_in_executor(None, raw_socket, robot)
            connection.sendall(request_text)
            connection.shutdown(sockets.SHUT_WR)
            connection.settimeout(20.0)
            await loop.run_in_executor(None, read_to_the_end, connection)
            connection.close()
        assert len(robot.log) <= 10
        assert all(line.isprintable() for line in robot.log)
        async with robot.peer(headers={"Authorization": "Bearer s3cret"}) as peer:
            await peer.settle()

    scenario()
    assert [record.getMessage() for record in caplog.records if record.levelno >= 30] == []


def test_closing_ends_although_a_client_reconnects_at_once() -> None:
    async def scenario() -> None:
        robot = Robot(None, {})
        await robot.server.start()
        connected = asyncio.Event()

        async def reconnect() -> None:
            async with aiohttp.ClientSession() as session:
                while True:
                    with contextlib.suppress(aiohttp.ClientError, OSError):
                        async with session.ws_connect(robot.url) as socket:
                            connected.set()
                            await socket.receive()
                    await asyncio.sleep(0)

        clients = [asyncio.ensure_future(reconnect()) for _ in range(5)]
        await connected.wait()
        await asyncio.wait_for(robot.server.close(), 20.0)
        await asyncio.wait_for(robot.server.close(), 20.0)
        with pytest.raises(aiohttp.ClientConnectorError):
            async with robot.peer():
                pass
        for client in clients:
            client.cancel()
        await asyncio.gather(*clients, return_exceptions=True)

    asyncio.run(scenario())
