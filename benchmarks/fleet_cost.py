"""CPU and memory of `robot-health connect` with robots of ten signals at 1 Hz, beside a bare aiohttp client.

With 200 robots; with 1,000 robots, a history, an open page and a receiver of alerts; and with 100 robots over each of
the bridges.

All receive the same messages at the same time from one process, over one connection per robot, in the JSON of a
rosbridge server. The bare client only parses them. What is compared is the CPU time of the whole process.

asyncio receives each message into a new buffer of 256 KiB. Whether glibc maps memory for each of them depends on what
the process has freed before, and can double the cost of a message. `robot-health connect` reads less at once
(rosbridge/sockets.py); a bare client does not, and is also measured with the buffers on the heap.
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
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from benchmarks.peer import Peer
from benchmarks.pushing_cost import free_port
from benchmarks.table import Row, median_ratio
from benchmarks.targets import ROOT, Process

ROBOTS = 200
MANY = 1000
SIGNALS = 10
SLICE_S = 10.0
ROUNDS = 3
SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
AT_MOST = 1.4
MOST_CORES, MOST_MB, MOST_ALERT_S = 1.0, 200.0, 1.0
"""With `MANY` robots."""
FEW = 20
"""Robots of the run that the memory per robot is compared with."""

OVER_BRIDGE = 100
"""Robots over each bridge: foxglove must not cost more than rosbridge in CBOR."""
BARE, ON_HEAP, CONNECT = "bare aiohttp client", "bare, receive buffers on the heap", "robot-health connect"
CBOR, FOXGLOVE = "connect, rosbridge in CBOR", "connect, foxglove"
ADDRESSES = {CONNECT: ("ws", "connect"), CBOR: ("ws", "cbor"), FOXGLOVE: ("foxglove", "foxglove")}
"""Of each contestant: the scheme, and the path at which the robots speak to it."""
MALLOC = {
    BARE: {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "131072"},
    ON_HEAP: {"MALLOC_MMAP_THRESHOLD_": "524288", "MALLOC_TRIM_THRESHOLD_": "1048576"},
}
"""glibc's limits in bytes, fixed: those that it starts with, and those after 512 KiB were freed (mallopt(3))."""


class Figures(NamedTuple):
    """What was measured."""

    cpu_us: Dict[str, List[float]]
    """Of each contestant: CPU time per message in each slice."""
    cores: Dict[str, float]
    """CPU time per second."""
    memory_mb: Dict[str, float]


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    what = f"{ROBOTS} robots of {SIGNALS} signals at 1 Hz"
    with _running(ROBOTS) as (robots, processes):
        found = _measure(robots, processes, rounds)
    yield from _cpu(what, found, {BARE: AT_MOST, ON_HEAP: None})
    with _running(FEW) as (robots, processes):
        few_mb = {name: process.own_mb() for name, process in processes.items()}
    for name in (BARE, CONNECT):
        per_robot_kb = (found.memory_mb[name] - few_mb[name]) / (ROBOTS - FEW) * 1000.0
        yield Row(f"{what}, memory", name, f"{found.memory_mb[name]:.0f} MB", remark=f"{per_robot_kb:.0f} kB per robot")
    yield from _over_bridges(rounds)
    yield from _many(rounds)


def _over_bridges(rounds: int) -> Iterator[Row]:
    what = f"{OVER_BRIDGE} robots of {SIGNALS} signals at 1 Hz, by bridge"
    with _running(OVER_BRIDGE, (), connects=(CBOR, FOXGLOVE)) as (robots, processes):
        found = _measure(robots, processes, rounds)
    for name, values in found.cpu_us.items():
        ratio = median_ratio(values, found.cpu_us[CBOR]) if name == FOXGLOVE else None
        at_most = 1.0 if name == FOXGLOVE else None
        yield Row(
            what, name, f"{statistics.median(values):.1f} us", ratio, at_most, "CPU per message, to rosbridge in CBOR"
        )


