"""The database of the notifications: the history's, or one in memory once their tables in the history are damaged.

Rows with unexpected values are deleted: other programs and damage may have put anything into them.
"""

from __future__ import annotations

import json
import sqlite3
from typing import Any, Callable, Container, Optional, TypeVar

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level, Transition

from ..history import schema
from ..history.database_file import is_file_error
from ..history.history import History, OnRecord
from ..history.rows import CheckedConnection, is_count, is_level, is_number, is_text, is_time, skip

Result = TypeVar("Result")

PART = "notification queue"  # its fault says that the queue is not in the history


class QueueDatabase:
    """The database of the queue. Everything runs in the history's writer thread, in either case."""

    def __init__(
        self, history: History, faults: Faults, on_replaced: Callable[[sqlite3.Connection, bool], None]
    ) -> None:
        """Uses the history. That its tables there cannot be used is a fault until the monitor is restarted.

        Then `on_replaced` receives the database in memory, and whether it is unknown what the targets were sent.
        """
        self._history = history
        self._faults = faults
        self._on_replaced = on_replaced
        self._memory: Optional[sqlite3.Connection] = None
        self.history_connection: sqlite3.Connection
        """The history's connection, while a function runs: silences are there."""

    def run(self, function: Callable[..., Result], *arguments: Any) -> Result:
        """Runs `function(connection, *arguments)` as `History.run`. If the tables there fail, it runs in memory.

        Raises ServiceError if the database failed, or did not answer in time.
        """

        def use(connection: sqlite3.Connection) -> Result:
            self.history_connection = connection
            if self._memory is None:
                return function(connection, *arguments)
            with schema.transaction(self._memory):
                return function(self._memory, *arguments)

        try:
            return self._history.run(use)
        except ServiceError as error:
            cause = error.__cause__
            if not isinstance(cause, sqlite3.Error):
                raise
            if self._memory is not None:
                self._faults.report(PART, f"failed in memory, too: {cause}")
                raise
            lost = cause
            self._history.run(lambda connection: self._use_memory(connection, lost))
        except Exception:  # rows with unexpected values
            self._history.run(lambda connection: delete_odd_rows(self._memory or connection))
        return self._history.run(use)

    def on_record(self, hook: OnRecord) -> None:
        """Calls a function inside the transaction that stores a transition, as `History.on_record`."""

        def guarded(connection: sqlite3.Connection, number: int, transition: Transition, wall_s: float) -> None:
            if self._memory is None:
                try:
                    return hook(connection, number, transition, wall_s)
                except sqlite3.Error as error:
                    if is_file_error(error):
                        raise  # the history replaces its file, and stores the transition again
                    self._use_memory(connection, error)
            assert self._memory is not None
            return hook(self._memory, number, transition, wall_s)

        self._history.on_record(guarded)

    def _use_memory(self, connection: sqlite3.Connection, error: sqlite3.Error) -> None:
        """Goes on in memory with what can be read of the queue."""
        if self._memory is not None:
            return
        memory = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False, factory=CheckedConnection)
        schema.prepare(memory)
        schema.copy_state(connection, memory, schema.QUEUE_TABLES)
        if not _is_readable(connection, "open_alerts"):
            restore_open_alerts(memory)
        self._on_replaced(memory, not _is_readable(connection, "notified"))
        self._memory = memory
        self._faults.report(PART, f"its tables in the history cannot be used ({error}): continuing in memory")


def _is_readable(connection: sqlite3.Connection, table: str) -> bool:
    try:
        connection.execute(f"SELECT fingerprint, level, transition_json FROM {table} LIMIT 1")
    except sqlite3.Error:
        return False
    return True


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
        and isinstance(transition.get("black_box", ""), str)
    )


_CHECKS = {
    "id": is_count, "target": is_text, "fingerprint": is_text, "robot": is_text, "signal": is_text, "level": is_level,
    "at_s": is_time, "since_s": is_time, "transition_json": is_transition, "attempts": is_count, "is_repeat": is_count,
}  # fmt: skip
_TABLES = {
    "noted_transitions": ("id", "at_s", "transition_json"),
    "open_alerts": ("fingerprint", "robot", "signal", "level", "at_s", "transition_json"),
    "notified": ("target", "fingerprint", "level", "since_s", "transition_json"),
    "notifications": ("id", "target", "fingerprint", "level", "at_s", "transition_json", "attempts", "is_repeat"),
}
"""The columns of each table; the first is its key, of `notified` the first two are."""


def delete_odd_rows(connection: sqlite3.Connection) -> None:
    """Deletes rows with unexpected values, noting them at the connection; sqlite3.Error: a table cannot be read."""
    lost = set()
    for table, columns in _TABLES.items():
        key = columns[: 2 if table == "notified" else 1]
        where = " AND ".join(f"{name} IS ?" for name in key)
        for row in connection.execute(f"SELECT {', '.join(columns)} FROM {table}").fetchall():
            if not all(_CHECKS[name](value) for name, value in zip(columns, row)):
                connection.execute(f"DELETE FROM {table} WHERE {where}", row[: len(key)])
                skip(connection, table, row[0])
                if table == "open_alerts":
                    lost.add(row[0])
    if lost:
        restore_open_alerts(connection, lost)


def restore_open_alerts(connection: sqlite3.Connection, keys: Optional[Container[object]] = None) -> None:
    """Takes alerts whose rows were lost (`keys`: their fingerprints; None: all) as open if a target was sent that."""
    insert = """
        INSERT OR IGNORE INTO open_alerts (fingerprint, robot, signal, level, at_s, transition_json)
        VALUES (?, ?, ?, ?, ?, ?)
    """
    query = "SELECT fingerprint, since_s, transition_json FROM notified"
    for key, since_s, line in connection.execute(query).fetchall():
        if is_transition(line) and (keys is None or key in keys):
            transition = json.loads(line)
            level = Level[transition["to_level"]]
            if level is not Level.OK:
                row = (key, transition["robot"], transition["signal"], int(level), since_s, line)
                connection.execute(insert, row)
