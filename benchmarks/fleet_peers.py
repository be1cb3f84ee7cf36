"""The processes that `fleet_cost.py` measures, and the one that sends them messages.

    python3 -m benchmarks.fleet_peers robots              the servers of all robots, in one process
    python3 -m benchmarks.fleet_peers bare URL ROBOTS     receives and parses, with aiohttp and json
    python3 -m benchmarks.fleet_peers alerts URL          receives alerts

The robots write their port and accept a connection each at `/CONTESTANT/ROBOT`. They speak rosbridge in JSON; to the
contestant `cbor` rosbridge in CBOR, to `foxglove` Foxglove's protocol with messages in CDR. For a line
`CONNECTIONS` they write `ready` once that many are subscribed. For a line `SECONDS SIGNALS` they send every signal once
a second on each connection, evenly spread, and write how many messages each contestant was sent. In each second, the
first signal of another robot is below its bound once. For a line `low` they write when that was, in s, by robot; the
receiver of alerts answers any line with when their first alerts came.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import struct
import sys
import time
from typing import Dict, Set, Tuple, Union

import aiohttp
import cbor2
from aiohttp import web

from benchmarks.peer import requests

SUBPROTOCOLS = {"cbor": ("rosbridge.v2.cbor",), "foxglove": ("foxglove.sdk.v1",)}
FLOAT32 = {
    "encoding": "cdr",
    "schemaName": "std_msgs/msg/Float32",
    "schemaEncoding": "ros2msg",
    "schema": "float32 data",
}
CHANNELS = [{"id": number, "topic": f"/signal_{number}", **FLOAT32} for number in range(10)]
CDR_HEADER = 256
"""The bytes 0, 1, 0, 0: little endian."""


def encoded(contestant: str, signal: int, value: float) -> Union[str, bytes]:
    """Returns a message as a contestant gets it."""
    if contestant == "foxglove":  # channels are subscribed to in their order
        return struct.pack("<BIQIf", 1, signal, 0, CDR_HEADER, value)
    message = {"op": "publish", "topic": f"/signal_{signal}", "msg": {"data": value}}
    return cbor2.dumps(message) if contestant == "cbor" else json.dumps(message)


async def greet(contestant: str, socket: web.WebSocketResponse) -> None:
    """Offers the channels to `foxglove`."""
    if contestant == "foxglove":
        await socket.send_json({"op": "advertise", "channels": CHANNELS})


async def serve_robots() -> None:
    """Sends the same messages on every connection."""
    latest: Dict[Tuple[str, str], web.WebSocketResponse] = {}
    contestants: Set[str] = set()
    low_s: Dict[str, float] = {}

    async def accept(request: web.Request) -> web.WebSocketResponse:
        contestant = request.match_info["contestant"]
        socket = web.WebSocketResponse(protocols=SUBPROTOCOLS.get(contestant, ()), compress=False)
        await socket.prepare(request)
        await greet(contestant, socket)
        await socket.receive()  # the first subscription
        contestants.add(contestant)
        latest[request.match_info["contestant"], request.match_info["robot"]] = socket
        async for _ in socket:
            pass
        return socket

    async def send(seconds: float, signals: int) -> int:
        """Returns how many messages it has sent."""
        sockets = list(latest.items())
        per_second = len(sockets) * signals
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
                message = encoded(contestant, signal, value)
                with contextlib.suppress(ConnectionResetError):  # it connects again
                    await (socket.send_str(message) if isinstance(message, str) else socket.send_bytes(message))
                sent += 1
        return sent

    logging.getLogger("aiohttp.websocket").setLevel(logging.ERROR)  # no line about each client that can also do CBOR
    application = web.Application()
    application.router.add_get("/{contestant}/{robot}", accept)
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0, backlog=1000).start()
    print(runner.addresses[0][1], flush=True)
    lines = await requests()
    while True:
        words = (await lines.readline()).split()
        if not words:
            return
        if words == [b"low"]:
            print(json.dumps(low_s), flush=True)
        elif len(words) == 1:
            while len(latest) < int(words[0]):
                await asyncio.sleep(0.05)
            print("ready", flush=True)
        else:
            print(await send(float(words[0]), int(words[1])) // len(contestants), flush=True)


async def receive(url: str, robots: int) -> None:
    """Receives and parses what the robots send, with one task per connection."""

    async def read(session: aiohttp.ClientSession, number: int) -> None:
        async with session.ws_connect(f"{url}/robot{number}") as socket:
            await socket.send_str("{}")
            async for message in socket:
                json.loads(message.data)

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        await asyncio.gather(*(read(session, number) for number in range(robots)))


async def receive_alerts(url: str) -> None:
    """Notes when the first alert of each robot comes."""
    seen_s: Dict[str, float] = {}

    async def read(socket: aiohttp.ClientWebSocketResponse) -> None:
        async for message in socket:
            seen_s.setdefault(json.loads(message.data)["msg"]["hardware_id"], time.monotonic())

    async with aiohttp.ClientSession() as session, session.ws_connect(url) as socket:
        await socket.send_str(json.dumps({"op": "subscribe", "topic": "/alerts"}))
        reading = asyncio.ensure_future(read(socket))
        print("ready", flush=True)
        lines = await requests()
        while await lines.readline():
            print(json.dumps(seen_s), flush=True)
        reading.cancel()


if __name__ == "__main__":
    role, *rest = sys.argv[1:]
    if role == "robots":
        asyncio.run(serve_robots())
    elif role == "bare":
        asyncio.run(receive(rest[0], int(rest[1])))
    else:
        asyncio.run(receive_alerts(rest[0]))
