"""CPU and memory of `robot-health connect` with robots of ten signals at 1 Hz, beside a bare aiohttp client.

With 200 robots; with 1,000 robots, a history, an open page and a receiver of alerts; and with 100 robots over each of
the bridges. All receive the same messages at the same time from one process, over one connection per robot. The bare
client only parses the JSON of a rosbridge server. What is compared is the CPU time of the whole process.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Iterator, Sequence

from harness.reserved import free_port

from benchmarks.peers import SIGNALS
from benchmarks.processes import Process, alert_system, peer, write_yaml
from benchmarks.table import ROOT, Row, beside, within

ROBOTS, OVER_BRIDGE, MANY = 200, 100, 1000
SLICE_S = 10.0
SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
BARE, CONNECT = "bare aiohttp client", "robot-health connect"
CBOR, FOXGLOVE = "connect, rosbridge in CBOR", "connect, foxglove"
ADDRESSES = {
    BARE: ("http", "bare"),
    CONNECT: ("ws", "connect"),
    CBOR: ("ws", "cbor"),
    FOXGLOVE: ("foxglove", "foxglove"),
}
"""Of each contestant: the scheme, and the path at which the robots speak to it."""
MALLOC = {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "131072"}
"""glibc's first limits, fixed: asyncio receives each message into a new buffer of 256 KiB, for which glibc maps memory
or not, depending on what the process has freed before (mallopt(3)). `connect` reads less at once."""


def rows(rounds: int = 3) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    what, remark = f"robots of {SIGNALS} signals at 1 Hz", ", CPU per message"
    with _running(ROBOTS, [BARE, CONNECT]) as (robots, processes):
        cpu_us = _cpu_us(robots, processes, rounds)
        memory_mb = {name: process.own_mb() for name, process in processes.items()}
    yield from beside(f"{ROBOTS} {what}", cpu_us, "us", 1.4, remark, digits=1)
    for name, megabytes in memory_mb.items():
        yield Row(f"{ROBOTS} {what}, memory", name, f"{megabytes:.0f} MB")
    with _running(OVER_BRIDGE, [CBOR, FOXGLOVE]) as (robots, processes):
        cpu_us = _cpu_us(robots, processes, rounds)
    yield from beside(f"{OVER_BRIDGE} {what}, by bridge", cpu_us, "us", 1.0, remark, digits=1)

    what, port = f"{MANY} {what}, page, history", free_port()
    with _running(MANY, [BARE, CONNECT], port) as (robots, processes), contextlib.ExitStack() as clients:
        clients.enter_context(peer("clients", port, 1)).reply()
        alerts = clients.enter_context(peer("alerts", f"http://127.0.0.1:{port}/"))
        alerts.reply()
        before = json.loads(robots.ask("low"))
        cpu_us = _cpu_us(robots, processes, rounds)
        connect_mb = processes[CONNECT].own_mb()
        time.sleep(1.0)
        low_s, seen_s = json.loads(robots.ask("low")), json.loads(alerts.ask("seen"))
    yield from beside(what, cpu_us, "us", 1.4, remark, digits=1)
    cores = statistics.fmean(cpu_us[CONNECT]) * MANY * SIGNALS / 1e6
    yield within(what, CONNECT, cores, 1.0, "cores", digits=2)
    yield within(what, CONNECT, connect_mb, 200.0, "MB")
    delays_ms = [(seen_s.get(robot, math.inf) - sent_s) * 1e3 for robot, sent_s in low_s.items() if robot not in before]
    remark = f"sample to receiver, slowest of {len(delays_ms)} alerts"
    yield within(what, CONNECT, max(delays_ms), 1000.0, "ms", remark)


def _cpu_us(robots: Process, processes: dict[str, Process], rounds: int) -> dict[str, list[float]]:
    """Returns the CPU time per message of each contestant in each slice, in us."""
    cpu_us: dict[str, list[float]] = {name: [] for name in processes}
    for _ in range(rounds):
        begin_s = {name: process.cpu_s() for name, process in processes.items()}
        sent = int(robots.ask(f"send {SLICE_S}"))
        time.sleep(SETTLE_S)
        for name, process in processes.items():
            cpu_us[name].append((process.cpu_s() - begin_s[name]) / sent * 1e6)
    return cpu_us


@contextlib.contextmanager
def _running(
    count: int, contestants: Sequence[str], port: int | None = None
) -> Iterator[tuple[Process, dict[str, Process]]]:
    """Starts robots and contestants, and lets them warm up; with a port, `connect` serves there and keeps a history."""
    signal = {"type": "std_msgs/Float32", "warn_below": 20.0, "startup_grace_s": 1000.0, "stale_after_s": 1000.0}
    thresholds = alert_system({f"signal_{number}": signal for number in range(SIGNALS)})
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write_yaml(folder, thresholds=thresholds, ops={"history": {"file": str(folder / "history.db")}})
        robots = stack.enter_context(peer("robots"))
        server = f"127.0.0.1:{robots.reply()}"
        processes: dict[str, Process] = {}
        for name in contestants:
            scheme, path = ADDRESSES[name]
            url, variables = f"{scheme}://{server}/{path}", {**os.environ, "PYTHONPATH": str(ROOT)}
            if name == BARE:
                command = ["benchmarks.peers", "bare", url, count]
                variables.update(MALLOC)
            else:
                addresses = {f"robot{number}": {"url": f"{url}/robot{number}"} for number in range(count)}
                write_yaml(folder, **{path: {"defaults": {"thresholds": "thresholds.yaml"}, "robots": addresses}})
                command = ["robot_health_monitor", "connect", "--fleet", folder / f"{path}.yaml"]
                command += ["--port", port, "--ops", folder / "ops.yaml"] if port is not None else []
            processes[name] = stack.enter_context(Process([sys.executable, "-m", *command], variables))
        robots.ask(f"wait {len(processes) * count}")
        robots.ask(f"send {SLICE_S}")
        yield robots, processes
