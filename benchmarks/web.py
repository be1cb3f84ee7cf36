"""CPU of open pages, and the time of a scrape.

One server lives all the time. Pages and subscribers are connected in turn, a slice each, round after round. What is
compared is the CPU time of the whole server process within a slice, less that of a slice without clients. The others:

    python3 -m benchmarks.web monitor ROBOTS SIGNALS RATE_HZ [bare]   robots that are judged and served
    python3 -m benchmarks.web pages PORT COUNT                       pages that show a robot with its plots
    python3 -m benchmarks.web subscribers PORT COUNT                 rosbridge clients of /diagnostics

A monitor writes its port; `bare` is without page and API. Clients write `ready` once each of
them has got something.
"""

from __future__ import annotations

import asyncio
import contextlib
import statistics
import sys
import time
import urllib.request
from typing import Callable, Dict, Iterator

from aiohttp import ClientSession, ClientTimeout

from benchmarks.processes import Process, peer
from benchmarks.table import Row, in_turn, median_ratio, within
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.web import WebInterface
from robot_health_monitor.rosbridge.server import Server

CLIENTS, SIGNALS, RATE_HZ = 10, 10, 10.0
SLICE_S = 5.0
FLEET, SCRAPES = 200, 15


def rows(rounds: int = 3) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    yield from _pages(rounds)
    yield _scrape()


def _pages(rounds: int) -> Iterator[Row]:
    with contextlib.ExitStack() as running:
        bare, server = (
            running.enter_context(peer("web", "monitor", 1, SIGNALS, RATE_HZ, *kind)) for kind in (["bare"], [])
        )
        bare.reply()
        port = server.reply()

        def with_clients(kind: str) -> Callable[[], float]:
            def measure() -> float:
                with peer("web", kind, port, CLIENTS) as clients:
                    clients.reply()
                    used_ms = _used_ms(server)
                time.sleep(0.5)  # the clients have gone
                return used_ms

            return measure

        contestants: Dict[str, Callable[[], float]] = {
            "bare": lambda: _used_ms(bare),
            "none": lambda: _used_ms(server),
            "pages": with_clients("pages"),
            "subscribers": with_clients("subscribers"),
        }
        cpu_ms = in_turn(contestants, rounds)
    median = {name: statistics.median(values) for name, values in cpu_ms.items()}
    pages_ms, subscribers_ms = median["pages"] - median["none"], median["subscribers"] - median["none"]
    what = f"web, {CLIENTS} clients of a robot with {SIGNALS} signals at {RATE_HZ:g} Hz"
    yield Row(what, "rosbridge, /diagnostics", f"{subscribers_ms:.2f} ms/s")
    remark = "CPU of the server, to rosbridge"
    yield Row(what, "pages with plots", f"{pages_ms:.2f} ms/s", pages_ms / subscribers_ms, 1.0, remark)
    yield Row("web, no page open", "server without page and API", f"{median['bare']:.2f} ms/s")
    ratio, remark = median_ratio(cpu_ms["none"], cpu_ms["bare"]), "CPU of the monitor, to the one without"
    yield Row("web, no page open", "server", f"{median['none']:.2f} ms/s", ratio, remark=remark)


def _used_ms(server: Process) -> float:
    """Returns the CPU time of a slice, in ms per s."""
    begin_s = server.cpu_s()
    time.sleep(SLICE_S)
    return (server.cpu_s() - begin_s) / SLICE_S * 1e3


def _scrape() -> Row:
    times_ms, size = [], 0
    with peer("web", "monitor", FLEET, SIGNALS, 1.0) as server:
        url = f"http://127.0.0.1:{server.reply()}/metrics"
        for _ in range(SCRAPES + 1):
            begin_s = time.monotonic()
            with urllib.request.urlopen(url, timeout=30.0) as answer:
                size = len(answer.read())
            times_ms.append((time.monotonic() - begin_s) * 1e3)
            time.sleep(0.2)
    what = f"web, /metrics of {FLEET} robots with {SIGNALS} signals at 1 Hz"
    # The fastest is what it takes when the machine does nothing else.
    return within(what, "server", min(times_ms[1:]), 100.0, "ms", f"{size / 1e6:.1f} MB, fastest of {SCRAPES}")


async def _monitor(count: str, signals: str, rate_hz: str, kind: str = "") -> None:
    """Judges and serves robots in real time."""
    bus = LocalBus(time.monotonic(), on_log=lambda line: None, wall_time_s=time.time, clock=time.monotonic)
    signal = {"unit": "%", "warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0}
    settings = {f"signal_{number}": signal for number in range(int(signals))}
    robots = []
    for name in (f"robot{number}" for number in range(int(count))):
        node = bus.node("alert_system", namespace=name, parameters={"robot_name": name, "signals": settings})
        robots.append(AlertSystem(node, log_alerts=False))
    outside = bus.node("outside")
    topics = [f"/robot{robot}/{signal}" for robot in range(len(robots)) for signal in settings]
    for topic in topics:
        outside.advertise(topic, "std_msgs/Float32")
    history = History(None)
    web = WebInterface(lambda: robots, history, Silences(history))
    for robot in robots:
        web.watch(robot)
    routes = (lambda client_of: ()) if kind == "bare" else web.routes
    server = Server(bus.node("rosbridge"), port=0, threads=False, routes=routes, on_close=(web.close,))
    await server.start()
    print(server.port, flush=True)
    next_s, number = time.monotonic(), 0
    while True:
        for topic in topics:
            outside.publish(topic, {"data": 50.0 + number % 17})
            number += 1
        next_s += 1.0 / float(rate_hz)
        while True:
            bus.run_due(time.monotonic())
            due_s = bus.next_due_s()
            assert due_s is not None
            await asyncio.sleep(max(0.0, min(due_s, next_s) - time.monotonic()))
            if time.monotonic() >= next_s:
                break


async def _clients(kind: str, port: str, count: str) -> None:
    """Pages or subscribers that read what they get."""

    async def read_page(session: ClientSession, started: asyncio.Event) -> None:
        async with session.get(f"http://127.0.0.1:{port}/api/events?robot=robot0") as response:
            async for _ in response.content.iter_any():
                started.set()

    async def read_topic(session: ClientSession, started: asyncio.Event) -> None:
        async with session.ws_connect(f"http://127.0.0.1:{port}/") as socket:
            await socket.send_json({"op": "subscribe", "topic": "/diagnostics"})
            async for _ in socket:
                started.set()

    async with ClientSession(timeout=ClientTimeout(total=None)) as session:
        read = read_page if kind == "pages" else read_topic
        events = [asyncio.Event() for _ in range(int(count))]
        tasks = [asyncio.ensure_future(read(session, event)) for event in events]
        await asyncio.gather(*(event.wait() for event in events))
        print("ready", flush=True)
        await asyncio.gather(*tasks)


if __name__ == "__main__":
    role, *rest = sys.argv[1:]
    asyncio.run(_monitor(*rest) if role == "monitor" else _clients(role, *rest))
