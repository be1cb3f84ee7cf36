"""The client's side of a link that goes and comes back, over real sockets."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import math
import socket as sockets
import ssl
from typing import Any, Dict, List

import aiohttp
import pytest
from aiohttp import web
from harness.rosbridge_peer import FLOAT32, Robot, with_robot

from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.rosbridge.client.middleware import RosbridgeClient
from robot_health_monitor.rosbridge.server.access import Access
from robot_health_monitor.rosbridge.server.server import Server

EVERYTHING = Access(publish=("*",), services=("*",), offer=("*",))


class Watched:
    """A client with one node, and what it has heard."""

    def __init__(self, url: str, **options: Any) -> None:
        self.ups: List[bool] = []
        self.client = RosbridgeClient(url.replace("http", "ws", 1), on_link=self.ups.append, **options)
        self.node = self.client.node("watcher")
        self.heard: List[Any] = []
        self.task = asyncio.ensure_future(self.client.run())

    def hear(self, value: Any, now_s: float) -> None:
        self.heard.append(value)

    def problems(self) -> List[str]:
        return [line.text for line in self.client.log_lines if line.severity >= Severity.WARN]

    async def close(self) -> None:
        self.client.close()
        self.task.cancel()
        await asyncio.wait({self.task})


@with_robot(EVERYTHING)
async def test_after_a_restart_everything_is_there_again(robot: Robot) -> None:
    robot_heard: List[float] = []
    robot.node.subscribe("/in", FLOAT32, lambda value, now_s: robot_heard.append(value), field="data")
    watched = Watched(robot.url)
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    watched.node.advertise("/in", FLOAT32)
    watched.node.advertise_service("~reset", "std_srvs/Trigger", lambda request: {"success": True, "message": "here"})

    async def all_works(server: Server) -> None:
        await robot.until(lambda: watched.ups[-1:] == [True])
        await watched.client.link.call_service("/rosapi/get_time", {}, 10.0)
        watched.heard.clear()
        robot_heard.clear()
        robot.publish(19.5)
        watched.node.publish("/in", {"data": 3.5})
        await robot.until(lambda: watched.heard == [19.5] and robot_heard == [3.5])
        assert await server.call("/watcher/reset", {}, None) == {"success": True, "message": "here"}

    await all_works(robot.server)
    await robot.server.close()
    await robot.until(lambda: watched.ups == [True, False])
    watched.node.publish("/in", {"data": 4.5})  # nobody is there to hear it
    second = Server(
        robot.bus.node("rosbridge2"), port=robot.server.port, threads=False, access=EVERYTHING, heartbeat_s=60.0
    )
    await second.start()
    try:
        await all_works(second)
        assert watched.ups == [True, False, True]
        assert len(watched.problems()) == 1
    finally:
        await watched.close()
        await second.close()


@with_robot()
async def test_a_server_that_stays_away_is_one_line_however_often_it_is_tried(robot: Robot) -> None:
    attempts = 0

    async def refuse(request: web.Request) -> web.Response:
        nonlocal attempts
        attempts += 1
        return web.Response(status=404)

    application = web.Application()
    application.router.add_get("/", refuse)
    runner = web.AppRunner(application)
    await runner.setup()
    site = web.TCPSite(runner, "127.0.0.1", 0)
    await site.start()
    watched = Watched(f"ws://127.0.0.1:{runner.addresses[0][1]}")
    try:
        await robot.until(lambda: attempts >= 3)
        assert watched.ups == [False]
        assert len(watched.problems()) == 1
        assert "answers 404: it is no rosbridge server" in watched.problems()[0]
    finally:
        await watched.close()
        await runner.cleanup()


@pytest.mark.parametrize(
    ("url", "reason"),
    [
        ("ws://127.0.0.1:1", "the robot can be reached, but no server listens there"),
        ("ws://no-such-robot.invalid:9090", "the robot cannot be reached"),
    ],
)
def test_the_log_says_whose_fault_it_is(url: str, reason: str) -> None:
    @with_robot()
    async def scenario(robot: Robot) -> None:
        watched = Watched(url)
        await robot.until(lambda: watched.ups == [False])
        await watched.close()
        assert len(watched.problems()) == 1
        assert reason in watched.problems()[0]

    scenario()


@with_robot()
async def test_a_server_that_falls_silent_is_noticed_by_its_missing_pongs(robot: Robot) -> None:
    """A robot that loses its radio says no goodbye: its socket just answers nothing any more."""
    accepted: List[sockets.socket] = []
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
    await robot.until(lambda: watched.ups == [True, False])
    await watched.close()
    await shaking
    for connection in (*accepted, listener):
        connection.close()


class ForeignServer:
    """A rosbridge server that knows nothing of this project: JSON only, and no reply to what it does not like."""

    def __init__(self) -> None:
        self.received: List[Dict[str, Any]] = []
        self.sockets: List[web.WebSocketResponse] = []
        self.types: Dict[str, str] = {}
        self.rosapi = True

    async def start(self) -> str:
        application = web.Application()
        application.router.add_get("/", self._accept)
        self._runner = web.AppRunner(application)
        await self._runner.setup()
        await web.TCPSite(self._runner, "127.0.0.1", 0).start()
        return f"ws://127.0.0.1:{self._runner.addresses[0][1]}"

    async def close(self) -> None:
        for socket in self.sockets:
            await socket.close()
        await self._runner.cleanup()

    async def _accept(self, request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        self.sockets.append(socket)
        async for message in socket:
            if message.type == aiohttp.WSMsgType.TEXT:
                fields = json.loads(message.data)
                self.received.append(fields)
                if fields["op"] == "call_service" and not self.rosapi:
                    failure = {"op": "service_response", "id": fields["id"], "service": "s", "values": "not there"}
                    await socket.send_json({**failure, "result": False})
                elif fields["op"] == "call_service":
                    values = {"type": self.types.get(fields["args"]["topic"], "")}
                    await socket.send_json(
                        {"op": "service_response", "id": fields["id"], "service": "s", "values": values, "result": True}
                    )
        return socket


@with_robot()
async def test_with_a_foreign_server_it_is_plain_json_with_ros_1s_names(robot: Robot) -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/battery_level", "std_msgs/msg/Float32", watched.hear, field="data")
        watched.node.advertise("/alerts", "diagnostic_msgs/msg/DiagnosticStatus")
        await robot.until(lambda: len(foreign.received) == 2)
        assert foreign.received == [
            {"op": "advertise", "topic": "/alerts", "type": "diagnostic_msgs/DiagnosticStatus"},
            {
                "op": "subscribe",
                "topic": "/battery_level",
                "type": "std_msgs/Float32",
                "id": "subscribe:/battery_level",
            },
        ]
        for text in (
            '{"op": "publish", "topic": "/battery_level", "msg": {"data": null}}',
            '{"op": "status", "level": "info", "msg": "hello"}',
            '{"op": "publish", "topic": "/other", "msg": {"data": 1.0}}',
            "not JSON at all",
            '{"op": "publish", "topic": "/battery_level", "msg": {"data": 19.5}}',
        ):
            await foreign.sockets[0].send_str(text)
        await robot.until(lambda: len(watched.heard) == 2)
        assert math.isnan(watched.heard[0]) and watched.heard[1] == 19.5
        assert watched.ups == [True]
    finally:
        await watched.close()
        await foreign.close()


@with_robot()
async def test_the_type_of_a_topic_is_asked_for_until_somebody_publishes_it(robot: Robot) -> None:
    foreign = ForeignServer()
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/odom", "", watched.hear, field=None)
        await robot.until(lambda: sum(fields["op"] == "call_service" for fields in foreign.received) >= 1)
        assert all(fields["op"] != "subscribe" for fields in foreign.received)
        foreign.types["/odom"] = "nav_msgs/msg/Odometry"
        await robot.until(lambda: foreign.received[-1]["op"] == "subscribe")
        assert foreign.received[-1]["type"] == "nav_msgs/Odometry"
        await foreign.sockets[0].send_str('{"op": "publish", "topic": "/odom", "msg": {}}')
        await robot.until(lambda: watched.heard == [1.0])
    finally:
        await watched.close()
        await foreign.close()


@with_robot()
async def test_without_rosapi_a_subscription_without_a_type_is_tried_until_messages_come(robot: Robot) -> None:
    foreign = ForeignServer()
    foreign.rosapi = False
    watched = Watched(await foreign.start())
    try:
        watched.node.subscribe("/odom", "", watched.hear, field=None)
        subscription = {"op": "subscribe", "topic": "/odom", "id": "subscribe:/odom"}
        await robot.until(lambda: foreign.received.count(subscription) >= 2)
        await foreign.sockets[0].send_str('{"op": "publish", "topic": "/odom", "msg": {}}')
        await robot.until(lambda: watched.heard == [1.0])
        assert not watched.client.link._untyped
    finally:
        await watched.close()
        await foreign.close()


@with_robot(EVERYTHING)
async def test_a_client_that_only_watches_leaves_no_trace(robot: Robot) -> None:
    watched = Watched(robot.url, read_only=True)
    watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
    watched.node.advertise("/alerts", FLOAT32)
    watched.node.publish("/alerts", {"data": 1.0})
    watched.node.advertise_service("~reset", "std_srvs/Trigger", lambda request: {})
    await robot.until(lambda: watched.ups == [True])
    await watched.client.link.call_service("/rosapi/get_time", {}, 10.0)
    assert "/alerts" not in robot.bus.graph().topics
    assert robot.server.offers.types == {}
    robot.publish(1.0)
    await robot.until(lambda: watched.heard == [1.0])
    await watched.close()


@with_robot()
async def test_a_field_that_the_messages_lack_is_one_line(robot: Robot) -> None:
    watched = Watched(robot.url)
    watched.node.subscribe("/battery_level", "", watched.hear, field="percentage")
    await robot.until(lambda: watched.ups == [True])
    await watched.client.link.call_service("/rosapi/get_time", {}, 10.0)
    robot.publish(1.0, 2.0, 3.0)
    await robot.until(lambda: bool(watched.problems()))
    await watched.client.link.call_service("/rosapi/get_time", {}, 10.0)
    assert watched.problems() == ["/battery_level has no field percentage; there are data"]
    await watched.close()


def test_a_process_that_stood_still_says_that_it_was_its_own_fault() -> None:
    """Stopped and continued, as by Ctrl-Z or a laptop's lid: the test's clock jumps where the loop's would."""

    async def scenario() -> None:
        loop = asyncio.get_event_loop()
        jump_s = 0.0
        real_time = loop.time
        loop.time = lambda: real_time() + jump_s  # type: ignore[method-assign]
        watched = Watched("ws://127.0.0.1:1")
        for _ in range(200):
            await asyncio.sleep(0.01)
            if watched.ups:
                break
        jump_s = 60.0
        for _ in range(200):
            await asyncio.sleep(0.01)
            if any("own fault" in text for text in watched.problems()):
                break
        await watched.close()
        assert any("own fault: this process stood still for" in text for text in watched.problems())

    asyncio.run(scenario())


