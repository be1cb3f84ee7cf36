"""The connection to a foxglove server: what is offered, lost links, and servers that mean harm."""

from __future__ import annotations

import json
import ssl
from typing import Any

import pytest
from aiohttp import web
from harness.foxglove_client import FLOAT, Server, Watched, cdr, message
from harness.rosbridge_client import ForeignServer, scenario, until

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.field_path import ABSENT
from robot_health_monitor.foxglove import FoxgloveClient
from robot_health_monitor.rosbridge.server.server import Server as RosbridgeServer


async def hearing(server: Server, **options: Any) -> Watched:
    """Returns a client that has subscribed to /battery."""
    watched = Watched(await server.start(), **options)
    watched.node.subscribe("/battery", "", watched.hear, field="data")
    await until(lambda: 3 in server.subscribed)
    return watched


@scenario
async def test_both_subprotocols_and_the_token_are_presented() -> None:
    server = Server()
    watched = await hearing(server, token="secret")
    headers = server.requests[0].headers
    assert headers["Sec-WebSocket-Protocol"].replace(" ", "") == "foxglove.sdk.v1,foxglove.websocket.v1"
    assert headers["Authorization"] == "Bearer secret"
    await watched.close()
    await server.close()


@pytest.mark.parametrize("protocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_messages_arrive_whichever_version_the_server_speaks(protocol: str) -> None:
    @scenario
    async def run() -> None:
        server = Server(protocols=(protocol,))
        watched = await hearing(server)
        await server.send(message(server.subscribed[3], cdr(20.5)))
        await until(lambda: watched.heard == [20.5])
        assert watched.ups == [True] and watched.problems() == []
        await watched.close()
        await server.close()

    run()


def test_tls_needs_a_certificate_that_is_trusted() -> None:
    trustme = pytest.importorskip("trustme", reason="trustme, which makes certificates, is not installed")
    authority = trustme.CA()
    served = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert("localhost").configure_cert(served)
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)

    @scenario
    async def run() -> None:
        server = Server()
        url = await server.start(ssl_context=served)
        doubter = Watched(url)
        await until(lambda: doubter.ups == [False])
        await doubter.close()
        assert doubter.causes[0].startswith("check this computer's settings: the server's certificate is not trusted: ")
        watched = Watched(url, ssl_context=trusting)
        watched.node.subscribe("/battery", "", watched.hear, field="data")
        await until(lambda: 3 in server.subscribed)
        await server.send(message(server.subscribed[3], cdr(19.5)))
        await until(lambda: watched.heard == [19.5])
        await watched.close()
        await server.close()

    run()


@scenario
async def test_a_server_that_offers_nothing_is_up() -> None:
    server = Server(channels=())
    watched = Watched(await server.start())
    await until(lambda: watched.ups == [True])
    watched.node.subscribe("/battery", "", watched.hear, field="data")
    await server.send({"op": "advertise", "channels": [FLOAT]})
    await until(lambda: 3 in server.subscribed)
    await watched.close()
    await server.close()


@scenario
async def test_after_a_lost_link_everything_is_subscribed_again() -> None:
    server = Server()
    watched = await hearing(server)
    await until(lambda: watched.ups == [True])
    await server.sockets[0].close()
    await until(lambda: watched.ups == [True, False, True])
    assert watched.causes == ["the server closed the connection"]
    await until(lambda: sum(each["op"] == "subscribe" for each in server.received) == 2)
    await server.send(message(server.subscribed[3], cdr(1.0)))
    await until(lambda: watched.heard == [1.0])
    await watched.close()
    await server.close()


@scenario
async def test_a_rosbridge_server_is_named_and_never_up() -> None:
    bus = LocalBus(0.0)
    ours = RosbridgeServer(bus.node("rosbridge"), port=0, threads=False)
    await ours.start()
    foreign = ForeignServer()
    for port in (ours.port, int((await foreign.start()).rpartition(":")[2])):
        watched = Watched(f"foxglove://127.0.0.1:{port}")
        await until(lambda watched=watched: bool(watched.causes))
        assert watched.causes[0] == f"this is a rosbridge server: ws://127.0.0.1:{port}"
        assert watched.ups == [False]
        await watched.close()
    await foreign.close()
    await ours.close()


@scenario
async def test_a_server_without_the_protocol_is_never_up() -> None:
    server = Server(channels=(), protocols=("chat",))
    watched = Watched(await server.start())
    await until(lambda: bool(watched.causes))
    assert watched.causes[0] == "not a foxglove server: it does not speak Foxglove's protocol"
    assert watched.ups == [False]
    await watched.close()
    await server.close()


@pytest.mark.parametrize(
    ("status", "cause"),
    [
        (400, "not a foxglove server (HTTP 400)"),
        (401, "check this computer's settings: no token"),
        (404, "not a foxglove server (HTTP 404)"),
        (501, "not a foxglove server (HTTP 501)"),
        (503, "the server is not ready (HTTP 503)"),
    ],
)
def test_a_refusal_has_its_cause(status: int, cause: str) -> None:
    @scenario
    async def run() -> None:
        async def refuse(request: web.Request) -> web.Response:
            return web.Response(status=status)

        server = Server()
        server._accept = refuse  # type: ignore[method-assign, assignment]
        watched = Watched(await server.start())
        await until(lambda: bool(watched.causes))
        assert watched.causes[0] == cause
        await watched.close()
        await server.close()

    run()


