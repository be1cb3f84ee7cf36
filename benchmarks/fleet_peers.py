"""The processes that `fleet_cost.py` measures, and the one that feeds them.

    python3 -m benchmarks.fleet_peers feeder              the rosbridge servers of all robots, in one process
    python3 -m benchmarks.fleet_peers bare PORT ROBOTS    receives and parses, with aiohttp and json

The feeder accepts a connection per robot at `/CONTESTANT/ROBOT`. For a line `CONNECTIONS` it prints `ready` once that
many are subscribed; for a line `SECONDS SIGNALS`, it sends each of them every signal once a second, evenly spread, and
prints how many messages each contestant was sent.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Dict, List

import aiohttp
from aiohttp import web

from benchmarks.rosbridge_peers import lines


async def feed() -> None:
    """Feeds every connection with the same messages."""
    sockets: List[web.WebSocketResponse] = []
    contestants: Dict[str, int] = {}

    async def accept(request: web.Request) -> web.WebSocketResponse:
        socket = web.WebSocketResponse(compress=False)
        await socket.prepare(request)
        name = request.match_info["contestant"]
        contestants[name] = contestants.get(name, 0) + 1
        subscribed = False
        async for _ in socket:
            if not subscribed:
                subscribed = True
                sockets.append(socket)
        return socket

    application = web.Application()
    application.router.add_get("/{contestant}/{robot}", accept)
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    await web.TCPSite(runner, "127.0.0.1", 0, backlog=1000).start()
    print(runner.addresses[0][1], flush=True)
    orders = await lines()
    while True:
        order = (await orders.readline()).split()
        if not order:
            return
        if len(order) == 1:
            while len(sockets) < int(order[0]):
                await asyncio.sleep(0.05)
            print("ready", flush=True)
            continue
        seconds, signals = float(order[0]), int(order[1])
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
        print(sent // len(contestants), flush=True)


async def receive(port: int, robots: int) -> None:
    """Receives and parses what the feeder sends, with one task per connection."""

    async def read(session: aiohttp.ClientSession, number: int) -> None:
        async with session.ws_connect(f"http://127.0.0.1:{port}/bare/robot{number}") as socket:
            await socket.send_str("{}")
            async for message in socket:
                json.loads(message.data)

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        await asyncio.gather(*(read(session, number) for number in range(robots)))


if __name__ == "__main__":
    asyncio.run(feed() if sys.argv[1] == "feeder" else receive(int(sys.argv[2]), int(sys.argv[3])))
