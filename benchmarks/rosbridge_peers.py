"""The processes that `rosbridge_cost.py` measures: servers and their clients.

    python3 -m benchmarks.rosbridge_peers server     this project's server in front of a local bus
    python3 -m benchmarks.rosbridge_peers floor      the bare library: one encoded text to every client
    python3 -m benchmarks.rosbridge_peers clients PORT COUNT [stalled]

A server writes its port, then takes lines `RATE_HZ SECONDS PAYLOAD_CHARS` and answers each with `SENT CPU_S RSS_KB`.
Clients write `ready`, then answer each line with how many messages the one with the fewest has got until then.
"""

from __future__ import annotations

import asyncio
import base64
import os
import socket
import sys
import time
from typing import Any, Awaitable, Callable, List

import psutil
from aiohttp import web

from benchmarks.peer import requests
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.rosbridge.server.server import Server

TOPIC = "/battery_level"
FLOAT, TEXT = "std_msgs/Float32", "std_msgs/String"


async def serve(port: int, send: Callable[[int, int], Awaitable[None]]) -> None:
    """Processes requests until stdin ends: `send(number, payload_chars)` at an even pace."""
    print(port, flush=True)
    lines = await requests()
    while True:
        words = (await lines.readline()).split()
        if not words:
            return
        rate_hz, seconds, payload = float(words[0]), float(words[1]), int(words[2])
        count = int(rate_hz * seconds)
        begin_cpu_s, begin_s = time.process_time(), time.monotonic()
        for number in range(count):
            await asyncio.sleep(max(0.0, begin_s + (number + 1) / rate_hz - time.monotonic()))
            await send(number, payload)
        cpu_s = time.process_time() - begin_cpu_s
        print(count, cpu_s, psutil.Process().memory_info().rss // 1024, flush=True)


async def server() -> None:
    """This project's server."""
    bus = LocalBus()
    robot = bus.node("robot")
    robot.advertise(TOPIC, FLOAT)
    robot.advertise("/text", TEXT)
    served = Server(bus.node("rosbridge"), port=0, threads=False, heartbeat_s=3600.0, slow_client_timeout_s=3600.0)
    await served.start()

    async def send(number: int, payload: int) -> None:
        if payload:
            robot.publish("/text", {"data": "x" * payload})
        else:
            robot.publish(TOPIC, {"data": float(number)})

    await serve(served.port, send)
    await served.close()


async def floor() -> None:
    """Aiohttp alone: the text is there already, and goes to every client by the library's own call."""
    sockets: List[web.WebSocketResponse] = []

    async def accept(request: web.Request) -> web.WebSocketResponse:
        websocket = web.WebSocketResponse(compress=False)
        await websocket.prepare(request)
        sockets.append(websocket)
        async for _ in websocket:
            pass
        sockets.remove(websocket)
        return websocket

    application = web.Application()
    application.router.add_get("/", accept)
    runner = web.AppRunner(application)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    text = '{"op":"publish","topic":"/battery_level","msg":{"data":1000.0}}'

    async def send(number: int, payload: int) -> None:
        for websocket in sockets:
            await websocket.send_str(text)

    await serve(runner.addresses[0][1], send)
    await runner.cleanup()


async def clients(port: int, count: int, stalled: bool) -> None:
    """Clients that count messages by their beginnings, which costs less than to read them."""
    counts = [0] * count

    async def read(index: int, reader: asyncio.StreamReader) -> None:
        rest = b""
        while True:
            data = await reader.read(65536)
            if not data:
                return
            data = rest + data
            counts[index] += data.count(b'"op":"publish"')
            rest = data[-13:]  # one that is cut is found with the next piece

    kept: List[Any] = []  # a connection ends with the last reference to it
    for index in range(count):
        connection = socket.create_connection(("127.0.0.1", port))
        key = base64.b64encode(os.urandom(16)).decode()
        request = (
            f"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n"
        )
        subscribe = b'{"op":"subscribe","topic":"/text","type":"std_msgs/String"}'
        if not stalled:
            subscribe = b'{"op":"subscribe","topic":"/battery_level","type":"std_msgs/Float32"}'
        connection.sendall(request.encode() + bytes([0x81, 0x80 | len(subscribe)]) + bytes(4) + subscribe)
        reader, writer = await asyncio.open_connection(sock=connection)
        kept.append(writer)
        await reader.readuntil(b"\r\n\r\n")
        if not stalled:
            kept.append(asyncio.ensure_future(read(index, reader)))
    await asyncio.sleep(0.3)  # for the subscriptions to be taken
    print("ready", flush=True)
    lines = await requests()
    while await lines.readline():
        print(min(counts), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "clients":
        asyncio.run(clients(int(sys.argv[2]), int(sys.argv[3]), "stalled" in sys.argv))
    else:
        asyncio.run({"server": server, "floor": floor}[sys.argv[1]]())
