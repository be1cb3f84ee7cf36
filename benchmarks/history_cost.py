"""Time and memory of a history with a hundred thousand transitions.

Two files are compared: an empty one, and one that a monitor has written for thirty days. Each step is a process of its
own, as a user would start it.
"""

from __future__ import annotations

import math
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Dict, Iterator, List, Sequence

from benchmarks.table import Row
from benchmarks.targets import ROOT, compile_source
from robot_health_monitor.core import Level
from robot_health_monitor.core.values.model import Status, Transition
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History

TRANSITIONS = 100_000
DAYS = 30.0
SAMPLES = 60
"""Evidence per transition."""
SIGNALS = 10
ROUNDS = 5
START_LIMIT_S, SINCE_LIMIT_S, MEMORY_LIMIT_KB = 1.0, 0.5, 10_000.0
_LEVELS = (Level.OK, Level.WARN, Level.ERROR, Level.STALE)
_START = """
import resource, sys, time
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
begin_s = time.perf_counter()
history = History(HistorySettings(sys.argv[1], keep_mb=10000.0))
robot = history.of_robot("r1")
states = len(robot.restore())
took_s = time.perf_counter() - begin_s
history.close()
print(took_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, states)
"""


def rows() -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    compile_source(sys.executable)
    with tempfile.TemporaryDirectory() as folder:
        empty, full = Path(folder, "empty.db"), Path(folder, "full.db")
        _write(empty, 0)
        _write(full, TRANSITIONS)
        size_mb = full.stat().st_size / 1e6
        what = f"history, {TRANSITIONS:,} transitions with {SAMPLES} samples each ({size_mb:.0f} MB)"
        started: Dict[Path, List[List[float]]] = {empty: [], full: []}
        since: Dict[Path, List[float]] = {empty: [], full: []}
        for _ in range(ROUNDS):
            for file, figures in started.items():
                figures.append([float(word) for word in _run("-c", _START, str(file)).split()])
            for file, times_s in since.items():
                begin_s = time.perf_counter()
                _run("-m", "robot_health_monitor", "history", str(file), "--since", "24h")
                times_s.append(time.perf_counter() - begin_s)
        start_s, empty_kb, full_kb = (
            statistics.median(figure[place] for figure in started[file])
            for file, place in ((full, 0), (empty, 1), (full, 1))
        )
        since_s, empty_since_s = statistics.median(since[full]), statistics.median(since[empty])
        yield Row(what, "start", f"{start_s:.2f} s", start_s / START_LIMIT_S, 1.0, f"to {START_LIMIT_S:g} s")
        yield Row("history --since 24h, empty file", "command", f"{empty_since_s:.2f} s")
        remark = f"wall time, to {SINCE_LIMIT_S:g} s"
        yield Row(
            f"history --since 24h, {what[9:]}", "command", f"{since_s:.2f} s", since_s / SINCE_LIMIT_S, 1.0, remark
        )
        more_kb = full_kb - empty_kb
        remark = f"more memory than with an empty file, to {MEMORY_LIMIT_KB / 1e3:g} MB"
        yield Row(what, "memory", f"{more_kb / 1e3:.1f} MB", more_kb / MEMORY_LIMIT_KB, 1.0, remark)


def _write(file: Path, count: int) -> None:
    """Writes a history whose last transition is now."""
    end_s = time.time()
    now_s = end_s - DAYS * 86_400.0
    history = History(HistorySettings(str(file), keep_days=1e4, keep_mb=1e4), lambda: now_s)
    robot = history.of_robot("r1")
    robot.restore()
    for number in range(count):
        now_s = end_s - DAYS * 86_400.0 * (1.0 - (number + 1) / count)
        samples = [(now_s - SAMPLES + place, 19.0 + math.sin(place / 9.0 + number)) for place in range(SAMPLES)]
        robot.record(_transition(number), {"level": "WARN"}, samples)
    now_s = end_s
    history.close()


def _transition(number: int) -> Transition:
    turn, place = divmod(number, SIGNALS)
    signal, from_level, to_level = f"signal_{place}", _LEVELS[turn % 4], _LEVELS[(turn + 1) % 4]
    text = f"{signal} {to_level.name}: 19.5 % is below 20 % (was {from_level.name} for 312 s)"
    fields: Dict[str, Any] = {"value": 19.5, "statistic": "last", "bound": 20.0, "statistics": {"last": 19.5}}
    status = Status(signal, to_level, "19.5 % is below 20 %", "r1", {})
    return Transition(
        signal=signal,
        from_level=from_level,
        to_level=to_level,
        now_s=float(number),
        since_s=float(number) - 312.0,
        robot="r1",
        fingerprint=f"{place:016x}",
        text=text,
        status=status,
        **fields,
    )


def _run(*arguments: str) -> str:
    command: Sequence[str] = [sys.executable, *arguments]
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
