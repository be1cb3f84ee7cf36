"""Alerts, a wall clock that can be set, and changes of a history file by another process, for tests of silences."""

from __future__ import annotations

import sqlite3
from typing import Callable, Collection

from robot_health_monitor.core import Level
from robot_health_monitor.core.values.model import Status, Transition
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.silences import Alert, Silence

NOON_S = 1_763_812_800.0
"""2025-11-22 12:00 UTC."""


class Clock:
    """A wall clock that can be set."""

    def __init__(self) -> None:
        self.now_s = NOON_S

    def __call__(self) -> float:
        return self.now_s


def change(robot: str, signal: str, to_level: Level, from_level: Level = Level.OK) -> Transition:
    status = Status(signal, to_level, "", robot, {})
    return Transition(
        signal=signal, from_level=from_level, to_level=to_level, value=1.0, statistic="last", bound=None, now_s=1.0,
        since_s=0.0, robot=robot, fingerprint="f", text=f"{signal} {to_level.name}", status=status,
    )  # fmt: skip


def announce(history: History, robot: str, signal: str, to_level: Level, from_level: Level = Level.OK) -> None:
    """Stores a transition as alert_system does."""
    saved = {"announced": {"level": to_level.name}}
    history.of_robot(robot).record(change(robot, signal, to_level, from_level), saved, [])


def on_file(history: History, function: Callable[[sqlite3.Connection], object]) -> None:
    """Changes the file as another process does."""
    assert history.file is not None
    connection = sqlite3.connect(history.file, timeout=5.0)
    with connection:
        function(connection)
    connection.close()


class FixedSilences(Silences):
    """Silences of the alerts that a test names, without a history."""

    def __init__(self, alerts: Collection[Alert] = ()) -> None:
        self.alerts = alerts

    def silence_of(self, robot: str, signal: str) -> Silence | None:
        is_silenced = (robot, signal) in self.alerts
        return Silence(1, "robot=*", "", "", 0.0) if is_silenced else None

    def look(self, connection: sqlite3.Connection) -> None:
        """No other process changes these."""
