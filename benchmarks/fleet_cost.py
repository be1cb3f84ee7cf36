"""CPU and memory of `robot-health connect` with 200 robots of ten signals at 1 Hz, beside a bare aiohttp client.

Both receive the same messages at the same time from one process, over one connection per robot, in the JSON of a
rosbridge server. The bare client only parses them. What is compared is the CPU time of the whole process.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict, Iterator, List, Tuple

from benchmarks.table import Row, median_ratio
from benchmarks.targets import ROOT, Process

ROBOTS = 200
SIGNALS = 10
SLICE_S = 10.0
ROUNDS = 3
SETTLE_S = 0.5
AT_MOST = 1.6
FEW = 20
"""Robots of the run that the memory per robot is compared with."""


class Feeder:
    """The rosbridge servers of all robots."""

    def __init__(self) -> None:
        """Starts it."""
        command = [sys.executable, "-m", "benchmarks.fleet_peers", "feeder"]
        self._process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.port = int(self._answer())

    def order(self, line: str) -> str:
        """Writes a line and returns the reply."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return self._answer()

    def end(self) -> None:
        """Ends it."""
        self._process.kill()
        self._process.communicate()

    def _answer(self) -> str:
        assert self._process.stdout is not None
        answer = self._process.stdout.readline().strip()
        if not answer:
            raise RuntimeError("the feeder of the fleet benchmark has ended")
        return answer


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    what = f"{ROBOTS} robots of {SIGNALS} signals at 1 Hz"
    cpu_us: Dict[str, List[float]] = {"bare": [], "connect": []}
    memory_mb: Dict[str, float] = {}
    with _running(ROBOTS) as (feeder, processes):
        feeder.order(f"{SLICE_S} {SIGNALS}")
        for _ in range(rounds):
            begin_s = {name: process.cpu_s() for name, process in processes.items()}
            sent = int(feeder.order(f"{SLICE_S} {SIGNALS}"))
            time.sleep(SETTLE_S)
            for name, process in processes.items():
                cpu_us[name].append((process.cpu_s() - begin_s[name]) / sent * 1e6)
        memory_mb = {name: process.own_mb() for name, process in processes.items()}
    figures = {name: f"{statistics.median(values):.1f} us" for name, values in cpu_us.items()}
    ratio = median_ratio(cpu_us["connect"], cpu_us["bare"])
    yield Row(what, "bare aiohttp client", figures["bare"])
    yield Row(what, "robot-health connect", figures["connect"], ratio, AT_MOST, "CPU per message, to the bare client")
    with _running(FEW) as (feeder, processes):
        feeder.order(f"{SLICE_S} {SIGNALS}")
        few_mb = {name: process.own_mb() for name, process in processes.items()}
    for name, contestant in (("bare", "bare aiohttp client"), ("connect", "robot-health connect")):
        per_robot_kb = (memory_mb[name] - few_mb[name]) / (ROBOTS - FEW) * 1000.0
        yield Row(f"{what}, memory", contestant, f"{memory_mb[name]:.0f} MB", remark=f"{per_robot_kb:.0f} kB per robot")


@contextlib.contextmanager
def _running(robots: int) -> Iterator[Tuple[Feeder, Dict[str, Process]]]:
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        feeder = Feeder()
        stack.callback(feeder.end)
        signals = "".join(
            f"      signal_{number}: {{type: std_msgs/Float32, warn_below: 20.0, startup_grace_s: 1000.0, "
            "stale_after_s: 1000.0}\n"
            for number in range(SIGNALS)
        )
        (folder / "thresholds.yaml").write_text(f"alert_system:\n  ros__parameters:\n    signals:\n{signals}")
        server = f"ws://127.0.0.1:{feeder.port}/connect"
        addresses = "".join(f"  robot{number}: {{url: {server}/robot{number}}}\n" for number in range(robots))
        (folder / "fleet.yaml").write_text(f"defaults: {{thresholds: thresholds.yaml}}\nrobots:\n{addresses}")
        variables = {**os.environ, "PYTHONPATH": str(ROOT)}
        bare = [sys.executable, "-m", "benchmarks.fleet_peers", "bare", str(feeder.port), str(robots)]
        connect = [sys.executable, "-m", "robot_health_monitor", "connect", "--fleet", str(folder / "fleet.yaml")]
        processes = {"bare": Process(bare, variables), "connect": Process(connect, variables)}
        for process in processes.values():
            stack.callback(process.end)
        feeder.order(str(2 * robots))
        yield feeder, processes
