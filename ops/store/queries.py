"""Queries of the history. Each takes a connection: that of `database_file.reading`, or one inside `History.run`."""

from __future__ import annotations

import math
from sqlite3 import Connection
from typing import Any, Dict, Iterator, List, NamedTuple, Sequence, Tuple

from ...core.judge import MAX_EVIDENCE
from ...core.values import Level, matches_pattern
from .rows import TRANSITION_COLUMNS, Rows, StoredTransition, Values, records, select, unpack_samples
from .schema import INDEX_STEP, INDEXED

_PAGE = 500
_ROUNDING_S = 0.001  # of the times of samples


def transitions(
    connection: Connection,
    *,
    since_s: float | None = None,
    robot: str | None = None,
    signal: str | None = None,
    level: Level | None = None,
    before_id: int | None = None,
    newest: int | None = None,
    open_only: bool = False,
) -> Iterator[StoredTransition]:
    """Yields transitions, by default in the order in which they happened.

    Args:
        connection: the database.
        since_s: not older, in s since 1970.
        robot: of this robot only; `*` and `?` work as in file names.
        signal: of this signal only, likewise.
        level: to this level only.
        before_id: only those with a smaller id.
        newest: so many of the newest at most, the newest first.
        open_only: only those to the present level of the alerts that are open.
    """
    # The unary plus keeps SQLite from sorting what an index on the time would find.
    where = f"""
        WHERE id BETWEEN :first AND :last AND {pattern_condition(connection, "robot", "signal")}
            AND (:since IS NULL OR +wall_s >= :since) AND (:level IS NULL OR to_level = :level)
            {"AND id IN (SELECT transition_id FROM open_alerts)" if open_only else ""}
        ORDER BY id {"ASC" if newest is None else "DESC"} LIMIT :page
    """
    first, last = number_range(connection, since_s)
    last = last if before_id is None else min(last, before_id - 1)
    values = {"since": since_s, "level": level, "robot": robot, "signal": signal, "last": last, "page": newest or _PAGE}
    while True:  # page by page: an open query would keep the writer's log from being shortened
        rows = _transitions(connection, where, {**values, "first": first})
        yield from rows
        if newest is not None or len(rows.raw) < _PAGE:
            return
        first = rows.raw[-1][0] + 1


def _transitions(connection: Connection, where: str, values: Values) -> Rows[StoredTransition]:
    return records(connection, "transitions", StoredTransition, where, values, TRANSITION_COLUMNS)


def number_range(connection: Connection, since_s: float | None) -> Tuple[int, int]:
    """Returns the first number that may be as new as `since_s`, and the last number."""
    # Apart: SQLite reads the whole table for both together.
    query = "SELECT (SELECT min(id) FROM transitions), (SELECT max(id) FROM transitions)"
    first, last = connection.execute(query).fetchone()
    if first is None:
        return 1, 0
    if since_s is not None:
        # The plus makes SQLite use the index, not walk through the rows until one fits.
        query = f"SELECT min(+id) FROM transitions WHERE {INDEXED} AND wall_s >= ?"
        (indexed,) = connection.execute(query, (since_s,)).fetchone()
        first = max(first, (last if indexed is None else indexed) - INDEX_STEP)
    return first, last


def transition(connection: Connection, number: int) -> StoredTransition | None:
    """Returns one transition by its id; None if there is none."""
    return next(iter(_transitions(connection, "WHERE id = ?", (number,))), None)


def ended_s(connection: Connection, alert: StoredTransition) -> float | None:
    """Returns when the alert of a transition ended, in s since 1970; None if it has not."""
    is_open = "EXISTS (SELECT 1 FROM open_alerts WHERE alert_id = :alert)"  # then there is no need to look for its end
    end = "id >= :id AND alert_id = :alert AND to_level = 0"
    query = f"SELECT wall_s FROM transitions WHERE NOT {is_open} AND {end} LIMIT 1"
    rows = select(connection, "transitions", (float,), query, {"id": alert.id, "alert": alert.alert_id})
    return rows[0][0] if rows else None


def read_states(connection: Connection, robot: str) -> Dict[str, Any]:
    """Returns the last state of each signal of a robot.

    One that is not a JSON object is the level that was announced last; None if that is unknown, too.
    """
    query = "SELECT signal, state FROM signal_states WHERE robot = ?"
    rows = select(connection, "signal_states", (str, dict), query, (robot,))
    states: Dict[str, Any] = dict(rows)
    query = "SELECT to_level FROM transitions WHERE robot = ? AND signal = ? AND NOT repeat ORDER BY id DESC LIMIT 1"
    for name in [row[0] for row in rows.raw if isinstance(row[0], str) and row[0] not in states]:
        levels = select(connection, "transitions", (Level,), query, (robot, name))
        states[name] = {"announced": {"level": levels[0][0].name}} if levels else None
    return states