def test_tls_and_a_clients_certificate_carry_a_link(tmp_path: Any) -> None:
    trustme = pytest.importorskip("trustme", reason="trustme, which makes certificates, is not installed")
    authority = trustme.CA()
    served = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    authority.issue_cert("localhost").configure_cert(served)
    authority.configure_trust(served)
    served.verify_mode = ssl.CERT_REQUIRED
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)

    @with_robot(ssl_context=served)
    async def scenario(robot: Robot) -> None:
        url = f"wss://localhost:{robot.server.port}"
        doubter = Watched(url)
        await robot.until(lambda: doubter.ups == [False])
        await doubter.close()
        assert "own fault: the server's certificate is not trusted" in doubter.problems()[0]
        stranger = Watched(url, ssl_context=trusting)
        await robot.until(lambda: bool(stranger.ups) and not stranger.ups[-1])
        await stranger.close()
        mine = ssl.create_default_context()
        authority.configure_trust(mine)
        authority.issue_cert("laptop").configure_cert(mine)
        watched = Watched(url, ssl_context=mine)
        watched.node.subscribe("/battery_level", FLOAT32, watched.hear, field="data")
        await robot.until(lambda: watched.ups == [True])
        await watched.client.link.call_service("/rosapi/get_time", {}, 10.0)
        robot.publish(19.5)
        await robot.until(lambda: watched.heard == [19.5])
        await watched.close()

    scenario()
