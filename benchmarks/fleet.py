"""CPU and memory of `robot-health connect` with robots of ten signals at 1 Hz, beside a bare aiohttp client.

With 200 robots; with 1,000 robots, a history, an open page and a receiver of alerts; and with 100 robots over each of
the bridges. All receive the same messages at the same time from one process, over one connection per robot. The bare
client only parses the JSON of a rosbridge server. What is compared is the CPU time of the whole process. The others:

    python3 -m benchmarks.fleet robots              the servers of all robots, in one process
    python3 -m benchmarks.fleet bare URL ROBOTS     receives and parses, with aiohttp and json
    python3 -m benchmarks.fleet alerts URL          receives alerts

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
import math
import os
import statistics
import struct
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Set, Tuple, Union

import aiohttp
import cbor2
from aiohttp import web

from benchmarks.processes import Process, free_port, peer, requests
from benchmarks.table import ROOT, Row, median_ratio, within

ROBOTS, OVER_BRIDGE, MANY = 200, 100, 1000
SIGNALS = 10
SLICE_S = 10.0
SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
BARE, CONNECT = "bare aiohttp client", "robot-health connect"
CBOR, FOXGLOVE = "connect, rosbridge in CBOR", "connect, foxglove"
ADDRESSES = {CONNECT: ("ws", "connect"), CBOR: ("ws", "cbor"), FOXGLOVE: ("foxglove", "foxglove")}
"""Of each contestant: the scheme, and the path at which the robots speak to it."""
MALLOC = {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "131072"}
"""glibc's first limits, fixed: asyncio receives each message into a new buffer of 256 KiB, for which glibc maps memory
or not, depending on what the process has freed before (mallopt(3)). `connect` reads less at once."""


class _Figures(NamedTuple):
    cpu_us: Dict[str, List[float]]
    """Of each contestant: CPU time per message in each slice."""
    cores: Dict[str, float]
    """CPU time per second."""
    memory_mb: Dict[str, float]


def rows(rounds: int = 3) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    what = f"{ROBOTS} robots of {SIGNALS} signals at 1 Hz"
    with _running(ROBOTS, [BARE, CONNECT]) as (robots, processes):
        figures = _measure(robots, processes, rounds)
    yield from _cpu(what, figures, BARE, CONNECT, 1.4)
    for name, memory_mb in figures.memory_mb.items():
        yield Row(f"{what}, memory", name, f"{memory_mb:.0f} MB")
    with _running(OVER_BRIDGE, [CBOR, FOXGLOVE]) as (robots, processes):
        figures = _measure(robots, processes, rounds)
    yield from _cpu(f"{OVER_BRIDGE} robots of {SIGNALS} signals at 1 Hz, by bridge", figures, CBOR, FOXGLOVE, 1.0)
    yield from _many(rounds)


def _many(rounds: int) -> Iterator[Row]:
    what, port = f"{MANY} robots of {SIGNALS} signals at 1 Hz, page, history", free_port()
    with _running(MANY, [BARE, CONNECT], port) as (robots, processes), contextlib.ExitStack() as clients:
        clients.enter_context(peer("web", "pages", port, 1)).reply()
        alerts = clients.enter_context(peer("fleet", "alerts", f"http://127.0.0.1:{port}/"))
        alerts.reply()
        before = json.loads(robots.ask("low"))
        figures = _measure(robots, processes, rounds)
        time.sleep(1.0)
        low_s, seen_s = json.loads(robots.ask("low")), json.loads(alerts.ask("seen"))
    yield from _cpu(what, figures, BARE, CONNECT, 1.4)
    yield within(what, CONNECT, figures.cores[CONNECT], 1.0, "cores", digits=2)
    yield within(what, CONNECT, figures.memory_mb[CONNECT], 200.0, "MB")
    delays_ms = [(seen_s.get(robot, math.inf) - sent_s) * 1e3 for robot, sent_s in low_s.items() if robot not in before]
    remark = f"sample to receiver, slowest of {len(delays_ms)} alerts"
    yield within(what, CONNECT, max(delays_ms), 1000.0, "ms", remark)


def _cpu(what: str, figures: _Figures, other: str, own: str, at_most: float) -> Iterator[Row]:
    yield Row(what, other, f"{statistics.median(figures.cpu_us[other]):.1f} us")
    ratio = median_ratio(figures.cpu_us[own], figures.cpu_us[other])
    figure = f"{statistics.median(figures.cpu_us[own]):.1f} us"
    yield Row(what, own, figure, ratio, at_most, f"CPU per message, to {other}")


def _measure(robots: Process, processes: Dict[str, Process], rounds: int) -> _Figures:
    cpu_us: Dict[str, List[float]] = {name: [] for name in processes}
    cpu_s = dict.fromkeys(processes, 0.0)
    began_s = time.monotonic()
    for _ in range(rounds):
        begin_s = {name: process.cpu_s() for name, process in processes.items()}
        sent = int(robots.ask(f"{SLICE_S} {SIGNALS}"))
        time.sleep(SETTLE_S)
        for name, process in processes.items():
            used_s = process.cpu_s() - begin_s[name]
            cpu_us[name].append(used_s / sent * 1e6)
            cpu_s[name] += used_s
    lasted_s = time.monotonic() - began_s - rounds * SETTLE_S
    cores = {name: used_s / lasted_s for name, used_s in cpu_s.items()}
    return _Figures(cpu_us, cores, {name: process.own_mb() for name, process in processes.items()})


@contextlib.contextmanager
def _running(
    count: int, contestants: Sequence[str], port: Optional[int] = None
) -> Iterator[Tuple[Process, Dict[str, Process]]]:
    """Starts robots and contestants, and lets them warm up; with a port, `connect` serves there and keeps a history."""
    signal = {"type": "std_msgs/Float32", "warn_below": 20.0, "startup_grace_s": 1000.0, "stale_after_s": 1000.0}
    signals = {f"signal_{number}": signal for number in range(SIGNALS)}
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        robots = stack.enter_context(peer("fleet", "robots"))
        server = f"127.0.0.1:{robots.reply()}"
        trees = {"thresholds": {"alert_system": {"ros__parameters": {"signals": signals}}}}
        trees["ops"] = {"history": {"file": str(folder / "history.db")}}
        for name, (scheme, path) in ADDRESSES.items():
            addresses = {f"robot{each}": {"url": f"{scheme}://{server}/{path}/robot{each}"} for each in range(count)}
            trees[name] = {"defaults": {"thresholds": "thresholds.yaml"}, "robots": addresses}
        for name, tree in trees.items():
            (folder / f"{name}.yaml").write_text(json.dumps(tree))  # JSON is YAML
        processes: Dict[str, Process] = {}
        variables = {**os.environ, "PYTHONPATH": str(ROOT)}
        for name in contestants:
            command = ["robot_health_monitor", "connect", "--fleet", folder / f"{name}.yaml"]
            if name == BARE:
                command = ["benchmarks.fleet", "bare", f"http://{server}/bare", count]
            elif port is not None:
                command += ["--port", port, "--ops", folder / "ops.yaml"]
            own = {**variables, **MALLOC} if name == BARE else variables
            processes[name] = stack.enter_context(Process([sys.executable, "-m", *command], own))
        robots.ask(len(processes) * count)
        robots.ask(f"{SLICE_S} {SIGNALS}")
        yield robots, processes


_SUBPROTOCOLS = {"cbor": ("rosbridge.v2.cbor",), "foxglove": ("foxglove.sdk.v1",)}
_FLOAT32 = {
    "encoding": "cdr", "schemaName": "std_msgs/msg/Float32", "schemaEncoding": "ros2msg", "schema": "float32 data",
}  # fmt: skip
_CHANNELS = [{"id": number, "topic": f"/signal_{number}", **_FLOAT32} for number in range(SIGNALS)]


def _encoded(contestant: str, signal: int, value: float) -> Union[str, bytes]:
    """Returns a message as a contestant gets it."""
    if contestant == "foxglove":  # channels are subscribed to in their order; 256: the header of CDR, little endian
        return struct.pack("<BIQIf", 1, signal, 0, 256, value)
    message = {"op": "publish", "topic": f"/signal_{signal}", "msg": {"data": value}}
    return cbor2.dumps(message) if contestant == "cbor" else json.dumps(message)


async def _robots() -> None:
    """Sends the same messages on every connection."""
    latest: Dict[Tuple[str, str], web.WebSocketResponse] = {}
    contestants: Set[str] = set()
    low_s: Dict[str, float] = {}

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
                message = _encoded(contestant, signal, value)
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
    while words := (await lines.readline()).split():
        if words == [b"low"]:
            print(json.dumps(low_s), flush=True)
        elif len(words) == 1:
            while len(latest) < int(words[0]):
                await asyncio.sleep(0.05)
            print("ready", flush=True)
        else:
            print(await send(float(words[0]), int(words[1])) // len(contestants), flush=True)


async def _bare(url: str, robots: str) -> None:
    """Receives and parses what the robots send, with one task per connection."""

    async def read(session: aiohttp.ClientSession, number: int) -> None:
        async with session.ws_connect(f"{url}/robot{number}") as socket:
            await socket.send_str("{}")
            async for message in socket:
                json.loads(message.data)

    async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
        await asyncio.gather(*(read(session, number) for number in range(int(robots))))


async def _alerts(url: str) -> None:
    """Notes when the first alert of each robot comes."""
    seen_s: Dict[str, float] = {}

    async def answer() -> None:
        lines = await requests()
        while await lines.readline():
            print(json.dumps(seen_s), flush=True)

    async with aiohttp.ClientSession() as session, session.ws_connect(url) as socket:
        await socket.send_json({"op": "subscribe", "topic": "/alerts"})
        print("ready", flush=True)
        answering = asyncio.ensure_future(answer())
        async for message in socket:
            seen_s.setdefault(json.loads(message.data)["msg"]["hardware_id"], time.monotonic())
        await answering


if __name__ == "__main__":
    asyncio.run({"robots": _robots, "bare": _bare, "alerts": _alerts}[sys.argv[1]](*sys.argv[2:]))
