"""The processes that `fleet_cost.py` measures, and the one that sends them messages.

    python3 -m benchmarks.fleet_peers robots              the rosbridge servers of all robots, in one process
    python3 -m benchmarks.fleet_peers bare URL ROBOTS     receives and parses, with aiohttp and json

The robots write their port and accept a connection each at `/CONTESTANT/ROBOT`. For a line `CONNECTIONS` they write
`ready` once that many are subscribed. For a line `SECONDS SIGNALS` they send every signal once a second on each
connection, evenly spread, and write how many messages each contestant was sent.
"""

from __future__ import annotations

import asyncio
import json
import logging
import sys
import time
from typing import List, Set

import aiohttp
from aiohttp import web

from benchmarks.peer import requests


async def serve_robots() -> None:
    """Sends the same messages on every connection."""
    sockets: List[web.WebSocketResponse] = []
    contestants: Set[str] = set()

    async def accept(request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse(compress=False)
        await socket.prepare(request)
        await socket.receive()  # the first subscription
        contestants.add(request.match_info["contestant"])
        sockets.append(socket)
        async for _ in socket:
            pass
        return socket

    async def send(seconds: float, signals: int) -> int:
        """Returns how many messages it has sent."""
        per_second = len(sockets) * signals
        sent, begin_s = 0, time.monotonic()
        while sent < per_second * seconds:
            await asyncio.sleep(0.002)
            while sent < min((time.monotonic() - begin_s) * per_second, per_second * seconds):
                signal, robot = divmod(sent % per_second, len(sockets))
                value = 60.0 + sent % 7
                text = json.dumps({"op": "publish", "topic": f"/signal_{signal}", "msg": {"data": value}})
                await sockets[robot].send_str(text)
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
        if len(words) == 1:
            while len(sockets) < int(words[0]):
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


if __name__ == "__main__":
    asyncio.run(serve_robots() if sys.argv[1] == "robots" else receive(sys.argv[2], int(sys.argv[3])))
