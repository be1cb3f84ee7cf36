"""The processes that `web_cost.py` measures: servers and their clients.

    python3 -m benchmarks.web_peers monitor ROBOTS SIGNALS RATE_HZ [bare|FILE]   robots that are judged and served
    python3 -m benchmarks.web_peers pages PORT COUNT                            pages that show a robot with its plots
    python3 -m benchmarks.web_peers subscribers PORT COUNT                      rosbridge clients of /diagnostics

A monitor writes its port, then takes lines `SECONDS` and answers each with its CPU time of these seconds; `bare` is
without page and API, a FILE is the history. Clients write `ready`, then answer each line with the bytes that they have
got until then.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any, List, Optional

from aiohttp import ClientSession, ClientTimeout

from benchmarks.peer import requests
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.web import WebInterface
from robot_health_monitor.rosbridge.server.server import Server

TOPIC_TYPE = "std_msgs/Float32"


def create_robots(bus: LocalBus, count: int, signals: int, history: Optional[History] = None) -> List[AlertSystem]:
    """Returns alert_systems with so many signals each, on topics in the namespace of their robot."""
    settings = {
        f"signal_{number}": {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0}
        for number in range(signals)
    }
    robots = []
    for number in range(count):
        parameters = {"robot_name": f"robot{number}", "signals": settings}
        node = bus.node("alert_system", namespace=f"robot{number}", parameters=parameters)
        past = None if history is None else history.of_robot(f"robot{number}")
        robots.append(AlertSystem(node, log_alerts=False, history=past))
    return robots


async def monitor(count: int, signals: int, rate_hz: float, kind: str) -> None:
    """Judges and serves robots in real time."""
    bus = LocalBus(time.monotonic(), on_log=lambda line: None, wall_time_s=time.time, clock=time.monotonic)
    history = None if kind in ("", "bare") else History(HistorySettings(kind, keep_mb=1e4))
    robots = create_robots(bus, count, signals, history)
    outside = bus.node("outside")
    topics = [f"/robot{robot}/signal_{signal}" for robot in range(count) for signal in range(signals)]
    for topic in topics:
        outside.advertise(topic, TOPIC_TYPE)
    web = WebInterface(lambda: robots, history=history)
    for robot in robots:
        web.watch(robot)
    routes = (lambda client_of: ()) if kind == "bare" else web.routes
    server = Server(bus.node("rosbridge"), port=0, threads=False, routes=routes, on_close=(web.close,))
    await server.start()

    async def publish() -> None:
        number = 0
        next_s = time.monotonic()
        while True:
            for topic in topics:
                outside.publish(topic, {"data": 50.0 + number % 17})
                number += 1
            next_s += 1.0 / rate_hz
            await asyncio.sleep(max(0.0, next_s - time.monotonic()))

    async def run_timers() -> None:
        while True:
            bus.run_due(time.monotonic())
            due_s = bus.next_due_s()
            assert due_s is not None
            await asyncio.sleep(max(0.0, due_s - time.monotonic()))

    tasks = [asyncio.ensure_future(publish()), asyncio.ensure_future(run_timers())]
    print(server.port, flush=True)
    lines = await requests()
    while True:
        seconds = await lines.readline()
        if not seconds:
            break
        begin_cpu_s = time.process_time()
        await asyncio.sleep(float(seconds))
        print(time.process_time() - begin_cpu_s, flush=True)
    for task in tasks:
        task.cancel()
    await server.close()
    if history is not None:
        history.close()


async def clients(kind: str, port: int, count: int) -> None:
    """Pages or subscribers that count what they get."""
    got = [0] * count

    async def read_page(number: int, session: ClientSession, started: asyncio.Event) -> None:
        async with session.get(f"http://127.0.0.1:{port}/api/events?robot=robot0") as response:
            async for chunk in response.content.iter_any():
                got[number] += len(chunk)
                started.set()

    async def read_topic(number: int, session: ClientSession, started: asyncio.Event) -> None:
        async with session.ws_connect(f"http://127.0.0.1:{port}/") as socket:
            await socket.send_str(json.dumps({"op": "subscribe", "topic": "/diagnostics"}))
            async for message in socket:
                got[number] += len(message.data)
                started.set()

    async with ClientSession(timeout=ClientTimeout(total=None)) as session:
        read: Any = read_page if kind == "pages" else read_topic
        events = [asyncio.Event() for _ in range(count)]
        tasks = [asyncio.ensure_future(read(number, session, event)) for number, event in enumerate(events)]
        await asyncio.gather(*(event.wait() for event in events))
        print("ready", flush=True)
        lines = await requests()
        while await lines.readline():
            print(min(got), flush=True)
        for task in tasks:
            task.cancel()


if __name__ == "__main__":
    role, *arguments = sys.argv[1:]
    if role == "monitor":
        robots, signals, rate_hz, *rest = arguments
        asyncio.run(monitor(int(robots), int(signals), float(rate_hz), "".join(rest)))
    else:
        asyncio.run(clients(role, int(arguments[0]), int(arguments[1])))
