"""Kills a monitor that stores samples at random moments, and checks after each kill what is in the file.

Required: the file can be read, every period that had ended before the last complete tick has exactly the samples that
were observed, and what is lost are at most the last 10 s and the tick that was interrupted. The next monitor goes on
half a second later, often in the same period. One round in ten ends by itself: then nothing is lost.
"""

from __future__ import annotations

import os
import random
import signal
import sqlite3
import tempfile
import time
from pathlib import Path

from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.judge.continuity import Continuity
from robot_health_monitor.core.judge.sample_summary import PERIOD_S
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History

LONGEST_S = 0.08
"""Longest time until the kill: a monitor starts in about a quarter of it."""
START_S = 1_800_000_000.0
CONFIG = load_config({"signals": {"battery": {"stale_after_s": 0.0}}})


def _monitor(folder: Path, start_s: float, chance: random.Random, steps: float) -> None:
    """Runs a monitor; writes a line to `observed` before each sample, after each tick, and after a clean end."""
    log = os.open(folder / "observed", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    now_s = start_s
    history = History(HistorySettings(str(folder / "history.db"), keep_days=1e4), lambda: now_s)
    monitor = Monitor(CONFIG, robot="r1")
    continuity = Continuity(monitor, history.of_robot("r1"))
    continuity.restore(now_s, at_first_call=False)
    done = 0
    while done < steps:
        value = chance.uniform(0.0, 100.0)
        os.write(log, f"sample {now_s!r} {value!r}\n".encode())
        monitor.observe(Sample("battery", value, now_s))
        monitor.tick(now_s)
        continuity.save(now_s)
        history.run(lambda connection: None, 60.0)
        os.write(log, f"tick {now_s!r}\n".encode())
        now_s += 1.0
        done += 1
    continuity.record_samples(now_s)
    history.close(600.0)
    os.write(log, b"closed\n")


class Referee:
    """Compares what was observed with what is stored, after each round."""

    def __init__(self, folder: Path) -> None:
        """Starts before the first round."""
        self._folder = folder
        self._offset = 0
        self._expected: dict[int, list[float]] = {}
        """The values of each period that are known to be stored."""
        self.now_s = START_S
        """When the next monitor starts."""
        self.counts = {"samples": 0, "lost": 0, "most lost by a kill": 0, "periods that a restart continued": 0}

    def check(self) -> list[str]:
        """Returns the violations of a round."""
        samples, tick_s, is_closed = self._read_observed()
        stored = self._read_stored()
        parts: dict[int, list[float]] = {}
        for time_s, value in samples:
            parts.setdefault(int(time_s // PERIOD_S), []).append(value)
        found: list[str] = []
        lost = 0
        for period, part in parts.items():
            known = self._expected.get(period, [])
            self.counts["periods that a restart continued"] += bool(known)
            is_required = is_closed or period < tick_s // PERIOD_S
            if stored.get(period, (0,))[0] == len(known) + len(part):
                self._expected[period] = [*known, *part]
            elif is_required or stored.get(period, (0,))[0] != len(known):
                found.append(f"period {period} has {stored.get(period)}, observed were {known} and {part}")
            else:
                lost += len(part)
        for period, values in self._expected.items():
            if stored.get(period) != (len(values), min(values), max(values), values[-1]):
                found.append(f"period {period} has {stored.get(period)}, expected was {values}")
        self.counts["samples"] += len(samples)
        self.counts["lost"] += lost
        self.counts["most lost by a kill"] = max(self.counts["most lost by a kill"], lost)
        if lost > PERIOD_S + 1:
            found.append(f"{lost} samples were lost")
        self.now_s = samples[-1][0] + 0.5 if samples else self.now_s
        return found

    def _read_observed(self) -> tuple[list[tuple[float, float]], float, bool]:
        """Returns the samples of this round, the time of the last complete tick, and whether the end was clean."""
        path = self._folder / "observed"
        data = path.read_bytes()[self._offset :] if path.exists() else b""
        self._offset += len(data)
        lines = [line.split() for line in data.decode().splitlines()]
        samples = [(float(line[1]), float(line[2])) for line in lines if line[0] == "sample"]
        ticks = [float(line[1]) for line in lines if line[0] == "tick"]
        return samples, ticks[-1] if ticks else 0.0, ["closed"] in lines

    def _read_stored(self) -> dict[int, tuple[int, float, float, float]]:
        path = self._folder / "history.db"
        if not path.exists():
            return {}
        connection = sqlite3.connect(str(path))
        try:
            if not connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'samples'").fetchone():
                return {}  # killed before the tables were made
            assert connection.execute("PRAGMA quick_check").fetchone() == ("ok",)
            rows = connection.execute("SELECT start_s, good, least, most, last FROM samples WHERE signal = 'battery'")
            return {int(start_s // PERIOD_S): tuple(values) for start_s, *values in rows}  # type: ignore[misc]
        finally:
            connection.close()


def run(rounds: int, seed: int) -> tuple[list[str], dict[str, int]]:
    """Plays rounds until the first violation; returns the violations and what was counted."""
    with tempfile.TemporaryDirectory() as folder:
        return _play(rounds, seed, Path(folder))


def _play(rounds: int, seed: int, folder: Path) -> tuple[list[str], dict[str, int]]:
    chance = random.Random(seed)
    referee = Referee(folder)
    killed = 0
    for number in range(rounds):
        child_chance = random.Random(chance.random())
        ends = chance.random() < 0.1
        child = os.fork()
        if not child:
            try:
                _monitor(folder, referee.now_s, child_chance, child_chance.randrange(1, 40) if ends else float("inf"))
            finally:
                os._exit(0)
        if not ends:
            time.sleep(chance.random() * LONGEST_S)
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        killed += os.WIFSIGNALED(status)
        violations = referee.check()
        if violations:
            return [f"round {number}: {one}" for one in violations], {"rounds": number}
    return [], {"rounds": rounds, "killed": killed, **referee.counts}
