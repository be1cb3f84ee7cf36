"""Kills a monitor with a history at random moments, and checks after each kill what is in the file.

Required at any moment: nothing that was announced is missing from the history, nothing is announced twice, and every
latch is there. One process forks a monitor per round, which runs in virtual time as fast as it can, and kills it after
a random time, often while it is still starting. One round in ten ends by itself instead. The file is so small that old
entries are deleted meanwhile.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sqlite3
import tempfile
import time
from pathlib import Path
from typing import Any, Mapping, Sequence, Tuple

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store import history as history_module
from robot_health_monitor.ops.store.history import History

LONGEST_S = 0.08
"""Longest time until the kill: a monitor starts in about a quarter of it."""
ROUND_S = 100_000.0
"""Virtual time of one round."""
FLOAT32 = "std_msgs/Float32"
SIGNALS: Mapping[str, Mapping[str, Any]] = {
    "plain": {"warn_below": 20.0, "error_below": 10.0},
    "latching": {"warn_below": 20.0, "error_below": 10.0, "latch": True, "stale_after_s": 0.0},
    "slow": {"warn_below": 30.0, "hysteresis": 5.0, "for_s": 2.0, "keep_firing_for_s": 2.0},
    "flapping": {"warn_below": 50.0, "flap_detection": True},
    "silent": {"warn_below": 20.0, "stale_after_s": 3.0, "startup_grace_s": 4.0},
    "repeating": {"warn_below": 40.0, "repeat_s": 5.0},
}
SOURCES = tuple(f"/{name}" for name in SIGNALS)
"""Their topics: one that falls silent is announced itself, or through its one signal."""
LEVELS = ("OK", "WARN", "ERROR", "STALE")
Announced = Tuple[str, int, int, float]
"""Signal or source, levels from and to, and virtual time."""


def _monitor(folder: Path, start_s: float, chance: random.Random, steps: float) -> None:
    """Runs a monitor; appends a line to `announced` for each transition, and one before each reset."""
    log = os.open(folder / "announced", os.O_WRONLY | os.O_APPEND | os.O_CREAT)

    def note(event: Event) -> None:
        if isinstance(event, Transition):
            line = [event.signal, int(event.from_level), int(event.to_level), event.now_s]
            os.write(log, (json.dumps(line) + "\n").encode())

    # The time limit for the disk has its own tests; here, a busy machine must not look like a lost transition.
    history_module.COMMIT_TIMEOUT_S = 60.0
    bus = LocalBus(start_s=start_s, on_log=lambda line: None)
    node = bus.node("alert_system", parameters={"robot_name": "r1", "signals": SIGNALS})
    history = History(
        HistorySettings(str(folder / "history.db"), keep_days=1e4, keep_mb=1.0), lambda: bus.now_s, node.faults
    )
    system = AlertSystem(node, {"announced": note}, history=history.of_robot("r1"))
    robot = bus.node("robot")
    for name in SIGNALS:
        robot.advertise(name, FLOAT32)
    done = 0
    while done < steps:
        for name in SIGNALS:
            if chance.random() < (0.2 if name == "silent" else 0.9):
                robot.publish(name, {"data": chance.choice((5.0, 15.0, 25.0, 45.0, 60.0, 60.0, 60.0))})
        if chance.random() < 0.02:
            os.write(log, b'"reset"\n')
            bus.call_service("/alert_system/reset")
        bus.run_until(bus.now_s + 1.0)
        done += 1
    system.close()
    history.close(600.0)


class Referee:
    """Compares what was announced with the history, after each round."""

    def __init__(self, folder: Path) -> None:
        """Starts before the first round."""
        self._folder = folder
        self._offset = 0
        self._last_id = 0
        self._levels: dict[str, int] = dict.fromkeys((*SIGNALS, *SOURCES), 0)
        self._known_resets = 0
        self.counts = {"announced": 0, "stored, but killed before the announcement": 0, "latched at a kill": 0}

    def check(self, start_s: float) -> list[str]:
        """Returns the violations of a round that began at `start_s`, in virtual time."""
        announced, resets = self._read_announced()
        stored, states, known_resets = self._read_history()
        found: list[str] = []
        unannounced = list(stored)
        for line in announced:
            if line in unannounced:
                unannounced.remove(line)
            else:
                found.append(f"announced, but not in the history: {line}")
        if len(unannounced) > 1 or unannounced != stored[len(stored) - len(unannounced) :]:
            found.append(f"in the history, but not announced before the next one: {unannounced}")
        found += self._check_chains(stored, start_s, resets)
        for name, state in states.items():
            if _announced_level(name, state) != LEVELS[self._levels[name]]:
                found.append(f"{name}: the state to resume is {state}, announced was {LEVELS[self._levels[name]]}")
        found += [
            f"{name}: announced was {LEVELS[level]}, but there is no state to resume"
            for name, level in self._levels.items()
            if level and name not in states
        ]
        latch = states.get("latching", {}).get("latched", "OK")
        if latch != LEVELS[self._levels["latching"]] and not resets:
            found.append(f"the latch is {latch}, announced was {LEVELS[self._levels['latching']]}")
        if known_resets > resets:
            found.append(f"{known_resets} resets in the history, {resets} were requested")
        self.counts["announced"] += len(announced)
        self.counts["stored, but killed before the announcement"] += len(unannounced)
        self.counts["latched at a kill"] += latch != "OK"
        return found

    def _check_chains(self, stored: Sequence[Announced], start_s: float, resets: int) -> list[str]:
        """Each transition starts where the previous one of its signal ended, and a latch holds until a reset."""
        found: list[str] = []
        for name, before, after, now_s in stored:
            if now_s < start_s:
                found.append(f"{name}: stored in the round before")
            if before != self._levels[name]:
                found.append(f"{name}: goes from {LEVELS[before]}, but was {LEVELS[self._levels[name]]}")
            if before == after and name != "repeating":
                found.append(f"{name}: {LEVELS[after]} twice")
            if name == "latching" and after < before and not resets:
                found.append(f"the latch was lost: {LEVELS[before]} to {LEVELS[after]} without a reset")
            self._levels[name] = after
        return found

    def _read_announced(self) -> tuple[list[Announced], int]:
        """Returns what was announced in this round, and the number of resets."""
        path = self._folder / "announced"
        data = path.read_bytes()[self._offset :] if path.exists() else b""
        self._offset += len(data)
        lines = [json.loads(line) for line in data.decode().splitlines()]
        transitions = [tuple(line) for line in lines if line != "reset"]
        return transitions, len(lines) - len(transitions)

    def _read_history(self) -> tuple[list[Announced], dict[str, dict[str, Any]], int]:
        """Returns the transitions of this round, the states to resume, and the number of resets in this round."""
        path = self._folder / "history.db"
        if not path.exists():
            return [], {}, 0
        connection = sqlite3.connect(str(path))
        try:
            if not connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'transitions'").fetchone():
                return [], {}, 0  # killed before the tables were made
            query = "SELECT signal, from_level, to_level, now_s, id FROM transitions WHERE id > ? ORDER BY id"
            rows = connection.execute(query, (self._last_id,)).fetchall()
            self._last_id = rows[-1][4] if rows else self._last_id
            states = dict(connection.execute("SELECT signal, state FROM signal_states"))
            resets = connection.execute("SELECT count(*) FROM resets").fetchone()[0]
            new_resets, self._known_resets = resets - self._known_resets, resets
            assert connection.execute("PRAGMA quick_check").fetchone() == ("ok",)
        finally:
            connection.close()
        return [row[:4] for row in rows], {name: json.loads(state) for name, state in states.items()}, new_resets


def _announced_level(name: str, state: Mapping[str, Any]) -> str:
    """Returns the announced level of a state to resume.

    A source that is silent has a state even if it was never announced: what was, is its one signal or another source.
    Its own silence is announced if it speaks for itself.
    """
    level: str = state.get("announced", {}).get("level", "OK")
    if name not in SOURCES:
        return level
    speaks = state.get("silence", {}).get("speaks", False)
    return level if speaks == (level == "STALE") else f"{level}, speaks: {speaks}"


def run(rounds: int, seed: int) -> tuple[list[str], dict[str, int]]:
    """Plays rounds until the first violation; returns the violations and what was counted."""
    with tempfile.TemporaryDirectory() as folder:
        return _play(rounds, seed, Path(folder))


def _play(rounds: int, seed: int, folder: Path) -> tuple[list[str], dict[str, int]]:
    chance = random.Random(seed)
    referee = Referee(folder)
    killed = 0
    for number in range(rounds):
        start_s = number * ROUND_S
        child_chance = random.Random(chance.random())
        ends = chance.random() < 0.1
        child = os.fork()
        if not child:
            try:
                _monitor(folder, start_s, child_chance, 20 if ends else float("inf"))
            finally:
                os._exit(0)
        if not ends:
            time.sleep(chance.random() * LONGEST_S)
            os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        killed += os.WIFSIGNALED(status)
        violations = referee.check(start_s)
        if violations:
            return [f"round {number}: {one}" for one in violations], {"rounds": number}
    return [], {"rounds": rounds, "killed": killed, **referee.counts}
