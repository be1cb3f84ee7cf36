"""The store: time and memory of a history with a hundred thousand transitions, CPU time of storing samples."""

from __future__ import annotations

import math
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Iterator

from harness.histories import transition

from benchmarks.processes import compile_source
from benchmarks.table import ROOT, Row, in_turn, within
from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.judge.continuity import Continuity
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History

TRANSITIONS = 100_000
DAYS = 30.0
EVIDENCE = 60
"""Samples per transition."""
ROBOTS = 200
SIGNALS = tuple(f"signal_{number}" for number in range(10))
_LEVELS = (Level.OK, Level.WARN, Level.ERROR, Level.STALE)
_START = """
import resource, sys, time
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
begin_s = time.perf_counter()
history = History(HistorySettings(sys.argv[1], keep_mb=10000.0))
history.of_robot("r1").restore()
took_s = time.perf_counter() - begin_s
history.close()
print(took_s, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def history(rounds: int = 5, count: int = TRANSITIONS) -> Iterator[Row]:
    """Compares an empty file with one of thirty days. Each step is a separate process, as a user would start it."""
    compile_source(sys.executable)
    memory_kb = {}
    with tempfile.TemporaryDirectory() as folder:
        empty, full = Path(folder, "empty.db"), Path(folder, "full.db")
        _write(empty, 0)
        _write(full, count)

        def start_s(file: Path) -> float:
            took_s, memory_kb[file] = map(float, _run("-c", _START, str(file)).split())
            return took_s

        def since_s(file: Path) -> float:
            begin_s = time.perf_counter()
            _run("-m", "robot_health_monitor", "history", str(file), "--since", "24h")
            return time.perf_counter() - begin_s

        steps = {
            f"{step.__name__} {file.stem}": partial(step, file) for step in (start_s, since_s) for file in (empty, full)
        }
        took = {name: statistics.median(times_s) for name, times_s in in_turn(steps, rounds).items()}
        size = f"{count:,} transitions with {EVIDENCE} samples each ({full.stat().st_size / 1e6:.0f} MB)"
    yield within(f"history, {size}", "start", took["start_s full"], 1.0, "s", digits=2)
    yield Row("history --since 24h, empty file", "command", f"{took['since_s empty']:.2f} s")
    yield within(f"history --since 24h, {size}", "command", took["since_s full"], 0.5, "s", "wall time", digits=2)
    more_mb = (memory_kb[full] - memory_kb[empty]) / 1e3
    yield within(f"history, {size}", "memory", more_mb, 10.0, "MB", "more than with an empty file", digits=1)


def _write(file: Path, count: int) -> None:
    """Writes a history whose last transition is now."""
    end_s = time.time()
    now_s = end_s - DAYS * 86_400.0
    written = History(HistorySettings(str(file), keep_days=1e4, keep_mb=1e4), lambda: now_s)
    robot = written.of_robot("r1")
    robot.restore()
    for number in range(count):
        now_s = end_s - DAYS * 86_400.0 * (1.0 - (number + 1) / count)
        samples = [(now_s - EVIDENCE + place, 19.0 + math.sin(place / 9.0 + number)) for place in range(EVIDENCE)]
        turn, place = divmod(number, len(SIGNALS))
        signal, before, after = SIGNALS[place], _LEVELS[turn % 4], _LEVELS[(turn + 1) % 4]
        text = f"{signal} {after.name}: 19.5 % is below 20 % (was {before.name} for 312 s)"
        record = transition(number, after, from_level=before, signal=signal, fingerprint=f"{place:016x}", text=text)
        robot.record(record, {"level": "WARN"}, samples)
    now_s = end_s
    written.close()


def _run(*arguments: str) -> str:
    return subprocess.run([sys.executable, *arguments], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def samples(rounds: int = 5) -> Iterator[Row]:
    """Compares a history with samples and one without: what collecting, taking and writing them adds."""
    measured = in_turn({"without": lambda: _percent(False), "with": lambda: _percent(True)}, rounds)
    added = statistics.median(more - less for less, more in zip(measured["without"], measured["with"]))
    what = f"{ROBOTS} robots, {len(SIGNALS)} signals each at 1 Hz"
    yield Row(what, "without samples", f"{statistics.median(measured['without']):.2f} %")
    yield within(what, "samples add", added, 1.0, "% of a core", digits=2)


def _percent(samples: bool, seconds: int = 120) -> float:
    """Returns the CPU time per second of the robots' time, in %."""
    now_s = 0.0
    config = load_config({"signals": {name: {"warn_below": 5.0, "stale_after_s": 5.0} for name in SIGNALS}})
    with tempfile.TemporaryDirectory() as folder:
        settings = HistorySettings(str(Path(folder, "history.db")), samples=samples)
        with closing(History(settings, lambda: 1.8e9 + now_s)) as store:
            monitors = [Monitor(config, robot=f"robot_{number}") for number in range(ROBOTS)]
            robots = [(each, Continuity(each, store.of_robot(each.robot))) for each in monitors]
            for _, continuity in robots:
                continuity.restore(0.0, at_first_call=False)
            store.run(lambda connection: None, 100.0)
            begin_s = time.process_time()
            for second in range(seconds):
                now_s = second + 0.3
                for monitor, continuity in robots:
                    for name in SIGNALS:
                        monitor.observe(Sample(name, 50.0 + second % 7, now_s))
                    monitor.tick(now_s)
                    continuity.save(now_s)
                store.run(lambda connection: None, 100.0)  # waits until everything is written
            return (time.process_time() - begin_s) / seconds * 100.0
