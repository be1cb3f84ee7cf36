"""Connections as clients see them: TLS, sizes, errors in JSON. test_torture.py attacks them."""

from __future__ import annotations

import asyncio
import json
import ssl
from typing import Tuple

import aiohttp
import pytest
from aiohttp import web
from harness.rosbridge_peer import Robot, with_robot

trustme = pytest.importorskip("trustme", reason="trustme, which makes certificates, is not installed")
AUTHORITY = trustme.CA()
TLS = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
AUTHORITY.issue_cert("127.0.0.1").configure_cert(TLS)
TRUST = ssl.create_default_context()
AUTHORITY.configure_trust(TRUST)


async def size(request: web.Request) -> web.Response:
    return web.json_response(len(await request.read()))


async def broken(request: web.Request) -> web.Response:
    raise RuntimeError("broken")


async def answer(robot: Robot, sent: bytes) -> Tuple[int, object]:
    """Returns status and JSON of the answer to what was sent."""
    reader, writer = await asyncio.open_connection("127.0.0.1", robot.server.port)
    writer.write(sent)
    head, _, body = (await asyncio.wait_for(reader.read(), 30.0)).partition(b"\r\n\r\n")
    writer.close()
    assert b"content-type: application/json" in head.lower()
    return int(head.split()[1]), json.loads(body)


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
    await robot.until(lambda: len(robot.server._connections) == 0)


@with_robot(ssl_context=TLS, auth_timeout_s=0.3)
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
    await robot.until(lambda: len(robot.server._connections) == 0)


@with_robot()
async def test_an_address_or_a_header_that_is_too_long_is_refused_in_json(robot: Robot) -> None:
    for length in (9_000, 20_000):
        for sent in (b"GET /%s HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nX-Padding: %s\r\n\r\n"):
            assert await answer(robot, sent % (b"x" * length)) == (400, {"error": "address or header too long"})


@with_robot(routes=lambda client_of: [web.get("/broken", broken)])
async def test_a_request_that_is_malformed_or_fails_is_answered_in_json(robot: Robot) -> None:
    assert await answer(robot, b"nonsense\r\n\r\n") == (400, {"error": "malformed request"})
    request = b"GET /broken HTTP/1.1\r\nHost: localhost\r\n\r\n"
    assert await answer(robot, request) == (500, {"error": "internal error"})


@with_robot(routes=lambda client_of: [web.get("/known", size)])
async def test_paths_and_methods_that_do_not_exist_are_refused_in_json(robot: Robot) -> None:
    async with aiohttp.ClientSession() as session:
        for method, path, status, problem, allow in (
            ("GET", "nothing", 404, "there is no path /nothing", None),
            ("DELETE", "a/b/c.html", 404, "there is no path /a/b/c.html", None),
            ("POST", "known", 405, "expected the method GET", "GET,HEAD"),
            ("GET", "", 426, "this is a rosbridge server: connect with a WebSocket", None),
        ):
            async with session.request(method, robot.url + path) as response:
                assert (response.status, await response.json()) == (status, {"error": problem})
                assert response.headers.get("Allow") == allow
                assert response.headers["Cache-Control"] == "no-store"


@with_robot(max_clients=1)
async def test_there_is_room_for_no_more_than_the_clients_in_use(robot: Robot) -> None:
    async with robot.peer() as peer:
        await peer.settle()
        assert await answer(robot, b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n") == (503, {"error": "too many clients"})
        await peer.settle()
