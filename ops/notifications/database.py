"""The database of the notifications: the history's, or one in memory once their tables in the history are damaged."""

from __future__ import annotations

import sqlite3
from typing import Callable, Optional, TypeVar

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Transition

from ..history import schema
from ..history.checked_rows import CheckedConnection
from ..history.copying import copy_state
from ..history.database_file import is_file_error
from ..history.history import History, OnRecord
from .queue_rows import delete_odd_rows, restore_open_alerts

Result = TypeVar("Result")

PART = "notification queue"
"""The part whose fault says that the queue is not in the history."""


class QueueDatabase:
    """The database of the queue. Everything runs in the history's writer thread, in either case."""

    def __init__(
        self, history: History, faults: Faults, on_replaced: Callable[[sqlite3.Connection, bool], None]
    ) -> None:
        """Uses the history.

        Args:
            history: where the queue is.
            faults: receives the fault that its tables there cannot be used; it lasts until the monitor is restarted.
            on_replaced: receives the database in memory that takes the place of the history, and whether it is unknown
                what the targets were sent.
        """
        self._history = history
        self._faults = faults
        self._on_replaced = on_replaced
        self._memory: Optional[sqlite3.Connection] = None
        self._history_connection: Optional[sqlite3.Connection] = None

    @property
    def history_connection(self) -> sqlite3.Connection:
        """The history's connection while a function runs: silences are there."""
        assert self._history_connection is not None
        return self._history_connection

    def run(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float = 5.0) -> Result:
        """Runs a function, as `History.run`. If the tables in the history fail, it runs in memory."""

        def use(connection: sqlite3.Connection) -> Result:
            self._history_connection = connection
            if self._memory is None:
                return function(connection)
            with schema.transaction(self._memory):
                return function(self._memory)

        try:
            return self._history.run(use, timeout_s)
        except ServiceError as error:
            cause = error.__cause__
            if not isinstance(cause, sqlite3.Error):
                raise
            if self._memory is not None:
                self._faults.report(PART, f"failed in memory, too: {cause}")
                raise
            lost = cause
            self._history.run(lambda connection: self._use_memory(connection, lost), timeout_s)
        except Exception:  # rows with unexpected values
            self._history.run(lambda connection: delete_odd_rows(self._memory or connection), timeout_s)
        return self._history.run(use, timeout_s)

    def on_record(self, hook: OnRecord) -> None:
        """Calls a function inside the transaction that stores a transition, as `History.on_record`."""

        def guarded(connection: sqlite3.Connection, number: int, transition: Transition, wall_s: float) -> None:
            if self._memory is None:
                try:
                    hook(connection, number, transition, wall_s)
                except sqlite3.Error as error:
                    if is_file_error(error):
                        raise  # the history replaces its file, and stores the transition again
                    self._use_memory(connection, error)
                else:
                    return
            assert self._memory is not None
            hook(self._memory, number, transition, wall_s)

        self._history.on_record(guarded)

    def _use_memory(self, connection: sqlite3.Connection, error: sqlite3.Error) -> None:
        """Goes on in memory with what can be read of the queue."""
        if self._memory is not None:
            return
        memory = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False, factory=CheckedConnection)
        schema.prepare(memory)
        copy_state(connection, memory, schema.QUEUE_TABLES)
        if not _is_readable(connection, "open_alerts"):
            restore_open_alerts(memory)
        self._on_replaced(memory, not _is_readable(connection, "notified"))
        self._memory = memory
        text = f"its tables in the history cannot be used ({error}): continuing in memory"
        self._faults.report(PART, text)


def _is_readable(connection: sqlite3.Connection, table: str) -> bool:
    try:
        connection.execute(f"SELECT fingerprint, level, transition_json FROM {table} LIMIT 1")
    except sqlite3.Error:
        return False
    return True
