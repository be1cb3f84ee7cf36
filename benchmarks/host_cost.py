"""CPU time of measuring this computer: thirty metrics and ten processes, compared with reading the same files bare.

Both take turns, a period each. What the sources opened in the period before is noted, and the bare reader opens exactly
that, as often; it also lists the processes and asks the disk for its space. CPU time is that of the whole process.
"""

from __future__ import annotations

import builtins
import contextlib
import os
import statistics
import subprocess
import time
from typing import Any, Callable, Dict, Iterator, List, Tuple
from unittest import mock

from benchmarks.table import Row, median_ratio
from robot_health_monitor.core.sensors import configuration
from robot_health_monitor.core.sensors.computer import Computer
from robot_health_monitor.core.sensors.source import SensorError
from robot_health_monitor.runtime.threads import DetachedCalls

AT_MOST_PERCENT = 0.5
AT_MOST_RATIO = 2.0
ROUNDS = 60
PAUSE_S = 0.05

METRICS: Tuple[Tuple[str, Dict[str, Any]], ...] = (
    ("cpu_percent", {}),
    ("cpu_percent", {"core": 0}),
    *((name, {}) for name in ("load_1min", "load_5min", "load_15min", "memory_percent", "memory_available")),
    *((name, {}) for name in ("swap_percent", "pressure_cpu", "pressure_memory", "pressure_io", "oom_kills")),
    *((name, {}) for name in ("disk_percent", "disk_free", "disk_inodes_percent", "disk_read_only")),
    *((name, {}) for name in ("disk_latency_ms", "temperature", "fan_rpm", "voltage_rail", "throttled")),
    *((name, {}) for name in ("battery_percent", "network_receive", "network_send", "network_errors")),
    *((name, {}) for name in ("network_drops", "network_carrier", "wifi_signal", "clock_synchronized")),
    ("systemd_failed", {}),
)
"""Thirty; those that this computer does not have cost their search."""

OF_PROCESS = ("process_cpu_percent", "process_memory", "process_running")


def rows(rounds: int = ROUNDS, pause_s: float = PAUSE_S) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with contextlib.ExitStack() as running:
        section: Dict[str, Dict[str, Any]] = {
            f"m{number}": {"source": name, **options} for number, (name, options) in enumerate(METRICS)
        }
        for number in range(10):
            sleeper = subprocess.Popen(["sleep", str(86000 + number)])
            running.callback(sleeper.wait)
            running.callback(sleeper.kill)
            for name in OF_PROCESS:
                section[f"p{number}_{name}"] = {"source": name, "command": f"*sleep {86000 + number}"}
        calls = DetachedCalls("sources")
        running.callback(calls.close)
        tree = {"host": section, **{metric: {"source": "none"} for metric in configuration.METRICS}}
        sources = configuration.read_sources(tree, computer=Computer(background=calls))

        def measure(now_s: float) -> None:
            for source in sources.values():
                with contextlib.suppress(SensorError):
                    source.read(now_s)

        measure(0.0)
        files: List[str] = []
        bare_us: List[float] = []
        sources_us: List[float] = []
        for number in range(rounds + 1):
            files = opened_by(lambda now_s=2.0 * number + 1.0: measure(now_s))  # type: ignore[misc]
            bare = cpu_us(lambda files=files: read_bare(files), pause_s)  # type: ignore[misc]
            own = cpu_us(lambda now_s=2.0 * number + 2.0: measure(now_s), pause_s)  # type: ignore[misc]
            if number:
                bare_us.append(bare)
                sources_us.append(own)

    what = "30 metrics and 10 processes, once"
    yield Row(what, f"bare reader of the same {len(files)} files", f"{statistics.median(bare_us):.0f} us")
    figure = statistics.median(sources_us)
    yield Row(what, "battery_sensor's sources", f"{figure:.0f} us", median_ratio(sources_us, bare_us), AT_MOST_RATIO,
              "to the bare reader")  # fmt: skip
    percent = figure / 1e4
    share = percent / AT_MOST_PERCENT
    yield Row("the same at 1 Hz", "battery_sensor's sources", f"{percent:.2f} %", share, 1.0, "to 0.5 % of a core")


def cpu_us(function: Callable[[], None], pause_s: float) -> float:
    """Returns the CPU time of a function after a pause: at 1 Hz, caches have been used by others too."""
    time.sleep(pause_s)
    begin_s = time.process_time()
    function()
    return 1e6 * (time.process_time() - begin_s)


def opened_by(function: Callable[[], None]) -> List[str]:
    """Returns the paths of the files that a function opens and that exist, in order."""
    found: List[str] = []
    plain, plain_os = builtins.open, os.open

    def noted(path: Any, *arguments: Any, **options: Any) -> Any:
        stream = plain(path, *arguments, **options)
        found.append(str(path))
        return stream

    def noted_os(path: Any, *arguments: Any, **options: Any) -> int:
        file = plain_os(path, *arguments, **options)
        found.append(str(path))
        return file

    with mock.patch.object(builtins, "open", noted), mock.patch.object(os, "open", noted_os):
        function()
    return [path for path in found if os.path.isfile(path)]


def read_bare(files: List[str]) -> None:
    """Reads files whole, lists the processes, and asks for the space of the disk."""
    os.listdir("/proc")
    os.statvfs("/")
    for path in files:
        with contextlib.suppress(OSError), open(path, "rb", buffering=0) as stream:
            stream.read()
