"""CPU time of measuring this computer: thirty metrics and ten processes, compared with reading the same files bare.

Both take turns, a period each. What the sources open is noted, and the bare reader opens exactly that, as often; it
also lists the processes and asks the disk for its space. CPU time is that of the whole process.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import statistics
import subprocess
import sys
import time
from functools import partial
from typing import Any, Callable, Iterator

from benchmarks.table import Row, beside, side_by_side, within
from robot_health_monitor.core.sensors import configuration
from robot_health_monitor.core.sensors.computer import Computer
from robot_health_monitor.core.sensors.source import SensorError
from robot_health_monitor.runtime.threads import DetachedCalls

METRICS = (
    "cpu_percent", "load_1min", "load_15min", "memory_available", "pressure_cpu", "pressure_io", "disk_free",
    "disk_latency_ms", "temperature", "fan_rpm", "voltage_rail", "battery_percent", "network_receive", "network_send",
    "network_errors", "network_drops",
)  # fmt: skip
"""With those of `host_preset` and one core's `cpu_percent` thirty; those that this computer lacks cost their search."""
OF_PROCESS = ("process_cpu_percent", "process_memory", "process_running")
SOURCES = "battery_sensor's sources"


def rows(rounds: int = 60) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    section: dict[str, dict[str, Any]] = {f"m_{name}": {"source": name} for name in METRICS}
    section["core"] = {"source": "cpu_percent", "core": 0}
    opened: list[str] = []
    with contextlib.ExitStack() as running:
        for number in range(86000, 86010):
            sleeper = running.enter_context(subprocess.Popen(["sleep", str(number)]))
            running.callback(sleeper.kill)
            section.update({f"{name}_{number}": {"source": name, "command": f"*sleep {number}"} for name in OF_PROCESS})
        calls = running.enter_context(contextlib.closing(DetachedCalls("sources")))
        standard = {metric: {"source": "none"} for metric in configuration.METRICS}
        tree = {"host": section, "host_preset": "standard", **standard}
        sources, seconds = configuration.read_sources(tree, computer=Computer(background=calls)), itertools.count(1)

        def measure() -> None:
            opened.clear()
            now_s = float(next(seconds))
            for source in sources.values():
                with contextlib.suppress(SensorError):
                    source.read(now_s)

        def in_turn() -> dict[str, float]:
            return {SOURCES: _cpu_s(measure), "bare": _cpu_s(partial(_read_bare, list(filter(os.path.isfile, opened))))}

        # The hook costs both contestants the same.
        sys.addaudithook(lambda event, about: opened.append(str(about[0])) if event == "open" else None)
        used_s = side_by_side(in_turn, rounds)
        measure()
        peer = f"bare reader of the same {sum(map(os.path.isfile, opened))} files"
    yield from beside("30 metrics and 10 processes, once", {peer: used_s["bare"], SOURCES: used_s[SOURCES]}, "us", 2.0)
    yield within("the same at 1 Hz", SOURCES, statistics.median(used_s[SOURCES]), 0.5, "% of a core")


def _cpu_s(act: Callable[[], None]) -> float:
    """Returns the CPU time of a function after a pause: at 1 Hz, caches have been used by others too."""
    time.sleep(0.05)
    begin_s = time.process_time()
    act()
    return time.process_time() - begin_s


def _read_bare(files: list[str]) -> None:
    """Reads files whole, lists the processes, and asks for the space of the disk."""
    os.listdir("/proc")
    os.statvfs("/")
    for path in files:
        with contextlib.suppress(OSError), open(path, "rb", buffering=0) as stream:
            stream.read()
