"""CPU time of measuring this computer: thirty metrics and ten processes, compared with reading the same files bare.

Both take turns, a period each. What the sources open is noted, and the bare reader opens exactly that, as often; it
also lists the processes and asks the disk for its space. CPU time is that of the whole process.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import subprocess
import sys
import time
from functools import partial
from typing import Any, Callable, Iterator

from benchmarks.table import Row, beside, in_turn, within
from robot_health_monitor.core.sensors import configuration
from robot_health_monitor.core.sensors.computer import Computer
from robot_health_monitor.core.sensors.source import SensorError
from robot_health_monitor.runtime.threads import DetachedCalls

METRICS = (
    "cpu_percent", "load_1min", "load_5min", "load_15min", "memory_percent", "memory_available", "swap_percent",
    "pressure_cpu", "pressure_memory", "pressure_io", "oom_kills", "disk_percent", "disk_free", "disk_inodes_percent",
    "disk_read_only", "disk_latency_ms", "temperature", "fan_rpm", "voltage_rail", "throttled", "battery_percent",
    "network_receive", "network_send", "network_errors", "network_drops", "network_carrier", "wifi_signal",
    "clock_synchronized", "systemd_failed",
)  # fmt: skip
"""With one core's `cpu_percent` thirty; those that this computer does not have cost their search."""
OF_PROCESS = ("process_cpu_percent", "process_memory", "process_running")
SOURCES = "battery_sensor's sources"


def rows(rounds: int = 60) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    section: dict[str, dict[str, Any]] = {f"m_{name}": {"source": name} for name in METRICS}
    section["core"] = {"source": "cpu_percent", "core": 0}
    with contextlib.ExitStack() as running:
        for number in range(10):
            sleeper = subprocess.Popen(["sleep", str(86000 + number)])
            running.callback(sleeper.wait)
            running.callback(sleeper.kill)
            for name in OF_PROCESS:
                section[f"{name}_{number}"] = {"source": name, "command": f"*sleep {86000 + number}"}
        calls = DetachedCalls("sources")
        running.callback(calls.close)
        tree = {"host": section, **{metric: {"source": "none"} for metric in configuration.METRICS}}
        sources = configuration.read_sources(tree, computer=Computer(background=calls))
        opened: list[str] = []
        files: list[str] = []
        now_s = 0.0

        def note(event: str, arguments: Any) -> None:
            if event == "open":
                opened.append(str(arguments[0]))

        def measure() -> None:
            nonlocal now_s
            now_s += 1.0
            opened.clear()
            for source in sources.values():
                with contextlib.suppress(SensorError):
                    source.read(now_s)
            files[:] = opened

        def existing() -> list[str]:
            return [path for path in files if os.path.isfile(path)]

        sys.addaudithook(note)  # it costs both contestants the same
        read_us = {SOURCES: lambda: _cpu_us(measure), "bare": lambda: _cpu_us(partial(_read_bare, existing()))}
        cost_us = in_turn(read_us, rounds)
        peer = f"bare reader of the same {len(existing())} files"
    figures = {peer: cost_us["bare"], SOURCES: cost_us[SOURCES]}
    yield from beside("30 metrics and 10 processes, once", figures, "us", 2.0)
    figure = statistics.median(cost_us[SOURCES]) / 1e4
    yield within("the same at 1 Hz", SOURCES, figure, 0.5, "% of a core", digits=2)


def _cpu_us(function: Callable[[], None]) -> float:
    """Returns the CPU time of a function after a pause: at 1 Hz, caches have been used by others too."""
    time.sleep(0.05)
    begin_s = time.process_time()
    function()
    return 1e6 * (time.process_time() - begin_s)


def _read_bare(files: list[str]) -> None:
    """Reads files whole, lists the processes, and asks for the space of the disk."""
    os.listdir("/proc")
    os.statvfs("/")
    for path in files:
        with contextlib.suppress(OSError), open(path, "rb", buffering=0) as stream:
            stream.read()
