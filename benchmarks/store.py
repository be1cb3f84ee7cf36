"""The store: time and memory of a history with a hundred thousand transitions, CPU time of storing samples."""

from __future__ import annotations

import json
import math
import statistics
import sys
import tempfile
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Iterator

from harness.histories import transition

from benchmarks.processes import reported, run_python
from benchmarks.table import Row, figure, side_by_side, within
from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.judge.continuity import Continuity
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History

TRANSITIONS, EVIDENCE = 100_000, 60
"""Transitions in thirty days, and samples of each."""
DAYS_S = 30.0 * 86_400.0
ROBOTS, SECONDS = 200, 120
SIGNALS = tuple(f"signal_{number}" for number in range(10))
_LEVELS = (Level.OK, Level.WARN, Level.ERROR, Level.STALE)


def history(rounds: int = 5) -> Iterator[Row]:
    """Compares an empty file with one of thirty days. Each step is a separate process, as a user would start it."""
    with tempfile.TemporaryDirectory() as folder:
        empty, full = Path(folder, "empty.db"), Path(folder, "full.db")
        _write(empty, 0)
        _write(full, TRANSITIONS)

        def measure() -> dict[str, float]:
            figures = {}
            for file in (empty, full):
                start = json.loads(run_python("-m", "benchmarks.store", file))
                figures[f"start {file.stem}"], figures[f"memory {file.stem}"] = start
                begin_s = time.perf_counter()
                run_python("-m", "robot_health_monitor", "history", file, "--since", "24h")
                figures[f"since {file.stem}"] = time.perf_counter() - begin_s
            return figures

        median = {name: statistics.median(each) for name, each in side_by_side(measure, rounds).items()}
        size = f"{TRANSITIONS:,} transitions with {EVIDENCE} samples each ({full.stat().st_size / 1e6:.0f} MB)"
    what, since = f"history, {size}", "history --since 24h"
    yield within(what, "start", median["start full"], 1.0, "s")
    yield Row(f"{since}, empty file", "command", figure(median["since empty"], "s"))
    yield within(f"{since}, {size}", "command", median["since full"], 0.5, "s", "wall time")
    more_bytes = median["memory full"] - median["memory empty"]
    yield within(what, "memory", more_bytes, 10.0, "MB", "more than with an empty file")


def _write(file: Path, count: int) -> None:
    """Writes a history whose last transition is now."""
    end_s = time.time()
    now_s = end_s - DAYS_S
    with closing(History(HistorySettings(str(file), keep_days=1e4, keep_mb=1e4), lambda: now_s)) as written:
        robot = written.of_robot("r1")
        robot.restore()
        for number in range(count):
            now_s = end_s - DAYS_S * (1.0 - (number + 1) / count)
            samples = [(now_s - EVIDENCE + place, 19.0 + math.sin(place / 9.0 + number)) for place in range(EVIDENCE)]
            turn, place = divmod(number, len(SIGNALS))
            signal, before, after = SIGNALS[place], _LEVELS[turn % 4], _LEVELS[(turn + 1) % 4]
            text = f"{signal} {after.name}: 19.5 % is below 20 % (was {before.name} for 312 s)"
            record = transition(number, after, from_level=before, signal=signal, fingerprint=f"{place:016x}", text=text)
            robot.record(record, {"level": "WARN"}, samples)
        now_s = end_s


def samples(rounds: int = 5) -> Iterator[Row]:
    """Compares a history with samples and one without: what collecting, taking and writing them adds."""
    used = side_by_side(lambda: {"without": _share(False), "with": _share(True)}, rounds)
    added = statistics.median(more - less for less, more in zip(used["without"], used["with"]))
    what = f"{ROBOTS} robots, {len(SIGNALS)} signals each at 1 Hz"
    yield Row(what, "without samples", figure(statistics.median(used["without"]), "%"))
    yield within(what, "samples add", added, 1.0, "% of a core")


def _share(samples: bool) -> float:
    """Returns the CPU time per second of the robots' time."""
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
            for second in range(SECONDS):
                now_s = second + 0.3
                for monitor, continuity in robots:
                    for name in SIGNALS:
                        monitor.observe(Sample(name, 50.0 + second % 7, now_s))
                    monitor.tick(now_s)
                    continuity.save(now_s)
                store.run(lambda connection: None, 100.0)  # waits until everything is written
            return (time.process_time() - begin_s) / SECONDS


if __name__ == "__main__":
    with ExitStack() as running, reported(time.perf_counter):
        opened = running.enter_context(closing(History(HistorySettings(sys.argv[1], keep_mb=1e4))))
        opened.of_robot("r1").restore()
