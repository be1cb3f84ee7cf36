"""The other side of the benchmarks of servers and of `connect`: `python -m benchmarks.peers ROLE ARGUMENTS`.

Servers write their port when they are ready, clients `ready`; then each answers lines.

    server                          this project's server in front of a local bus; `RATE_HZ SECONDS` sends messages at
                                    an even pace, and the answer is how many
    floor                           the same with the bare library: one encoded text to every client
    monitor ROBOTS RATE_HZ [bare]   robots that are judged and served; `bare` is without page and API
    clients PORT COUNT [TOPIC]      subscribers of a topic, or pages that show robot0 with its plots; each line is
                                    answered with how many messages the one with the fewest has got
    robots                          the servers of all robots, in one process, one connection each at
                                    `/CONTESTANT/ROBOT`: they speak rosbridge in JSON; to the contestant `cbor` in CBOR,
                                    to `foxglove` Foxglove's protocol with messages in CDR
    bare URL ROBOTS                 receives and parses what robots send, with aiohttp and json
    alerts URL                      receives alerts; each line is answered with when the first of each robot came
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import json
import logging
import os
import struct
import sys
import time
from typing import Any, Awaitable, Callable

import aiohttp
import cbor2
from aiohttp import web

from benchmarks.processes import answer
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.web import WebInterface
from robot_health_monitor.rosbridge.protocol import DEFAULT_LIMITS
from robot_health_monitor.rosbridge.server import Server

SIGNALS = 10
"""Signals of each robot."""


async def listen(accept: Callable[[web.Request], Awaitable[web.StreamResponse]], path: str = "/") -> int:
    """Serves the requests of a path on a free port of this machine, and returns the port."""
    application = web.Application()
    application.router.add_route("*", path, accept)
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0, backlog=1000).start()
    return int(runner.addresses[0][1])


async def _serve(port: int, send: Callable[[int], Awaitable[None]]) -> None:
    async def reply(rate_hz: str, seconds: str) -> int:
        count, begin_s = int(float(rate_hz) * float(seconds)), time.monotonic()
        for number in range(count):
            await asyncio.sleep(max(0.0, begin_s + (number + 1) / float(rate_hz) - time.monotonic()))
            await send(number)
        return count

    await answer(port, reply)


async def _server() -> None:
    bus = LocalBus()
    robot = bus.node("robot")
    robot.advertise("/battery_level", "std_msgs/Float32")
    limits = DEFAULT_LIMITS._replace(heartbeat_s=3600.0, slow_client_timeout_s=3600.0)
    served = Server(bus.node("rosbridge"), port=0, threads=False, limits=limits)
    await served.start()

    async def send(number: int) -> None:
        robot.publish("/battery_level", {"data": float(number)})

    await _serve(served.port, send)


async def _floor() -> None:
    sockets: list[web.WebSocketResponse] = []

    async def accept(request: web.Request) -> web.WebSocketResponse:
        websocket = web.WebSocketResponse(compress=False)
        await websocket.prepare(request)
        sockets.append(websocket)
        async for _ in websocket:
            pass
        return websocket

    async def send(number: int) -> None:
        for websocket in sockets:
            await websocket.send_str('{"op":"publish","topic":"/battery_level","msg":{"data":1000.0}}')

    await _serve(await listen(accept), send)


async def _monitor(count: str, rate_hz: str, kind: str = "") -> None:
    """Judges and serves robots in real time."""
    bus = LocalBus(time.monotonic(), on_log=lambda line: None, wall_time_s=time.time, clock=time.monotonic)
    signal = {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0}
    settings = {f"signal_{number}": signal for number in range(SIGNALS)}
    robots = []
    for name in (f"robot{number}" for number in range(int(count))):
        node = bus.node("alert_system", namespace=name, parameters={"robot_name": name, "signals": settings})
        robots.append(AlertSystem(node, log_alerts=False))
    outside = bus.node("outside")
    topics = [f"/robot{robot}/{signal}" for robot in range(len(robots)) for signal in settings]
    for topic in topics:
        outside.advertise(topic, "std_msgs/Float32")
    history = History(None)
    interface = WebInterface(lambda: robots, history, Silences(history))
    for robot in robots:
        interface.watch(robot)
    routes = (lambda client_of: ()) if kind == "bare" else interface.routes
    server = Server(bus.node("rosbridge"), port=0, threads=False, routes=routes, on_close=interface.close)
    await server.start()
    print(server.port, flush=True)
    next_s, number = time.monotonic(), 0
    while True:
        for topic in topics:
            outside.publish(topic, {"data": 50.0 + number % 17})
            number += 1
        next_s += 1.0 / float(rate_hz)
        while time.monotonic() < next_s:
            bus.run_due(time.monotonic())
            due_s = bus.next_due_s()
            assert due_s is not None
            await asyncio.sleep(max(0.0, min(due_s, next_s) - time.monotonic()))


async def _clients(port: str, count: str, topic: str = "") -> None:
    """Clients that count messages by their beginnings, which costs less than to read them."""
    counts = [0] * int(count)
    request, mark = "GET /api/events?robot=robot0 HTTP/1.1\r\nHost: localhost\r\n\r\n", b"\ndata:"
    subscription = b""
    if topic:
        key, mark = base64.b64encode(os.urandom(16)).decode(), b'"op":"publish"'
        request = "GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        request += f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n"
        text = json.dumps({"op": "subscribe", "topic": topic}).encode()
        subscription = bytes([0x81, 0x80 | len(text)]) + bytes(4) + text

    async def read(index: int, reader: asyncio.StreamReader) -> None:
        rest = b""
        while data := await reader.read(65536):
            data = rest + data
            counts[index] += data.count(mark)
            rest = data[1 - len(mark) :]  # a mark that is cut is in the next piece

    async def fewest(_: str) -> int:
        return min(counts)

    kept: list[Any] = []  # a connection ends with the last reference to it
    for index in range(len(counts)):
        reader, writer = await asyncio.open_connection("127.0.0.1", int(port))
        writer.write(request.encode() + subscription)
        await reader.readuntil(b"\r\n\r\n")
        kept += [writer, asyncio.ensure_future(read(index, reader))]
    await asyncio.sleep(0.3)  # for the subscriptions to be taken
    await answer("ready", fewest)


_SUBPROTOCOLS = {"cbor": ("rosbridge.v2.cbor",), "foxglove": ("foxglove.sdk.v1",)}
_FLOAT32 = {
    "encoding": "cdr", "schemaName": "std_msgs/msg/Float32", "schemaEncoding": "ros2msg", "schema": "float32 data",
}  # fmt: skip
_CHANNELS = [{"id": number, "topic": f"/signal_{number}", **_FLOAT32} for number in range(SIGNALS)]


def _encoded(contestant: str, signal: int, value: float) -> str | bytes:
    """Returns a message as a contestant gets it."""
    if contestant == "foxglove":  # channels are subscribed to in their order; 256: the header of CDR, little endian
        return struct.pack("<BIQIf", 1, signal, 0, 256, value)
    message = {"op": "publish", "topic": f"/signal_{signal}", "msg": {"data": value}}
    return cbor2.dumps(message) if contestant == "cbor" else json.dumps(message)


async def _robots() -> None:
    """Sends the same messages on every connection.

    `wait COUNT` is answered once that many connections are subscribed. `send SECONDS` sends every signal once a second
    on each connection, evenly spread; the answer is how many messages each contestant was sent. In each second, the
    first signal of another robot is below its bound once; `low` is answered with when that was, in s, by robot.
    """
    latest: dict[tuple[str, str], web.WebSocketResponse] = {}
    contestants: set[str] = set()
    low_s: dict[str, float] = {}

    async def accept(request: web.Request) -> web.WebSocketResponse:
        contestant = request.match_info["contestant"]
        socket = web.WebSocketResponse(protocols=_SUBPROTOCOLS.get(contestant, ()), compress=False)
        await socket.prepare(request)
        if contestant == "foxglove":
            await socket.send_json({"op": "advertise", "channels": _CHANNELS})
        await socket.receive()  # the first subscription
        contestants.add(contestant)
        latest[contestant, request.match_info["robot"]] = socket
        async for _ in socket:
            pass
        return socket

    async def send(seconds: float) -> int:
        sockets = list(latest.items())
        per_second = len(sockets) * SIGNALS
        sent, begin_s, first_low = 0, time.monotonic(), len(low_s)
        while sent < per_second * seconds:
            await asyncio.sleep(0.002)
            while sent < min((time.monotonic() - begin_s) * per_second, per_second * seconds):
                signal, number = divmod(sent % per_second, len(sockets))
                (contestant, robot), socket = sockets[number]
                value = 60.0 + sent % 7
                if signal == 0 and robot == f"robot{first_low + sent // per_second}":
                    value = 5.0
                    low_s.setdefault(robot, time.monotonic())
                message = _encoded(contestant, signal, value)
                with contextlib.suppress(ConnectionResetError):  # it connects again
                    await (socket.send_str(message) if isinstance(message, str) else socket.send_bytes(message))
                sent += 1
        return sent // len(contestants)

    async def reply(asked: str, value: str = "") -> object:
        if asked == "send":
            return await send(float(value))
        while asked == "wait" and len(latest) < int(value):
            await asyncio.sleep(0.05)
        return json.dumps(low_s)

    logging.getLogger("aiohttp.websocket").setLevel(logging.ERROR)  # no line about each client that can also do CBOR
    await answer(await listen(accept, "/{contestant}/{robot}"), reply)


async def _bare(url: str, robots: str) -> None:
    """One task per connection."""

    async def read(session: aiohttp.ClientSession, number: int) -> None:
        async with session.ws_connect(f"{url}/robot{number}") as socket:
            await socket.send_str("{}")
            async for message in socket:
                json.loads(message.data)

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        await asyncio.gather(*(read(session, number) for number in range(int(robots))))


async def _alerts(url: str) -> None:
    seen_s: dict[str, float] = {}

    async def reply(_: str) -> str:
        return json.dumps(seen_s)

    async with aiohttp.ClientSession() as session, session.ws_connect(url) as socket:
        await socket.send_json({"op": "subscribe", "topic": "/alerts"})
        answering = asyncio.ensure_future(answer("ready", reply))
        async for message in socket:
            seen_s.setdefault(json.loads(message.data)["msg"]["hardware_id"], time.monotonic())
        await answering


if __name__ == "__main__":
    roles = (_server, _floor, _monitor, _clients, _robots, _bare, _alerts)
    asyncio.run({role.__name__[1:]: role for role in roles}[sys.argv[1]](*sys.argv[2:]))