def _many(rounds: int) -> Iterator[Row]:
    what = f"{MANY} robots of {SIGNALS} signals at 1 Hz, page, history"
    port = free_port()
    with _running(MANY, (BARE,), port) as (robots, processes), contextlib.ExitStack() as clients:
        page = Peer("web_peers", "pages", port, 1)
        clients.callback(page.end)
        alerts = Peer("fleet_peers", "alerts", f"http://127.0.0.1:{port}/")
        clients.callback(alerts.end)
        before = json.loads(robots.ask("low"))
        found = _measure(robots, processes, rounds)
        time.sleep(MOST_ALERT_S)
        low_s, seen_s = json.loads(robots.ask("low")), json.loads(alerts.ask("seen"))
    yield from _cpu(what, found, {BARE: AT_MOST})
    cores, memory_mb = found.cores[CONNECT], found.memory_mb[CONNECT]
    yield Row(what, CONNECT, f"{cores:.2f} cores", cores / MOST_CORES, 1.0, f"to {MOST_CORES:g} core")
    yield Row(what, CONNECT, f"{memory_mb:.0f} MB", memory_mb / MOST_MB, 1.0, f"to {MOST_MB:g} MB")
    delays_s = [seen_s.get(robot, math.inf) - sent_s for robot, sent_s in low_s.items() if robot not in before]
    remark = f"sample to receiver, slowest of {len(delays_s)} alerts, to {MOST_ALERT_S:g} s"
    yield Row(what, CONNECT, f"{max(delays_s) * 1e3:.0f} ms", max(delays_s) / MOST_ALERT_S, 1.0, remark)


def _measure(robots: Peer, processes: Dict[str, Process], rounds: int) -> Figures:
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
    return Figures(cpu_us, cores, {name: process.own_mb() for name, process in processes.items()})


def _cpu(what: str, found: Figures, required: Dict[str, Optional[float]]) -> Iterator[Row]:
    figures = {name: f"{statistics.median(values):.1f} us" for name, values in found.cpu_us.items()}
    for bare, at_most in required.items():
        yield Row(what, bare, figures[bare])
        ratio = median_ratio(found.cpu_us[CONNECT], found.cpu_us[bare])
        yield Row(what, CONNECT, figures[CONNECT], ratio, at_most, f"CPU per message, to {bare}")


@contextlib.contextmanager
def _running(
    count: int,
    bare: Sequence[str] = (BARE, ON_HEAP),
    port: Optional[int] = None,
    connects: Sequence[str] = (CONNECT,),
) -> Iterator[Tuple[Peer, Dict[str, Process]]]:
    """Starts robots and contestants, and lets them warm up; with a port, `connect` serves there and keeps a history."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        robots = Peer("fleet_peers", "robots")
        stack.callback(robots.end)
        signals = "".join(
            f"      signal_{number}: {{type: std_msgs/Float32, warn_below: 20.0, startup_grace_s: 1000.0, "
            "stale_after_s: 1000.0}\n"
            for number in range(SIGNALS)
        )
        (folder / "thresholds.yaml").write_text(f"alert_system:\n  ros__parameters:\n    signals:\n{signals}")
        server = f"127.0.0.1:{robots.first}"
        processes: Dict[str, Process] = {}
        variables = {**os.environ, "PYTHONPATH": str(ROOT)}
        for number, name in enumerate(bare):
            url = f"http://{server}/bare{number}"
            command = [sys.executable, "-m", "benchmarks.fleet_peers", "bare", url, str(count)]
            processes[name] = Process(command, {**variables, **MALLOC[name]})
            stack.callback(processes[name].end)
        for name in connects:
            scheme, path = ADDRESSES[name]
            addresses = "".join(
                f"  robot{number}: {{url: '{scheme}://{server}/{path}/robot{number}'}}\n" for number in range(count)
            )
            fleet = folder / f"{path}.yaml"
            fleet.write_text(f"defaults: {{thresholds: thresholds.yaml}}\nrobots:\n{addresses}")
            connect = [sys.executable, "-m", "robot_health_monitor", "connect", "--fleet", str(fleet)]
            if port is not None:
                (folder / "ops.yaml").write_text(json.dumps({"history": {"file": str(folder / "history.db")}}))
                connect += ["--port", str(port), "--ops", str(folder / "ops.yaml")]
            processes[name] = Process(connect, variables)
            stack.callback(processes[name].end)
        robots.ask(str(len(processes) * count))
        robots.ask(f"{SLICE_S} {SIGNALS}")
        yield robots, processes
