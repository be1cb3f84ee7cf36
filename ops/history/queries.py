"""Queries of the history. Each takes a connection: that of a `HistoryReader`, or one inside `History.run`."""

from __future__ import annotations

import sqlite3
from typing import Any, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.model import Level

from .rows import TRANSITION_COLUMNS, StoredTransition, stored_transition, unpack_samples


class Gap(NamedTuple):
    """A time in which the monitor did not run."""

    from_s: float
    """When it stopped, or was last known to run, in s since 1970."""
    to_s: float
    """When it started again, in s since 1970."""
    was_killed: bool
    """True: it did not stop by itself (kill -9, power cut)."""


def transitions(
    connection: sqlite3.Connection,
    *,
    since_s: Optional[float] = None,
    until_s: Optional[float] = None,
    robot: Optional[str] = None,
    signal: Optional[str] = None,
    level: Optional[Level] = None,
    after_id: int = 0,
    before_id: Optional[int] = None,
    limit: Optional[int] = None,
    newest_first: bool = False,
) -> Iterator[StoredTransition]:
    """Yields transitions, by default in the order in which they happened.

    Args:
        connection: the database.
        since_s: not older, in s since 1970.
        until_s: older than this, in s since 1970.
        robot: those of this robot only; `*` and `?` work as in file names.
        signal: those of this signal only; `*` and `?` work as in file names.
        level: transitions to this level only.
        after_id: only those with a larger id.
        before_id: only those with a smaller id.
        limit: at most so many.
        newest_first: in reverse order; with a `limit`: the newest ones.
    """
    conditions: List[Tuple[str, Any]] = [("id > ?", after_id)] if after_id else []
    conditions += [] if before_id is None else [("id < ?", before_id)]
    conditions += [] if since_s is None else [("wall_s >= ?", since_s)]
    conditions += [] if until_s is None else [("wall_s < ?", until_s)]
    conditions += [] if robot is None else [pattern_condition("robot", robot)]
    conditions += [] if signal is None else [pattern_condition("signal", signal)]
    conditions += [] if level is None else [("to_level = ?", int(level))]
    where = " AND ".join(condition for condition, _ in conditions) or "1"
    order = "DESC" if newest_first else "ASC"
    query = f"SELECT id, {TRANSITION_COLUMNS} FROM transitions WHERE {where} ORDER BY id {order} LIMIT ?"
    for row in connection.execute(query, [*(value for _, value in conditions), -1 if limit is None else limit]):
        yield stored_transition(row)


def transition(connection: sqlite3.Connection, number: int) -> Optional[StoredTransition]:
    """Returns one transition by its id; None if there is none."""
    row = connection.execute(f"SELECT id, {TRANSITION_COLUMNS} FROM transitions WHERE id = ?", (number,)).fetchone()
    return None if row is None else stored_transition(row)


def evidence(connection: sqlite3.Connection, transition_id: int) -> Sequence[Tuple[float, float]]:
    """Returns the samples of the window at a transition: wall time in s since 1970, value (NaN: not a number)."""
    row = connection.execute("SELECT samples FROM evidence WHERE transition_id = ?", (transition_id,)).fetchone()
    return [] if row is None else unpack_samples(row[0])


def gaps(connection: sqlite3.Connection, since_s: float = 0.0) -> List[Gap]:
    """Returns the times in which the monitor did not run, oldest first.

    Args:
        connection: the database.
        since_s: gaps that ended before are left out, in s since 1970.
    """
    runs = connection.execute("SELECT started_s, alive_s, stopped_s FROM runs ORDER BY id").fetchall()
    found = [
        Gap(stopped_s or alive_s, next_run[0], stopped_s is None)
        for (_, alive_s, stopped_s), next_run in zip(runs, runs[1:])
    ]
    return [gap for gap in found if gap.to_s >= since_s]


def pattern_condition(column: str, pattern: str) -> Tuple[str, str]:
    """Returns an SQL condition with one parameter for a pattern as in file names.

    Args:
        column: name of the column.
        pattern: text in which `*` and `?` stand for any text and any character.
    """
    if "*" in pattern or "?" in pattern:
        return f"{column} GLOB ?", pattern.replace("[", "[[]")
    return f"{column} = ?", pattern
