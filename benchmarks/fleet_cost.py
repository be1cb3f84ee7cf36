"""CPU and memory of `robot-health connect` with 200 robots of ten signals at 1 Hz, beside a bare aiohttp client.

All receive the same messages at the same time from one process, over one connection per robot, in the JSON of a
rosbridge server. The bare client only parses them. What is compared is the CPU time of the whole process.

asyncio receives each message into a new buffer of 256 KiB. Whether glibc maps memory for each of them depends on what
the process has freed before, and can double the cost of a message. `robot-health connect` reads less at once
(rosbridge/sockets.py); a bare client does not, and is also measured with the buffers on the heap.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict, Iterator, List, Tuple

from benchmarks.peer import Peer
from benchmarks.table import Row, median_ratio
from benchmarks.targets import ROOT, Process

ROBOTS = 200
SIGNALS = 10
SLICE_S = 10.0
ROUNDS = 3
SETTLE_S = 0.5
"""Time for messages in flight at the end of a slice."""
AT_MOST = 1.4
FEW = 20
"""Robots of the run that the memory per robot is compared with."""

BARE, ON_HEAP, CONNECT = "bare aiohttp client", "bare, receive buffers on the heap", "robot-health connect"
MALLOC = {
    BARE: {"MALLOC_MMAP_THRESHOLD_": "131072", "MALLOC_TRIM_THRESHOLD_": "131072"},
    ON_HEAP: {"MALLOC_MMAP_THRESHOLD_": "524288", "MALLOC_TRIM_THRESHOLD_": "1048576"},
}
"""glibc's limits in bytes, fixed: those that it starts with, and those after 512 KiB were freed (mallopt(3))."""


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    what = f"{ROBOTS} robots of {SIGNALS} signals at 1 Hz"
    with _running(ROBOTS) as (robots, processes):
        cpu_us: Dict[str, List[float]] = {name: [] for name in processes}
        for _ in range(rounds):
            begin_s = {name: process.cpu_s() for name, process in processes.items()}
            sent = int(robots.ask(f"{SLICE_S} {SIGNALS}"))
            time.sleep(SETTLE_S)
            for name, process in processes.items():
                cpu_us[name].append((process.cpu_s() - begin_s[name]) / sent * 1e6)
        memory_mb = {name: process.own_mb() for name, process in processes.items()}
    figures = {name: f"{statistics.median(values):.1f} us" for name, values in cpu_us.items()}
    for bare, required in ((BARE, AT_MOST), (ON_HEAP, None)):
        yield Row(what, bare, figures[bare])
        ratio = median_ratio(cpu_us[CONNECT], cpu_us[bare])
        yield Row(what, CONNECT, figures[CONNECT], ratio, required, f"CPU per message, to {bare}")
    with _running(FEW) as (robots, processes):
        few_mb = {name: process.own_mb() for name, process in processes.items()}
    for name in (BARE, CONNECT):
        per_robot_kb = (memory_mb[name] - few_mb[name]) / (ROBOTS - FEW) * 1000.0
        yield Row(f"{what}, memory", name, f"{memory_mb[name]:.0f} MB", remark=f"{per_robot_kb:.0f} kB per robot")


@contextlib.contextmanager
def _running(count: int) -> Iterator[Tuple[Peer, Dict[str, Process]]]:
    """Starts robots and contestants, and lets them warm up."""
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
        addresses = "".join(
            f"  robot{number}: {{url: ws://{server}/connect/robot{number}}}\n" for number in range(count)
        )
        (folder / "fleet.yaml").write_text(f"defaults: {{thresholds: thresholds.yaml}}\nrobots:\n{addresses}")
        processes: Dict[str, Process] = {}
        variables = {**os.environ, "PYTHONPATH": str(ROOT)}
        for number, (name, malloc) in enumerate(MALLOC.items()):
            url = f"http://{server}/bare{number}"
            bare = [sys.executable, "-m", "benchmarks.fleet_peers", "bare", url, str(count)]
            processes[name] = Process(bare, {**variables, **malloc})
            stack.callback(processes[name].end)
        connect = [sys.executable, "-m", "robot_health_monitor", "connect", "--fleet", str(folder / "fleet.yaml")]
        processes[CONNECT] = Process(connect, variables)
        stack.callback(processes[CONNECT].end)
        robots.ask(str(len(processes) * count))
        robots.ask(f"{SLICE_S} {SIGNALS}")
        yield robots, processes
