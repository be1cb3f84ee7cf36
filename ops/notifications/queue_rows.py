"""Checks the rows of the queue: other programs and damage may have put anything into them."""

from __future__ import annotations

import json
import sqlite3
from typing import Container, Optional

from robot_health_monitor.core.model import Level

from ..history.checked_rows import is_count, is_level, is_number, is_text, is_time, skip

_STORE_OPEN = """
    INSERT OR IGNORE INTO open_alerts (fingerprint, robot, signal, level, at_s, transition_json)
    VALUES (?, ?, ?, ?, ?, ?)
"""


def is_transition(line: object) -> bool:
    """Whether a value is the JSON of a transition with all that the queue and the targets need."""
    try:
        transition = json.loads(line)  # type: ignore[arg-type]
    except (TypeError, ValueError, RecursionError):
        return False
    return (
        isinstance(transition, dict)
        and all(is_text(transition.get(name)) for name in ("robot", "signal", "fingerprint", "text"))
        and all(str(transition.get(name)) in Level.__members__ for name in ("from_level", "to_level"))
        and all(is_number(transition.get(name)) for name in ("now_s", "since_s"))
        and isinstance(transition.get("repeat"), bool)
        and isinstance(transition.get("hint", ""), str)
    )


_TABLES = (
    ("noted_transitions", {"id": is_count, "at_s": is_time, "transition_json": is_transition}, 1),
    (
        "open_alerts",
        {
            "fingerprint": is_text, "robot": is_text, "signal": is_text, "level": is_level, "at_s": is_time,
            "transition_json": is_transition,
        },
        1,
    ),
    (
        "notified",
        {
            "target": is_text, "fingerprint": is_text, "level": is_count, "since_s": is_time,
            "transition_json": is_transition,
        },
        2,
    ),
    (
        "notifications",
        {
            "id": is_count, "target": is_text, "fingerprint": is_text, "level": is_level, "at_s": is_time,
            "transition_json": is_transition, "attempts": is_count, "is_repeat": is_count,
        },
        1,
    ),
)  # fmt: skip
"""Tables, checks of their columns, and how many of the columns are the key."""


def delete_odd_rows(connection: sqlite3.Connection) -> None:
    """Deletes the rows with unexpected values, and notes them at the connection.

    Raises:
        sqlite3.Error: a table cannot be read.
    """
    lost = set()
    for table, checks, keys in _TABLES:
        rows = connection.execute(f"SELECT {', '.join(checks)} FROM {table}").fetchall()
        for row in rows:
            if all(check(value) for check, value in zip(checks.values(), row)):
                continue
            where = " AND ".join(f"{name} IS ?" for name in [*checks][:keys])
            connection.execute(f"DELETE FROM {table} WHERE {where}", row[:keys])
            skip(connection, table, row[0])
            if table == "open_alerts":
                lost.add(row[0])
    if lost:
        restore_open_alerts(connection, lost)


def restore_open_alerts(connection: sqlite3.Connection, keys: Optional[Container[object]] = None) -> None:
    """Takes alerts whose rows were lost as open if a target was sent that they are.

    Args:
        connection: the database.
        keys: the fingerprints of the alerts; None: all.
    """
    rows = connection.execute("SELECT fingerprint, since_s, transition_json FROM notified").fetchall()
    for key, since_s, line in rows:
        if is_transition(line) and (keys is None or key in keys):
            transition = json.loads(line)
            level = Level[transition["to_level"]]
            if level is not Level.OK:
                names = (transition["robot"], transition["signal"])
                connection.execute(_STORE_OPEN, (key, *names, int(level), since_s, line))
