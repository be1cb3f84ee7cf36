"""What notifications need of the history."""

from __future__ import annotations

import sqlite3
from typing import Callable, Protocol, TypeVar

from robot_health_monitor.core.model import Transition

Result = TypeVar("Result")

OnRecord = Callable[[sqlite3.Connection, int, Transition, float], None]
"""Receives the connection, the transition's id, the transition, and its wall time in s since 1970."""


class Database(Protocol):
    """`ops.history.History`, as far as it is used here."""

    def run(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float = ...) -> Result:
        """Runs a function in the writer thread, in a separate transaction.

        Raises:
            ServiceError: the database failed, or did not answer in time.
        """

    def on_record(self, hook: OnRecord) -> None:
        """Calls a function inside the transaction that stores a transition."""
