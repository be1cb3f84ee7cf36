"""A storm of alerts: a thousand transitions per second from many signals, beside a page that reads and a quiet robot.

Required: the history file and its log stay within `keep_mb` and a tenth, an alert writes at most 10 kB, and the alerts
of the quiet robot stay.
"""

from __future__ import annotations

import random
import tempfile
import threading
import time
from pathlib import Path
from typing import Mapping

from harness.histories import fault_texts, transition
from soak.figures import Figure, count

from robot_health_monitor.core import Level
from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store import queries
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.ops.store.history import History, RobotHistory
from robot_health_monitor.ops.store.silences import read_silences

RATE_HZ = 1000.0
SIGNALS = 1000
QUIET = 2
"""Alerts of the quiet robot."""
WINDOW = 60
"""Samples per window, at 10 Hz."""
MOST_WRITTEN_KB = 10.0
_POLL_S = 0.02
_STATE = {"announced": {"level": "WARN", "since": 1_700_000_000.123}, "firing": {"WARN": 1_700_000_000.123}}


class _Page(threading.Thread):
    """Reads as an open page does, and notes the largest size of file and log."""

    def __init__(self, file: Path) -> None:
        super().__init__(name="page", daemon=True)
        self._files = [file, file.with_name(file.name + "-wal")]
        self._ended = threading.Event()
        self.largest_bytes = 0
        self.reads = 0

    def run(self) -> None:
        read_at_s = 0.0
        while not self._ended.wait(_POLL_S):
            self.largest_bytes = max(self.largest_bytes, sum(_size(file) for file in self._files))
            if time.monotonic() >= read_at_s:
                read_at_s = time.monotonic() + 1.0
                with reading(self._files[0]) as connection:
                    list(queries.transitions(connection, newest=1000))
                    list(queries.transitions(connection, signal="signal_7", newest=100))
                    queries.gaps(connection)
                    read_silences(connection)
                self.reads += 1

    def end(self) -> None:
        self._ended.set()
        self.join()


def run(seconds: float, keep_mb: float, seed: int) -> list[Figure]:
    """Stores transitions for so long; returns the figures."""
    chance = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "history.db")
        faults = Faults()
        history = History(HistorySettings(str(file), keep_mb=keep_mb), faults=faults)
        robots = {name: history.of_robot(name) for name in ("quiet", "noisy")}
        for number in range(QUIET):
            _record(robots, "quiet", number, "battery_level", time.time(), chance)
        history.run(lambda connection: None, 600.0)  # the page finds a file
        page = _Page(file)
        page.start()
        written = _written_bytes()
        begin_s = time.monotonic()
        number = QUIET
        while time.monotonic() < begin_s + seconds:
            signal = f"signal_{chance.randrange(SIGNALS)}"
            _record(robots, "noisy", number, signal, time.time(), chance)
            number += 1
            time.sleep(max(0.0, begin_s + (number - QUIET) / RATE_HZ - time.monotonic()))
        took_s = time.monotonic() - begin_s
        page.end()
        history.close(600.0)
        with reading(file) as connection:
            kept = sum(1 for _ in queries.transitions(connection, robot="quiet"))
        written_kb, blocks_kb = (
            (now - before) / (number - QUIET) / 1e3 for now, before in zip(_written_bytes(), written)
        )
        texts = "; ".join(f"{part}: {text}" for part, text in fault_texts(faults))
    return [
        Figure(f"storm: {(number - QUIET) / took_s:.0f} alerts/s", 0.0, float(number - QUIET), 0.0, 0.0, ""),
        Figure(f"storm: file and log, keep_mb: {keep_mb:g}", 0.0, page.largest_bytes / 1e6, page.largest_bytes / 1e6,
               1.1 * keep_mb, "MB"),
        Figure("storm: written per alert", 0.0, written_kb, written_kb, MOST_WRITTEN_KB, "kB"),
        Figure("storm: the same in blocks of the disk", 0.0, blocks_kb, blocks_kb, MOST_WRITTEN_KB, "kB"),
        count("storm: alerts of the quiet robot", kept, QUIET),
        count("storm: reads of the page", page.reads, 1),
        Figure(f"storm: faults {texts}", 0.0, float(bool(texts)), float(bool(texts)), 0.0, ""),
    ]  # fmt: skip


_windows: dict[str, list[tuple[float, float]]] = {}


def _record(
    robots: Mapping[str, RobotHistory], robot: str, number: int, signal: str, now_s: float, chance: random.Random
) -> None:
    """Stores a transition with a window of samples that has moved on since the signal's previous one."""
    window = _windows.setdefault(signal, [(now_s - 0.1 * place, 19.5) for place in range(WINDOW, 0, -1)])
    while window[-1][0] < now_s - 0.1:
        window.append((window[-1][0] + 0.1, 19.5 + chance.random()))
    del window[:-WINDOW]
    level = (Level.WARN, Level.OK)[number % 2]
    text = f"{signal} {level.name}: 19.5 % is below 20 % (was OK for 312 s)"
    state = {**_STATE, "since": {"WARN": now_s}}
    robots[robot].record(transition(number, level, robot=robot, signal=signal, text=text), state, window)


def _written_bytes() -> tuple[int, int]:
    """Returns how many bytes this process has written, and how many of its disk's blocks have to be written for it."""
    counts = dict(line.split(": ") for line in Path("/proc/self/io").read_text(encoding="ascii").splitlines())
    return int(counts["wchar"]), int(counts["write_bytes"])


def _size(file: Path) -> int:
    try:
        return file.stat().st_size
    except FileNotFoundError:
        return 0
