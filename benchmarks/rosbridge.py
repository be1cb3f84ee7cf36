"""CPU per delivered message and loss of the rosbridge server, compared with a bare aiohttp broadcast.

Both servers live all the time, each with separate clients that only count, and send in turn, a slice each, round
after round. What is compared is the CPU time of the whole server process within a slice, pacing included, divided by
the messages that were to be delivered. The processes:

    python3 -m benchmarks.rosbridge server     this project's server in front of a local bus
    python3 -m benchmarks.rosbridge floor      the bare library: one encoded text to every client
    python3 -m benchmarks.rosbridge clients PORT COUNT

A server writes its port, then takes lines `RATE_HZ SECONDS` and answers each with how many messages it has sent.
Clients write `ready`, then answer each line with how many messages the one with the fewest has got until then.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import os
import socket
import statistics
import sys
import time
from typing import Any, Awaitable, Callable, Dict, Iterator, List

from aiohttp import web

from benchmarks.processes import peer, requests
from benchmarks.table import Row, in_turn, median_ratio
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.rosbridge.protocol import DEFAULT_LIMITS
from robot_health_monitor.rosbridge.server import Server

SLICE_S = 2.0
SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
AT_MOST_FOR = (10, 1000.0)


def rows(rounds: int = 3) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    for clients in (1, 10, 50):
        for rate_hz in (100.0, 1000.0):
            yield from _broadcast(clients, rate_hz, rounds)


def _broadcast(clients: int, rate_hz: float, rounds: int) -> Iterator[Row]:
    lost: Dict[str, float] = {"floor": 0.0, "server": 0.0}
    contestants: Dict[str, Callable[[], float]] = {}
    with contextlib.ExitStack() as running:
        for name in lost:
            server = running.enter_context(peer("rosbridge", name))
            readers = running.enter_context(peer("rosbridge", "clients", server.reply(), clients))
            readers.reply()

            def measure(name: str = name, server: Any = server, readers: Any = readers) -> float:
                before, begin_s = int(readers.ask("count")), server.cpu_s()
                sent = int(server.ask(f"{rate_hz} {SLICE_S}"))
                cpu_s = server.cpu_s() - begin_s
                time.sleep(SETTLE_S)
                lost[name] = max(lost[name], 1.0 - (int(readers.ask("count")) - before) / sent)
                return cpu_s / sent / clients * 1e6

            contestants[name] = measure
        cost_us = in_turn(contestants, rounds)
    what = f"rosbridge, {clients} client{'s' * (clients > 1)} at {rate_hz:g} Hz"
    of_floor, of_server = (
        f"{statistics.median(values):.1f} us, {lost[name] * 100.0:.3g} % lost" for name, values in cost_us.items()
    )
    ratio = median_ratio(cost_us["server"], cost_us["floor"])
    required = 2.0 if (clients, rate_hz) == AT_MOST_FOR else None
    yield Row(what, "bare aiohttp", of_floor)
    yield Row(what, "rosbridge server", of_server, ratio, required, "per delivered message, to bare aiohttp")


async def _serve(port: int, send: Callable[[int], Awaitable[None]]) -> None:
    """Processes requests until stdin ends: `send(number)` at an even pace."""
    print(port, flush=True)
    lines = await requests()
    while words := (await lines.readline()).split():
        rate_hz, count = float(words[0]), int(float(words[0]) * float(words[1]))
        begin_s = time.monotonic()
        for number in range(count):
            await asyncio.sleep(max(0.0, begin_s + (number + 1) / rate_hz - time.monotonic()))
            await send(number)
        print(count, flush=True)


async def _server() -> None:
    """This project's server."""
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
    """Aiohttp alone: the text is there already, and goes to every client by the library's own call."""
    sockets: List[web.WebSocketResponse] = []

    async def accept(request: web.Request) -> web.WebSocketResponse:
        websocket = web.WebSocketResponse(compress=False)
        await websocket.prepare(request)
        sockets.append(websocket)
        async for _ in websocket:
            pass
        return websocket

    application = web.Application()
    application.router.add_get("/", accept)
    runner = web.AppRunner(application)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0).start()
    text = '{"op":"publish","topic":"/battery_level","msg":{"data":1000.0}}'

    async def send(number: int) -> None:
        for websocket in sockets:
            await websocket.send_str(text)

    await _serve(runner.addresses[0][1], send)


async def _clients(port: str, count: str) -> None:
    """Clients that count messages by their beginnings, which costs less than to read them."""
    counts = [0] * int(count)

    async def read(index: int, reader: asyncio.StreamReader) -> None:
        rest = b""
        while data := await reader.read(65536):
            data = rest + data
            counts[index] += data.count(b'"op":"publish"')
            rest = data[-13:]  # one that is cut is found with the next piece

    kept: List[Any] = []  # a connection ends with the last reference to it
    subscribe = b'{"op":"subscribe","topic":"/battery_level","type":"std_msgs/Float32"}'
    for index in range(len(counts)):
        connection = socket.create_connection(("127.0.0.1", int(port)))
        request = (
            b"GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Key: %s\r\nSec-WebSocket-Version: 13\r\n\r\n" % base64.b64encode(os.urandom(16))
        )
        connection.sendall(request + bytes([0x81, 0x80 | len(subscribe)]) + bytes(4) + subscribe)
        reader, writer = await asyncio.open_connection(sock=connection)
        await reader.readuntil(b"\r\n\r\n")
        kept += [writer, asyncio.ensure_future(read(index, reader))]
    await asyncio.sleep(0.3)  # for the subscriptions to be taken
    print("ready", flush=True)
    lines = await requests()
    while await lines.readline():
        print(min(counts), flush=True)


if __name__ == "__main__":
    asyncio.run({"server": _server, "floor": _floor, "clients": _clients}[sys.argv[1]](*sys.argv[2:]))
