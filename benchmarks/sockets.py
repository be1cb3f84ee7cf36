"""CPU and memory of what has WebSockets: the rosbridge server, `robot-health connect`, its pages; time of a scrape.

With `connect`, all contestants receive the same messages at the same time from one process, over one connection per
robot. The bare client only parses the JSON of a rosbridge server. Pages, subscribers and servers have turns, a slice
each, round after round. What is compared is the CPU time of the whole process; for pages, less that without clients.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import statistics
import sys
import tempfile
import time
import urllib.request
from functools import partial
from pathlib import Path
from typing import Iterator, Mapping

from harness.reserved import free_port

from benchmarks.peers import SIGNALS
from benchmarks.processes import Process, alert_system, cpu_s, peer, write_yaml
from benchmarks.table import Row, beside, figure, side_by_side, within

ROBOTS, OVER_BRIDGE, MANY = 200, 100, 1000
SLICE_S = 10
PAGES, RATE_HZ, SCRAPES = 10, 10, 15
BARE, CONNECT = "bare aiohttp client", "robot-health connect"
CBOR, FOXGLOVE = "connect, rosbridge in CBOR", "connect, foxglove"
ALONE, SERVER = "connect without a server", "server"
CLIENTS = {"rosbridge, /diagnostics": "/diagnostics", "pages with plots": ""}
"""Of each kind: the topic to which they subscribe."""
ADDRESSES = {CBOR: ("ws", "cbor"), FOXGLOVE: ("foxglove", "foxglove")}
"""Of the contestants that do not use JSON: the scheme, and the path at which the robots speak to them."""
SERVERS = {"bare aiohttp": "floor", "rosbridge server": "server"}
BROADCAST_S, BROADCAST_LIMITS = 2.0, {(10, 1000.0): 2.0}
"""Seconds of a slice; limits by the number of clients and the rate in Hz."""
MALLOC = {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "131072"}
"""glibc's first limits, fixed: asyncio receives each message into a new buffer of 256 KiB, for which glibc maps memory
or not, depending on what the process has freed before (mallopt(3)). `connect` reads less at once."""


def rosbridge(rounds: int = 3) -> Iterator[Row]:
    """The server beside a bare broadcast; both send in turn, and each has separate clients, which only count."""
    for clients, rate_hz in itertools.product((1, 10, 50), (100.0, 1000.0)):
        yield from _broadcast(clients, rate_hz, rounds)


def _broadcast(clients: int, rate_hz: float, rounds: int) -> Iterator[Row]:
    lost = dict.fromkeys(SERVERS, 0.0)
    with contextlib.ExitStack() as running:
        servers = {name: running.enter_context(peer(role)) for name, role in SERVERS.items()}
        readers: dict[str, Process] = {}
        for name, server in servers.items():
            readers[name] = running.enter_context(peer("clients", server.reply(), clients, "/battery_level"))
            readers[name].reply()

        def measure() -> dict[str, float]:
            used_s = {}
            for name, server in servers.items():
                before = int(readers[name].ask("count"))
                used_s.update(cpu_s({name: server}, partial(server.send, f"{rate_hz} {BROADCAST_S}", clients)))
                delivered = int(readers[name].ask("count")) - before
                lost[name] = max(lost[name], 1.0 - delivered / (rate_hz * BROADCAST_S))
            return used_s

        used_s = side_by_side(measure, rounds)
    what = f"rosbridge, {clients} client{'s' * (clients > 1)} at {rate_hz:g} Hz"
    for row in beside(what, used_s, "us", BROADCAST_LIMITS.get((clients, rate_hz)), ", per delivered message"):
        yield row._replace(figure=f"{row.figure}, {lost[row.contestant] * 100.0:.3g} % lost")


def fleet(rounds: int = 3) -> Iterator[Row]:
    """With 200 robots; with 1,000, a history, an open page and a receiver of alerts; with 100 over each bridge."""
    what, remark = f"robots of {SIGNALS} signals at 1 Hz", ", CPU per message"
    with running(ROBOTS, {BARE: 0, CONNECT: 0}) as (robots, processes):
        used_s = _used_s(robots, processes, rounds)
        own_bytes = {name: process.own_bytes() for name, process in processes.items()}
    yield from beside(f"{ROBOTS} {what}", used_s, "us", 1.4, remark)
    for name, size in own_bytes.items():
        yield Row(f"{ROBOTS} {what}, memory", name, figure(size, "MB"))
    with running(OVER_BRIDGE, {CBOR: 0, FOXGLOVE: 0}) as (robots, processes):
        used_s = _used_s(robots, processes, rounds)
    yield from beside(f"{OVER_BRIDGE} {what}, by bridge", used_s, "us", 1.0, remark)

    what, port = f"{MANY} {what}, page, history", free_port()
    with running(MANY, {BARE: 0, CONNECT: port}) as (robots, processes), peer("clients", port, 1) as page:
        page.reply()
        robots.ask(f"alerts {port}")
        used_s = _used_s(robots, processes, rounds)
        connect_bytes = processes[CONNECT].own_bytes()
        delays_s = json.loads(robots.ask("delays"))[-rounds * SLICE_S :]
    yield from beside(what, used_s, "us", 1.4, remark)
    yield within(what, CONNECT, statistics.fmean(used_s[CONNECT]) * MANY * SIGNALS, 1.0, "cores")
    yield within(what, CONNECT, connect_bytes, 200.0, "MB")
    remark = f"sample to receiver, slowest of {len(delays_s)} alerts"
    yield within(what, CONNECT, max(delays_s), 1000.0, "ms", remark)


def web(rounds: int = 3) -> Iterator[Row]:
    """With one robot whose signals have 10 Hz; the scrape with 200 robots."""
    port = free_port()
    with running(1, {ALONE: 0, SERVER: port}, RATE_HZ) as (robots, processes):

        def used() -> dict[str, float]:
            per_message_s = cpu_s(processes, partial(robots.send, str(SLICE_S)))
            return {name: each * SIGNALS * RATE_HZ for name, each in per_message_s.items()}

        def measure() -> dict[str, float]:
            figures = used()
            for name, topic in CLIENTS.items():
                with peer("clients", port, PAGES, topic) as clients:
                    clients.reply()
                    robots.send("2")
                    if clients.ask("count") == "0":
                        raise RuntimeError(f"{name}: a client has received nothing")
                    figures[name] = used()[SERVER] - figures[SERVER]
                time.sleep(0.5)  # the clients have gone
            return figures

        used_s = side_by_side(measure, rounds)
    what = f"web, {PAGES} clients of a robot with {SIGNALS} signals at {RATE_HZ} Hz"
    yield from beside(what, {name: used_s[name] for name in CLIENTS}, "ms/s", 1.0, ", CPU of the server")
    yield from beside("web, no page open", {name: used_s[name] for name in processes}, "ms/s")
    times_s = []
    with running(ROBOTS, {SERVER: port}):
        for _ in range(SCRAPES + 1):
            begin_s = time.monotonic()
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30.0) as answer:
                body = answer.read()
            times_s.append(time.monotonic() - begin_s)
            time.sleep(0.2)
    what = f"web, /metrics of {ROBOTS} robots with {SIGNALS} signals at 1 Hz"
    # The fastest is what it takes when the machine does nothing else.
    yield within(what, SERVER, min(times_s[1:]), 100.0, "ms", f"{len(body) / 1e6:.1f} MB, fastest of {SCRAPES}")


def _used_s(robots: Process, processes: dict[str, Process], rounds: int) -> dict[str, list[float]]:
    """Returns the CPU time per message of each contestant in each slice."""
    return side_by_side(partial(cpu_s, processes, partial(robots.send, str(SLICE_S))), rounds)


@contextlib.contextmanager
def running(
    count: int, contestants: Mapping[str, int], rate_hz: int = 1
) -> Iterator[tuple[Process, dict[str, Process]]]:
    """Starts robots and contestants, and lets them connect. Those with a port serve there, then all keep a history."""
    signal = {"type": "std_msgs/Float32", "warn_below": 20.0, "startup_grace_s": 1000.0, "stale_after_s": 1000.0}
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write_yaml(folder, thresholds=alert_system({f"signal_{number}": signal for number in range(SIGNALS)}))
        robots = stack.enter_context(peer("robots", count * len(contestants), rate_hz))
        server = f"127.0.0.1:{robots.reply()}"
        processes: dict[str, Process] = {}
        for name, port in contestants.items():
            scheme, path = ADDRESSES.get(name, ("ws", f"json{len(processes)}"))
            url = f"{scheme}://{server}/{path}"
            addresses = {f"robot{number}": {"url": f"{url}/robot{number}"} for number in range(count)}
            described = {"defaults": {"thresholds": "thresholds.yaml"}, "robots": addresses}
            write_yaml(folder, **{path: described, f"{path}_ops": {"history": {"file": f"{path}.db"}}})
            command = [sys.executable, "-m", "robot_health_monitor", "connect", "--fleet", folder / f"{path}.yaml"]
            command += ["--ops", folder / f"{path}_ops.yaml"] if any(contestants.values()) else []
            command += ["--port", port] if port else []
            bare = name == BARE
            processes[name] = stack.enter_context(peer("bare", url, count, **MALLOC) if bare else Process(command))
        robots.ask("1")
        yield robots, processes
