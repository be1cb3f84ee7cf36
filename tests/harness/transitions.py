"""A transition to write, and what the history does with it for the queue of notifications."""

from __future__ import annotations

import sqlite3
from typing import Any

from robot_health_monitor.core import Level, Status, Transition
from robot_health_monitor.ops.notify.notification_queue import NotificationQueue
from robot_health_monitor.ops.store.present_state import store_transition
from robot_health_monitor.ops.store.rows import transition_row


def transition(value: Any = 19.5, to_level: Level = Level.WARN, **fields: Any) -> Transition:
    known = {
        "signal": "battery_level",
        "from_level": Level.OK,
        "to_level": to_level,
        "value": value,
        "statistic": "last",
        "bound": 20.0,
        "now_s": 1000.0,
        "since_s": 688.0,
        "robot": "atlas",
        "fingerprint": "0123456789abcdef",
        "text": "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)",
        "status": Status("battery_level", to_level, "19.5 % is below 20 %", "atlas", {}),
    }
    return Transition(**{**known, **fields})


class StoredAlerts:
    """The open alerts of a database, for a queue without a history."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._connection = connection

    def record(self, queue: NotificationQueue, event: Transition, wall_s: float) -> None:
        """Stores a transition as the history does, as far as the queue is concerned."""
        _, alert = store_transition(self._connection, transition_row(event, wall_s), event, wall_s)
        queue.note(self._connection, event, alert, wall_s)
