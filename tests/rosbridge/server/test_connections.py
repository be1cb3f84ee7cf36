"""The limit of connections; connections as clients see them: TLS, sizes, errors in JSON.

test_torture.py attacks them.
"""

from __future__ import annotations

import asyncio
import json
import re
import ssl
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Callable

import aiohttp
import pytest
from aiohttp import web
from harness.rosbridge_peer import Robot, with_robot

from robot_health_monitor.rosbridge.protocol.limits import Limits
from robot_health_monitor.rosbridge.server.connections import Connections, connection_limit
from robot_health_monitor.runtime.http_answers import FileAnswer

try:
    import trustme
except ImportError:
    trustme = None


class Connection:
    def __init__(self, connections: Connections) -> None:
        self.aborted = False
        self._connections = connections

    def abort(self) -> None:
        self._connections.remove(self)
        self.aborted = True


class Clock:
    """Virtual time, and what is to be called in it."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.timers: list[tuple[float, Callable[[], None]]] = []

    def call_later(self, delay_s: float, callback: Callable[[], None]) -> Any:
        timer = (self.now_s + delay_s, callback)
        self.timers.append(timer)
        return SimpleNamespace(cancel=lambda: timer in self.timers and self.timers.remove(timer))

    def pass_until(self, now_s: float) -> None:
        self.now_s = now_s
        for timer in [each for each in self.timers if each[0] <= now_s]:
            self.timers.remove(timer)
            timer[1]()


def fill(limit: int) -> tuple[Connections, list[Connection], Clock, list[str]]:
    clock = Clock()
    reports: list[str] = []
    connections = Connections(limit, 10.0, reports.append, clock.call_later)
    known = []
    for number in range(limit):
        clock.pass_until(number / 8.0)
        known.append(Connection(connections))
        assert connections.add(known[-1])
    return connections, known, clock, reports


def test_a_new_connection_replaces_the_one_that_has_waited_for_the_longest_time() -> None:
    connections, (first, second, third), _, reports = fill(3)
    connections.set_in_use(first, True)
    connections.set_in_use(second, True)
    connections.set_in_use(second, False)
    gone = []
    for _ in range(2):
        new = Connection(connections)
        assert connections.add(new)
        connections.set_in_use(new, True)
        gone.append([one.aborted for one in (first, second, third)])
    assert gone == [[False, False, True], [False, True, True]]
    assert len(connections._timeouts) == 3
    assert reports == ["connection limit reached; closing the oldest idle one (limit 3)"] * 2


def test_requests_without_the_token_do_not_make_a_connection_younger() -> None:
    connections, (first, second), _, _ = fill(2)
    connections.set_in_use(first, False)
    assert connections.add(Connection(connections))
    assert (first.aborted, second.aborted) == (True, False)


def test_connections_in_use_are_never_replaced() -> None:
    connections, known, _, _ = fill(3)
    for one in known:
        connections.set_in_use(one, True)
    assert not connections.add(Connection(connections))
    connections.remove(known[0])
    assert connections.add(Connection(connections))


def test_connections_that_wait_for_a_request_are_closed_after_the_timeout() -> None:
    connections, (first, second, third, fourth), clock, _ = fill(4)  # at 0, 0.125, 0.25 and 0.375 s
    connections.set_in_use(first, True)
    connections.set_in_use(second, False)  # at 0.375 s
    clock.pass_until(10.3)
    connections.set_in_use(fourth, True)
    connections.set_in_use(fourth, False)  # a request was answered
    assert [one.aborted for one in (first, second, third, fourth)] == [False, False, True, False]
    clock.pass_until(10.4)
    assert [one.aborted for one in (first, second, third, fourth)] == [False, True, True, False]
    connections.remove(fourth)  # the client has gone
    clock.pass_until(100.0)
    assert (first.aborted, fourth.aborted, clock.timers) == (False, False, [])


def test_all_are_closed_at_the_end() -> None:
    connections, known, _, _ = fill(3)
    connections.set_in_use(known[1], True)
    connections.abort_all()
    assert all(one.aborted for one in known)
    assert len(connections._timeouts) == 0
    connections.remove(known[0])  # its transport reports the end later


def test_the_limit_leaves_descriptors_to_the_rest_of_the_process() -> None:
    assert connection_limit(5) == 5
    assert connection_limit(10**9) < 10**9


TLS = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
TRUST = ssl.create_default_context()
if trustme is not None:
    AUTHORITY = trustme.CA()
    AUTHORITY.issue_cert("127.0.0.1").configure_cert(TLS)
    AUTHORITY.configure_trust(TRUST)
needs_trustme = pytest.mark.skipif(trustme is None, reason="trustme, which makes certificates, is not installed")


LARGE = bytes(range(256)) * 40_000


async def size(request: web.Request) -> web.Response:
    return web.json_response(len(await request.read()))


async def broken(request: web.Request) -> web.Response:
    raise RuntimeError("broken")


async def answer(robot: Robot, sent: bytes) -> tuple[int, object]:
    """Returns status and JSON of the answer to what was sent."""
    reader, writer = await asyncio.open_connection("127.0.0.1", robot.server.port)
    writer.write(sent)
    head, _, body = (await asyncio.wait_for(reader.read(), 30.0)).partition(b"\r\n\r\n")
    writer.close()
    assert b"content-type: application/json" in head.lower()
    return int(head.split()[1]), json.loads(body)


@needs_trustme
@with_robot(ssl_context=TLS, routes=lambda client_of: [web.post("/size", size)])
async def test_tls_serves_requests_and_websockets(robot: Robot) -> None:
    url = robot.url.replace("http:", "https:")
    async with aiohttp.ClientSession() as session:
        for _ in range(3):
            async with session.post(url + "size", data=bytes(60_000), ssl=TRUST) as response:
                assert await response.json() == 60_000
        async with session.ws_connect(url, ssl=TRUST) as socket:
            await socket.send_str('{"op": "call_service", "service": "/rosapi/get_time"}')
            assert json.loads((await socket.receive()).data)["result"] is True
    await robot.until(lambda: len(robot.server._connections._timeouts) == 0)


@needs_trustme
@with_robot(ssl_context=TLS, limits=Limits(queue_bytes=20_000_000))
async def test_a_client_over_tls_that_has_read_too_slowly_receives_what_waits_for_it(robot: Robot) -> None:
    robot.node.advertise("/big", "std_msgs/String")
    url = robot.url.replace("http:", "https:")
    async with aiohttp.ClientSession() as session, session.ws_connect(url, ssl=TRUST) as socket:
        await socket.send_str('{"op": "subscribe", "topic": "/big"}')
        await robot.until(lambda: "/big" in robot.bus.graph().nodes["/rosbridge"].subscribes)
        # One call of the loop: nothing can be sent on between these.
        for number in range(250):
            robot.node.publish("/big", {"data": f"{number}" + "x" * 50_000})
        (queue,) = [one.queue for one in robot.server._sessions]
        assert queue.behind
        received = [json.loads((await asyncio.wait_for(socket.receive(), 30.0)).data) for _ in range(250)]
        assert [message["msg"]["data"].rstrip("x") for message in received] == [str(number) for number in range(250)]
        await robot.until(lambda: not queue.behind)


@needs_trustme
@with_robot(ssl_context=TLS, request_timeout_s=0.3)
async def test_a_handshake_that_fails_or_never_ends_is_forgotten(robot: Robot) -> None:
    for sent in (b"", b"\x16\x03\x01\x02\x00\x01", b"GET / HTTP/1.1\r\n\r\n"):
        reader, writer = await asyncio.open_connection("127.0.0.1", robot.server.port)
        writer.write(sent)
        try:
            await asyncio.wait_for(reader.read(), 30.0)
        except ConnectionError:
            pass
        writer.close()
    _, writer = await asyncio.open_connection("127.0.0.1", robot.server.port)
    writer.transport.abort()
    await robot.until(lambda: len(robot.server._connections._timeouts) == 0)


@with_robot()
async def test_an_address_or_a_header_that_is_too_long_is_refused_in_json(robot: Robot) -> None:
    for length in (9_000, 20_000):
        for sent in (b"GET /%s HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nX-Padding: %s\r\n\r\n"):
            assert await answer(robot, sent % (b"x" * length)) == (400, {"error": "address or header too long"})


@with_robot(routes=lambda client_of: [web.get("/broken", broken)])
async def test_a_request_that_is_malformed_or_fails_is_answered_in_json(robot: Robot) -> None:
    """Each is one line of the log, without what the client sent and without a traceback."""
    assert await answer(robot, b"nonsense\r\n\r\n") == (400, {"error": "malformed request"})
    request = b"GET /broken HTTP/1.1\r\nHost: localhost\r\n\r\n"
    assert await answer(robot, request) == (500, {"error": "internal error"})
    malformed, failed = robot.log
    assert re.fullmatch(r"refused a request of 127\.0\.0\.1: malformed request \(\w+\)", malformed)
    assert failed == "refused a request of 127.0.0.1: internal error (RuntimeError)"


@with_robot(routes=lambda client_of: [web.get("/known", size)])
async def test_paths_and_methods_that_do_not_exist_are_refused_in_json(robot: Robot) -> None:
    async with aiohttp.ClientSession() as session:
        for method, path, status, problem, allow in (
            ("GET", "nothing", 404, "Not Found", None),
            ("DELETE", "a/b/c.html", 404, "Not Found", None),
            ("POST", "known", 405, "Method Not Allowed", "GET,HEAD"),
            ("GET", "", 404, "Not Found", None),
        ):
            async with session.request(method, robot.url + path) as response:
                assert (response.status, await response.json()) == (status, {"error": problem})
                assert response.headers.get("Allow") == allow
                assert response.headers["Cache-Control"] == "no-store"


@with_robot(clients=1)
async def test_there_is_room_for_no_more_than_the_clients_in_use(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.settle()
        reader, writer = await asyncio.open_connection("127.0.0.1", robot.server.port)
        assert await asyncio.wait_for(reader.read(), 30.0) == b""
        writer.close()
        await peer.settle()


@pytest.fixture(params=["bytes", "file"])
def large_answer(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., Any]:
    """Returns the route of an answer that is larger than what the sockets of both ends hold."""
    (tmp_path / "content").write_bytes(LARGE)

    async def answer(_: web.Request) -> web.StreamResponse:
        return web.Response(body=LARGE) if request.param == "bytes" else FileAnswer(tmp_path / "content")

    return lambda client_of: [web.get("/content", answer)]


async def begin_of_answer(robot: Robot) -> tuple[bytes, asyncio.StreamReader, asyncio.StreamWriter]:
    """Asks for the large answer; returns its first 1,000 bytes. The reader reads no more until it is asked to."""
    reader, writer = await asyncio.open_connection("127.0.0.1", robot.server.port, limit=1000)
    writer.write(b"GET /content HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")
    return await reader.readexactly(1000), reader, writer


def test_an_answer_that_takes_long_to_send_is_sent_whole(large_answer: Callable[..., Any]) -> None:
    """aiohttp sends an answer after the handler has returned it: a black box over a slow link takes minutes."""

    @with_robot(routes=large_answer)
    async def scenario(robot: Robot) -> None:
        clock = Clock()
        robot.server._connections._call_later = clock.call_later
        begin, reader, writer = await begin_of_answer(robot)
        clock.pass_until(100.0)
        head, _, body = (begin + await reader.read()).partition(b"\r\n\r\n")
        assert (head.split(b"\r\n")[0], body == LARGE) == (b"HTTP/1.1 200 OK", True)
        writer.close()

    scenario()


def test_a_client_that_does_not_read_its_answer_is_disconnected(
    large_answer: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise such clients, which need no more than a request each, would fill the server."""
    monkeypatch.setattr("robot_health_monitor.rosbridge.server.connections.STALL_MS", 200)

    @with_robot(routes=large_answer)
    async def scenario(robot: Robot) -> None:
        _, reader, writer = await begin_of_answer(robot)
        await robot.until(lambda: len(robot.server._connections._timeouts) == 0)
        assert robot.log == []
        with pytest.raises((ConnectionError, asyncio.IncompleteReadError)):
            await reader.readexactly(len(LARGE))
        writer.close()

    scenario()