def not_ok_at(connection: Connection, alert: StoredTransition, limit: int) -> List[StoredTransition]:
    """Returns the alerts of other signals of the robot that were open at an alert: the newest of each, newest first."""
    newest = "SELECT max(id) FROM transitions WHERE robot = ? AND id <= ? AND NOT repeat GROUP BY signal"
    where = f"WHERE id IN ({newest}) AND to_level != 0 AND signal != ? ORDER BY id DESC LIMIT ?"
    return _transitions(connection, where, (alert.robot, alert.id, alert.signal, limit))


def evidence(connection: Connection, transition_id: int) -> Sequence[Tuple[float, float]]:
    """Returns the samples of the window at a transition: wall time in s since 1970, value (NaN if it was no number).

    Samples that earlier transitions of the signal have, too, are stored with the earliest only.
    """
    query = "SELECT robot, signal, samples FROM transitions JOIN evidence ON transition_id = id WHERE"
    latest = connection.execute(f"{query} id = ?", (transition_id,)).fetchone() or ("", "", None)
    first_s = unpack_samples(latest[2])[0] - _ROUNDING_S
    first, _ = number_range(connection, first_s)  # the window's samples were not stored before its begin
    query = f"{query} id BETWEEN ? AND ? AND robot = ? AND signal = ? ORDER BY id DESC LIMIT ?"
    samples: List[Tuple[float, float]] = []
    for _, _, packed in connection.execute(query, (first, transition_id, *latest[:2], MAX_EVIDENCE)).fetchall():
        end_s = samples[0][0] if samples else math.inf
        samples[:0] = [sample for sample in unpack_samples(packed)[1] if first_s <= sample[0] < end_s]
    return samples


def gaps(connection: Connection, since_s: float = 0.0) -> Sequence[Tuple[float, float]]:
    """Returns the times in which the monitor did not run, oldest first, without those that ended before `since_s`.

    Each is from when it stopped, or was last known to run, to when it started again, in s since 1970.
    """
    # The present run has no end, and the wall clock may have been set back in the meantime.
    query = """
        SELECT from_s, to_s FROM (
            SELECT id, coalesce(stopped_s, alive_s) AS from_s, lead(started_s) OVER (ORDER BY id) AS to_s FROM runs
        ) WHERE to_s > from_s AND to_s >= ? ORDER BY id
    """
    return select(connection, "runs", (float, float), query, (since_s,))


def configuration(connection: Connection, robot: str, at_s: float) -> Dict[str, Any] | None:
    """Returns the configuration of a robot that was in force at a time in s since 1970, else its first one.

    It is what `Continuity.record_configuration` has stored; None if there is none.
    """
    query = """
        SELECT configuration_changes.id, text FROM configuration_changes JOIN configurations USING (hash)
        WHERE robot = :robot ORDER BY wall_s > :at_s, CASE WHEN wall_s > :at_s THEN configuration_changes.id
        ELSE -configuration_changes.id END LIMIT 1
    """
    rows = select(connection, "configuration_changes", (int, dict), query, {"robot": robot, "at_s": at_s})
    return rows[0][1] if rows else None


class MonitorEvent(NamedTuple):
    """An event of the monitor itself."""

    wall_s: float
    """When, in s since 1970."""
    kind: str
    """`started`, `stopped`, `killed`, `reset` or `configuration`."""
    robot: str
    """The robot; empty for the first three: all."""
    detail: str
    """The version of the software (`started`), the hash of the configuration; else empty."""


def monitor_events(connection: Connection, since_s: float = 0.0, robot: str | None = None) -> List[MonitorEvent]:
    """Returns starts and stops of the monitor, resets and changes of the configuration since then, by time.

    `robot`: resets and configurations of this robot only; `*` and `?` work as in file names.
    """
    condition = pattern_condition(connection, "robot")
    query = f"""
        SELECT wall_s, kind, robot, detail FROM (
            SELECT 0 AS rank, id, started_s AS wall_s, 'started' AS kind, '' AS robot, version AS detail FROM runs
            UNION ALL SELECT 0, id, coalesce(stopped_s, alive_s),
                CASE WHEN stopped_s IS NULL THEN 'killed' ELSE 'stopped' END, '', '' FROM runs
                WHERE stopped_s IS NOT NULL OR id < (SELECT max(id) FROM runs)
            UNION ALL SELECT 1, id, wall_s, 'reset', robot, '' FROM resets WHERE {condition}
            UNION ALL SELECT 2, id, wall_s, 'configuration', robot, hash FROM configuration_changes WHERE {condition}
        ) WHERE wall_s >= :since ORDER BY wall_s, rank, id, kind <> 'started'
    """
    rows = select(connection, "events", (float, str, str, str), query, {"since": since_s, "robot": robot})
    return [MonitorEvent(*row) for row in rows]


def pattern_condition(connection: Connection, *columns: str) -> str:
    """Returns an SQL condition: columns match the parameters of their names, of which NULL matches everything.

    The connection receives the function `matches_pattern`: SQLite's GLOB needs exponential time for some patterns.
    """
    connection.create_function("matches_pattern", 2, matches_pattern)
    condition = "(:{0} IS NULL OR {0} = :{0} OR (:{0} GLOB '*[*?]*' AND matches_pattern({0}, :{0})))"
    return " AND ".join(map(condition.format, columns))
