"""Deletes the oldest entries of a history, a few at a time, so that a transition never waits for it."""

from __future__ import annotations

import sqlite3
from typing import Optional

_MAX_ROWS = 200  # per call and table
_MAX_PAGES = 100  # given back to the file system per call
_TRUSTED_STEP_S = 3600.0
_DISTRUST_S = 86_400.0

_EXPIRED = """
SELECT id, wall_s FROM transitions AS old
WHERE {condition} AND NOT (to_level <> 0 AND id = (
    SELECT id FROM transitions
    WHERE robot = old.robot AND signal = old.signal AND repeated = 0 ORDER BY id DESC LIMIT 1
))
ORDER BY id LIMIT {limit}
"""
"""The oldest transitions without those that began an alert that is still open."""

_OTHERS = (
    ("runs", "coalesce(stopped_s, alive_s) < :before_s AND id < :run_id"),
    ("watches", "run_id < (SELECT min(id) FROM runs)"),
    ("resets", "wall_s < :before_s"),
    (
        "configuration_changes",
        "wall_s < :before_s AND id NOT IN (SELECT max(id) FROM configuration_changes GROUP BY robot)",
    ),
)
"""The other tables of the past, with what may be deleted."""


class AgeClock:
    """Wall time for the age of entries. A step forward by more than an hour counts only once it has lasted a day.

    Otherwise a clock that is wrong by years for a minute would delete the whole history.
    """

    def __init__(self, known_s: float, boot_s: float) -> None:
        """Starts.

        Args:
            known_s: the latest wall time that is known, such as that of the previous run, in s since 1970.
            boot_s: monotonic seconds.
        """
        self._reference_s = known_s
        self._boot_s = boot_s
        self._step_at_s: Optional[float] = None

    def now_s(self, wall_s: float, boot_s: float) -> float:
        """Returns the time for ages, in s since 1970.

        Args:
            wall_s: what the wall clock shows, in s since 1970.
            boot_s: monotonic seconds.
        """
        expected_s = self._reference_s + boot_s - self._boot_s
        is_ahead = wall_s > expected_s + _TRUSTED_STEP_S
        if not is_ahead:
            self._step_at_s = None
        elif self._step_at_s is None:
            self._step_at_s = boot_s
        elif boot_s - self._step_at_s >= _DISTRUST_S:
            is_ahead, self._step_at_s = False, None
        self._reference_s, self._boot_s = (expected_s if is_ahead else wall_s), boot_s
        return self._reference_s


def delete_expired(connection: sqlite3.Connection, run_id: int, before_s: float, max_bytes: float) -> bool:
    """Deletes some of the entries that are too old, or the oldest ones if there are too many.

    The state of signals, open alerts, and the tables of notifications and silences stay.

    Args:
        connection: inside a transaction.
        run_id: the present run, which stays.
        before_s: older entries are deleted, in s since 1970.
        max_bytes: the limit for the database, in bytes.

    Returns:
        Whether there may be more to delete.
    """
    is_too_large = used_bytes(connection) > max_bytes
    condition = "1" if is_too_large else "wall_s < :before_s"
    query = _EXPIRED.format(condition=condition, limit=_MAX_ROWS)
    expired = connection.execute(query, {"before_s": before_s}).fetchall()
    connection.executemany("DELETE FROM evidence WHERE transition_id = ?", [(number,) for number, _ in expired])
    connection.executemany("DELETE FROM transitions WHERE id = ?", [(number,) for number, _ in expired])
    if is_too_large and expired:
        before_s = max(before_s, expired[-1][1])
    deleted = len(expired)
    for table, others in _OTHERS:
        # What is left when there are no transitions: a monitor that is restarted again and again.
        if is_too_large and not expired and table == "runs":
            others = "id < :run_id"
        selected = f"SELECT id FROM {table} WHERE {others} ORDER BY id LIMIT {_MAX_ROWS}"
        statement = f"DELETE FROM {table} WHERE id IN ({selected})"
        deleted += connection.execute(statement, {"before_s": before_s, "run_id": run_id}).rowcount
    if deleted:
        connection.execute("DELETE FROM configurations WHERE hash NOT IN (SELECT hash FROM configuration_changes)")
    if _pages(connection, "page_count") * _pages(connection, "page_size") > max_bytes:
        connection.execute(f"PRAGMA incremental_vacuum({_MAX_PAGES})").fetchall()
    return deleted > 0


def used_bytes(connection: sqlite3.Connection) -> int:
    """Returns the size of the database without its unused pages, in bytes."""
    used = _pages(connection, "page_count") - _pages(connection, "freelist_count")
    return used * _pages(connection, "page_size")


def _pages(connection: sqlite3.Connection, name: str) -> int:
    value: int = connection.execute(f"PRAGMA {name}").fetchone()[0]
    return value
