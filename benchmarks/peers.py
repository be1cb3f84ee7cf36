"""The other side of the benchmarks of servers and of `connect`: `python -m benchmarks.peers ROLE ARGUMENTS`.

Servers write their port when they are ready, clients `ready`; then each answers lines.

    server                          this project's server in front of a local bus; `RATE_HZ SECONDS` sends messages at
                                    an even pace, and the answer is how many
    floor                           the same with the bare library: one encoded text to every client
    clients PORT COUNT [TOPIC]      subscribers of a topic, or pages that show robot0 with its plots; each line is
                                    answered with how many messages the one with the fewest has got
    robots COUNT RATE_HZ            the servers of all robots, in one process, one connection each at
                                    `/CONTESTANT/ROBOT`: rosbridge in JSON, in CBOR (`cbor`), or Foxglove's protocol
    bare URL ROBOTS                 receives and parses what robots send, with aiohttp and json
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
import struct
import sys
import time
from functools import partial
from typing import Any, Awaitable, Callable

import aiohttp
import cbor2
from aiohttp import web

from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.rosbridge.protocol import DEFAULT_LIMITS
from robot_health_monitor.rosbridge.server import Server

SIGNALS = 10
"""Signals of each robot."""
TICKS_HZ = 500
"""How often `robots` sends some messages."""


async def listen(accept: Callable[[web.Request], Awaitable[web.StreamResponse]], path: str = "/") -> int:
    """Serves the requests of a path on a free port of this machine, and returns the port."""
    application = web.Application()
    application.router.add_route("*", path, accept)
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0, backlog=1000).start()
    return int(runner.addresses[0][1])


async def read_lines(pipe: Any) -> asyncio.StreamReader:
    """Returns what reads a pipe."""
    lines = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), pipe)
    return lines


async def _answer(first: object, reply: Callable[..., Awaitable[object]]) -> None:
    """Writes a line that says that a peer is ready, then the reply to the words of each line that it is asked."""
    print(first, flush=True)
    lines = await read_lines(sys.stdin)
    while words := (await lines.readline()).decode().split():
        print(await reply(*words), flush=True)


async def _paced(send: Callable[[int], Awaitable[None]], rate_hz: str | float, seconds: str | float) -> int:
    """Calls `send` with 0, 1, ... at an even pace; returns how often."""
    count, begin_s = round(float(rate_hz) * float(seconds)), time.monotonic()
    for number in range(count):
        await asyncio.sleep(max(0.0, begin_s + (number + 1) / float(rate_hz) - time.monotonic()))
        await send(number)
    return count


async def _server() -> None:
    bus = LocalBus()
    robot = bus.node("robot")
    robot.advertise("/battery_level", "std_msgs/Float32")
    limits = DEFAULT_LIMITS._replace(heartbeat_s=3600.0, slow_client_timeout_s=3600.0)
    served = Server(bus.node("rosbridge"), port=0, threads=False, limits=limits)
    await served.start()

    async def send(number: int) -> None:
        robot.publish("/battery_level", {"data": float(number)})

    await _answer(served.port, partial(_paced, send))


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

    await _answer(await listen(accept), partial(_paced, send))


async def _clients(port: str, count: str, topic: str = "") -> None:
    """Clients that count messages by their beginnings, which costs less than to read them."""
    path, mark, headers, subscription = "/api/events?robot=robot0", b"\ndata:", "", b""
    if topic:
        path, mark, headers = "/", b'"op":"publish"', "Upgrade: websocket\r\nConnection: Upgrade\r\n"
        headers += f"Sec-WebSocket-Key: {'A' * 22}==\r\nSec-WebSocket-Version: 13\r\n"
        text = json.dumps({"op": "subscribe", "topic": topic}).encode()
        subscription = bytes([0x81, 0x80 | len(text)]) + bytes(4) + text
    request = f"GET {path} HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n".encode() + subscription
    counts = [0] * int(count)

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
        writer.write(request)
        await reader.readuntil(b"\r\n\r\n")
        kept += [writer, asyncio.ensure_future(read(index, reader))]
    await asyncio.sleep(0.3)  # for the subscriptions to be taken
    await _answer("ready", fewest)


_SUBPROTOCOLS = {"cbor": ("rosbridge.v2.cbor",), "foxglove": ("foxglove.sdk.v1",)}
_FLOAT32 = {"schemaName": "std_msgs/msg/Float32", "schemaEncoding": "ros2msg", "schema": "float32 data"}
_CHANNELS = [{"id": number, "topic": f"/signal_{number}", "encoding": "cdr", **_FLOAT32} for number in range(SIGNALS)]


async def _send(socket: web.WebSocketResponse, contestant: str, signal: int, value: float) -> None:
    """Sends a message as a contestant gets it."""
    message = {"op": "publish", "topic": f"/signal_{signal}", "msg": {"data": value}}
    with contextlib.suppress(ConnectionResetError):  # it connects again
        if contestant == "foxglove":  # channels are subscribed to in their order; 256: the header of CDR, little endian
            await socket.send_bytes(struct.pack("<BIQIf", 1, signal, 0, 256, value))
        elif contestant == "cbor":
            await socket.send_bytes(cbor2.dumps(message))
        else:
            await socket.send_json(message)


async def _receive_alerts(port: str, seen_s: dict[str, float]) -> None:
    """Notes when the first alert of each robot came."""
    async with aiohttp.ClientSession() as session, session.ws_connect(f"http://127.0.0.1:{port}/") as socket:
        await socket.send_json({"op": "subscribe", "topic": "/alerts"})
        async for message in socket:
            seen_s.setdefault(json.loads(message.data)["msg"]["hardware_id"], time.monotonic())


async def _robots(count: str, rate_hz: str) -> None:
    """Sends the same messages on every connection.

    A number of seconds sends every signal at RATE_HZ on each connection, evenly spread, as soon as COUNT are
    subscribed; the answer is how many messages each contestant was sent. In each period, the first signal of another
    robot is below its bound once. `alerts PORT` begins to receive the alerts of a contestant; `delays` is answered with
    the time from each such sample to its alert, in s.
    """
    latest: dict[tuple[str, str], web.WebSocketResponse] = {}
    low_s: dict[str, float] = {}
    seen_s: dict[str, float] = {}
    receiving = []

    async def accept(request: web.Request) -> web.WebSocketResponse:
        contestant = request.match_info["contestant"]
        socket = web.WebSocketResponse(protocols=_SUBPROTOCOLS.get(contestant, ()), compress=False)
        await socket.prepare(request)
        if contestant == "foxglove":
            await socket.send_json({"op": "advertise", "channels": _CHANNELS})
        await socket.receive()  # the first subscription
        latest[contestant, request.match_info["robot"]] = socket
        async for _ in socket:
            pass
        return socket

    async def send(seconds: float) -> int:
        while len(latest) < int(count):
            await asyncio.sleep(0.05)
        sockets, first_low = list(latest.items()), len(low_s)
        at_once, per_second = len(sockets) * SIGNALS, len(sockets) * SIGNALS * int(rate_hz)

        async def send_some(tick: int) -> None:
            for sent in range(per_second * tick // TICKS_HZ, per_second * (tick + 1) // TICKS_HZ):
                signal, number = divmod(sent % at_once, len(sockets))
                (contestant, robot), socket = sockets[number]
                is_low = signal == 0 and robot == f"robot{first_low + sent // at_once}"
                if is_low:
                    low_s.setdefault(robot, time.monotonic())
                await _send(socket, contestant, signal, 5.0 if is_low else 60.0 + sent % 7)

        ticks = await _paced(send_some, TICKS_HZ, seconds)
        return per_second * ticks // TICKS_HZ // len({contestant for contestant, _ in latest})

    async def reply(asked: str, port: str = "") -> object:
        if port:
            receiving.append(asyncio.ensure_future(_receive_alerts(port, seen_s)))
        if asked in ("alerts", "delays"):
            return json.dumps([seen_s.get(robot, math.inf) - sent_s for robot, sent_s in low_s.items()])
        return await send(float(asked))

    logging.getLogger("aiohttp.websocket").setLevel(logging.ERROR)  # no line about each client that can also do CBOR
    await _answer(await listen(accept, "/{contestant}/{robot}"), reply)


async def _bare(url: str, robots: str) -> None:
    async def read(session: aiohttp.ClientSession, number: int) -> None:
        async with session.ws_connect(f"{url}/robot{number}") as socket:
            await socket.send_str("{}")
            async for message in socket:
                json.loads(message.data)

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        await asyncio.gather(*(read(session, number) for number in range(int(robots))))


if __name__ == "__main__":
    roles = (_server, _floor, _clients, _robots, _bare)
    asyncio.run({role.__name__[1:]: role for role in roles}[sys.argv[1]](*sys.argv[2:]))