@scenario
async def test_a_redirect_is_not_followed() -> None:
    server = Server()

    async def redirect(request: web.Request) -> web.Response:
        raise web.HTTPFound("ws://elsewhere:1/")

    server._accept = redirect  # type: ignore[method-assign, assignment]
    watched = Watched(await server.start())
    await until(lambda: bool(watched.causes))
    assert watched.causes[0] == "the server redirects to ws://elsewhere:1/ (HTTP 302); redirects are not followed"
    await watched.close()
    await server.close()


HOSTILE: dict[str, list[Any]] = {
    "unknown opcodes": [bytes([opcode]) * 40 for opcode in (0, 2, 3, 9, 255)],
    "bytes too short": [b"\x01", b"\x01" * 12],
    "another subscription": [message(4_000_000_000, cdr(1.0))],
    "no JSON": ["{", "[" * 100_000, "null", '{"op": 3}'],
    "channels of other forms": [{"op": "advertise", "channels": [None, {}, {"id": {}}, {**FLOAT, "id": -1}]}],
    "lists of other forms": [{"op": "advertise", "channels": {}}, {"op": "unadvertise", "channelIds": {}}],
    "withdrawn and unknown": [{"op": "unadvertise", "channelIds": [99, "x", None]}],
    "a bad payload": [message(0, b""), message(0, b"\x00"), message(0, b"\xff" * 3)],
    "another century": [message(0, cdr(7.0), time_ns=2**64 - 1)],
    "ten thousand channels": [
        {
            "op": "advertise",
            "channels": [{**FLOAT, "id": 10 + number, "topic": f"/t{number}"} for number in range(10_100)],
        }
    ],
    "schemas that contain themselves": [
        {
            "op": "advertise",
            "channels": [
                {**FLOAT, "id": 6, "schemaName": "a/msg/B", "schema": "a/B b\n" + "=" * 80 + "\nMSG: a/B\na/B b\n"}
            ],
        }
    ],
}


@pytest.mark.parametrize("items", HOSTILE.values(), ids=HOSTILE.keys())
def test_what_a_hostile_server_sends_costs_nothing_else(items: list[Any]) -> None:
    @scenario
    async def run() -> None:
        server = Server()
        watched = await hearing(server)
        for item in items:
            await server.send(item)
        await server.send(message(server.subscribed[3], cdr(20.5)))
        await until(lambda: 20.5 in watched.heard)
        assert watched.ups == [True] and {value for value in watched.heard if value is not ABSENT} <= {20.5, 7.0}
        assert len(watched.problems()) <= 2, watched.problems()
        await watched.close()
        await server.close()

    run()


@scenario
async def test_a_message_that_is_too_large_ends_the_connection_only() -> None:
    server = Server()
    watched = await hearing(server)
    watched.client.connection._largest_message_bytes = 1_000
    await server.sockets[0].close()
    await until(lambda: watched.ups == [True, False, True] or watched.ups == [True, False])
    await until(lambda: len(server.sockets) == 2)
    await server.send(message(0, bytes(5_000)))
    await until(lambda: "connection closed: a message is larger than this client accepts" in watched.causes)
    await until(lambda: len(server.sockets) == 3)
    await watched.close()
    await server.close()


@scenario
async def test_a_subscription_that_is_never_served_is_silent_and_up() -> None:
    server = Server()
    watched = await hearing(server)
    await until(lambda: watched.ups == [True])
    answers: list[str | None] = []
    watched.node.look_up_silence("/battery", "std_msgs/Float32", answers.append)
    await until(lambda: answers == [None])
    assert watched.heard == []
    await watched.close()
    await server.close()


@scenario
async def test_errors_of_the_server_are_logged_and_limited() -> None:
    server = Server()
    watched = await hearing(server)
    for number in range(200):
        await server.send({"op": "status", "level": 2, "message": f"no room\n{number}"})
    await server.send(message(server.subscribed[3], cdr(1.0)))
    await until(lambda: watched.heard == [1.0])
    assert 1 <= len(watched.problems()) <= 3
    assert "reports: no room?0" in watched.problems()[0].replace("\\n", "?")
    await watched.close()
    await server.close()


@scenario
async def test_large_lists_of_channels_are_parsed_beside_the_loop() -> None:
    server = Server()
    watched = await hearing(server)
    channels = [{**FLOAT, "id": 100 + number, "topic": f"/t{number}"} for number in range(3_000)]
    text = json.dumps({"op": "advertise", "channels": channels})
    assert len(text) > 200_000
    await server.send(text)
    await until(lambda: len(watched.client.connection.channels.topics()) == 3_001)
    await watched.close()
    await server.close()


@pytest.mark.parametrize("url", ["http://robot:8765", "foxglove://", "foxglove://robot:99999", "robot"])
def test_an_address_that_is_none_is_a_configuration_error(url: str) -> None:
    with pytest.raises(ConfigError, match="foxglove://host:port"):
        FoxgloveClient(url, on_link=lambda *link: None, on_log=lambda line: None)
