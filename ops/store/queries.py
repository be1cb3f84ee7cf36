"""Queries of the history. Each takes a connection: that of `database_file.reading`, or one inside `History.run`."""

from __future__ import annotations

import json
import math
import sqlite3
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ...core.judge.continuity import MAX_EVIDENCE
from ...core.values.model import Level
from ...core.values.patterns import matches_pattern
from .rows import (  # fmt: skip
    TRANSITION_COLUMNS,
    StoredTransition,
    checked,
    is_count,
    is_json_object,
    is_level,
    is_text,
    is_time,
    optional,
    read_rows,
    skip,
    unpack_samples,
)
from .schema import INDEX_STEP, INDEXED

_PAGE = 500
_ROUNDING_S = 0.001  # of the times of samples


class Gap(NamedTuple):
    """A time in which the monitor did not run."""

    from_s: float
    """When it stopped, or was last known to run, in s since 1970."""
    to_s: float
    """When it started again, in s since 1970."""


def transitions(
    connection: sqlite3.Connection,
    *,
    since_s: Optional[float] = None,
    robot: Optional[str] = None,
    signal: Optional[str] = None,
    level: Optional[Level] = None,
    before_id: Optional[int] = None,
    limit: Optional[int] = None,
    newest_first: bool = False,
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
        limit: at most so many.
        newest_first: in reverse order; with a `limit`: the newest ones.
        open_only: only those to the present level of the alerts that are open.
    """
    # The unary plus keeps SQLite from sorting what an index on the time would find (of files of earlier versions).
    conditions: List[Tuple[str, List[Any]]] = [
        ("+wall_s >= ?" if since_s is not None else "1", [since_s] if since_s is not None else []),
        ("to_level = ?" if level is not None else "1", [int(level)] if level is not None else []),
        pattern_condition(connection, "robot", robot),
        pattern_condition(connection, "signal", signal),
        ("id IN (SELECT transition_id FROM open_alerts)" if open_only else "1", []),
    ]
    where = " AND ".join(condition for condition, _ in conditions)
    values = [value for _, values in conditions for value in values]
    order = "DESC" if newest_first else "ASC"
    where = f"id BETWEEN ? AND ? AND {where} ORDER BY id {order} LIMIT ?"
    query = f"SELECT id, {TRANSITION_COLUMNS} FROM transitions WHERE {where}"
    first, last = number_range(connection, since_s)
    last = last if before_id is None else min(last, before_id - 1)
    # Page by page: an open query would keep the writer's log from being shortened.
    while limit is None or limit > 0:
        page = _PAGE if limit is None else min(_PAGE, limit)
        rows = connection.execute(query, [first, last, *values, page]).fetchall()
        yield from read_rows(connection, "transitions", rows, StoredTransition)
        if len(rows) < page:
            break
        limit = None if limit is None else limit - page
        if newest_first:
            last = rows[-1][0] - 1
        else:
            first = rows[-1][0] + 1


def number_range(connection: sqlite3.Connection, since_s: Optional[float]) -> Tuple[int, int]:
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


def transition(connection: sqlite3.Connection, number: int) -> Optional[StoredTransition]:
    """Returns one transition by its id; None if there is none."""
    rows = connection.execute(f"SELECT id, {TRANSITION_COLUMNS} FROM transitions WHERE id = ?", (number,)).fetchall()
    found = [*read_rows(connection, "transitions", rows, StoredTransition)]
    return found[0] if found else None


def ended_s(connection: sqlite3.Connection, alert: StoredTransition) -> Optional[float]:
    """Returns when the alert of a transition ended, in s since 1970; None if it has not."""
    is_open = "EXISTS (SELECT 1 FROM open_alerts WHERE alert_id = :alert)"  # then there is no need to look for its end
    end = "id >= :id AND alert_id = :alert AND to_level = 0"
    query = f"SELECT wall_s FROM transitions WHERE NOT {is_open} AND {end} LIMIT 1"
    row = connection.execute(query, {"id": alert.id, "alert": alert.alert_id}).fetchone()
    return None if row is None or not is_time(row[0]) else float(row[0])


def read_states(connection: sqlite3.Connection, robot: str) -> Dict[str, Any]:
    """Returns the last state of each signal of a robot.

    One that is not a JSON object is the level that was announced last; None if that is unknown, too.
    """
    states: Dict[str, Any] = {}
    damaged = []
    for signal, state in connection.execute("SELECT signal, state FROM signal_states WHERE robot = ?", (robot,)):
        if is_json_object(state) and is_text(signal):
            states[signal] = json.loads(state)
        else:
            skip(connection, "signal_states", signal)
            damaged.append(signal)
    if damaged:
        query = "SELECT signal, to_level, max(id) FROM transitions WHERE robot = ? AND repeated = 0 GROUP BY signal"
        levels = {name: level for name, level, _ in connection.execute(query, (robot,)) if is_level(level)}
        for signal in filter(is_text, damaged):
            states[signal] = {"announced": {"level": Level(levels[signal]).name}} if signal in levels else None
    return states


def black_boxes_of_open_alerts(connection: sqlite3.Connection, robot: str) -> Dict[str, str]:
    """Returns the name of the file that records each open alert of a robot, by signal."""
    ids = "SELECT transition_id FROM open_alerts WHERE robot = ?"
    query = f"SELECT signal, black_box FROM transitions WHERE id IN ({ids}) AND black_box != ''"
    rows = connection.execute(query, (robot,)).fetchall()
    return {signal: name for signal, name in rows if is_text(signal) and is_text(name)}


def not_ok_at(connection: sqlite3.Connection, alert: StoredTransition, limit: int) -> List[StoredTransition]:
    """Returns the alerts of other signals of the robot that were open at an alert: the newest of each, newest first."""
    newest = "SELECT max(id) FROM transitions WHERE robot = ? AND id <= ? AND repeated = 0 GROUP BY signal"
    where = f"id IN ({newest}) AND to_level != 0 AND signal != ? ORDER BY id DESC LIMIT ?"
    query = f"SELECT id, {TRANSITION_COLUMNS} FROM transitions WHERE {where}"
    rows = connection.execute(query, (alert.robot, alert.id, alert.signal, limit)).fetchall()
    return [*read_rows(connection, "transitions", rows, StoredTransition)]


def evidence(connection: sqlite3.Connection, transition_id: int) -> Sequence[Tuple[float, float]]:
    """Returns the samples of the window at a transition: wall time in s since 1970, value (NaN: not a number).

    Samples that earlier transitions of the signal have, too, are stored with the earliest only.
    """
    query = "SELECT robot, signal, samples FROM transitions JOIN evidence ON transition_id = id WHERE"
    latest = connection.execute(f"{query} id = ?", (transition_id,)).fetchone()
    window = None if latest is None else unpack_samples(latest[2])
    if window is None:
        return []
    first_s = window.first_s
    first, _ = number_range(connection, first_s - _ROUNDING_S)  # the window's samples were not stored before its begin
    query = f"{query} id BETWEEN ? AND ? AND robot = ? AND signal = ? ORDER BY id DESC LIMIT ?"
    rows = connection.execute(query, (first, transition_id, *latest[:2], MAX_EVIDENCE))
    found: List[Tuple[float, float]] = []
    for _, _, packed in rows:
        part = unpack_samples(packed)
        if part is None:
            break
        end_s = found[0][0] if found else math.inf
        found[:0] = [sample for sample in part.samples if first_s - _ROUNDING_S <= sample[0] < end_s]
        if part.is_complete or (part.samples and part.samples[0][0] <= first_s):
            break
    rows.close()
    return found


def gaps(connection: sqlite3.Connection, since_s: float = 0.0) -> List[Gap]:
    """Returns the times in which the monitor did not run, oldest first, without those that ended before `since_s`."""
    runs = _runs(connection)
    found = [Gap(stopped_s or alive_s, next_run[1]) for (_, _, alive_s, stopped_s, _), next_run in zip(runs, runs[1:])]
    # The wall clock may have been set back in the meantime.
    return [gap for gap in found if gap.to_s > gap.from_s and gap.to_s >= since_s]


def _runs(connection: sqlite3.Connection) -> List[Tuple[int, float, float, Optional[float], str]]:
    """Returns id, begin, last sign of life, end and version of each run."""
    rows = connection.execute("SELECT id, started_s, alive_s, stopped_s, version FROM runs ORDER BY id").fetchall()
    checks = (is_count, is_time, is_time, optional(is_time), is_text)
    return [*checked(connection, "runs", rows, checks)]


def configuration(connection: sqlite3.Connection, robot: str, at_s: float) -> Optional[Dict[str, Any]]:
    """Returns the configuration of a robot that was in force at a time in s since 1970, else its first one.

    It is what `Continuity.record_configuration` has stored; None: there is none.
    """
    query = """
        SELECT configuration_changes.id, text FROM configuration_changes JOIN configurations USING (hash)
        WHERE robot = :robot ORDER BY wall_s > :at_s, CASE WHEN wall_s > :at_s THEN configuration_changes.id
        ELSE -configuration_changes.id END LIMIT 1
    """
    rows = connection.execute(query, {"robot": robot, "at_s": at_s}).fetchall()
    for _, text in checked(connection, "configuration_changes", rows, (is_count, is_json_object)):
        found: Dict[str, Any] = json.loads(text)
        return found
    return None


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


def monitor_events(
    connection: sqlite3.Connection, since_s: float = 0.0, robot: Optional[str] = None
) -> List[MonitorEvent]:
    """Returns starts and stops of the monitor, resets and changes of the configuration since then, by time.

    `robot`: resets and configurations of this robot only; `*` and `?` work as in file names.
    """
    events = []
    runs = _runs(connection)
    for number, (_, started_s, alive_s, stopped_s, version) in enumerate(runs, 1):
        events.append(MonitorEvent(started_s, "started", "", version))
        if stopped_s is not None:
            events.append(MonitorEvent(stopped_s, "stopped", "", ""))
        elif number < len(runs):
            events.append(MonitorEvent(alive_s, "killed", "", ""))
    condition, values = pattern_condition(connection, "robot", robot)
    for table, kind, column in (("resets", "reset", "''"), ("configuration_changes", "configuration", "hash")):
        query = f"SELECT id, wall_s, robot, {column} FROM {table} WHERE {condition} ORDER BY id"
        rows = connection.execute(query, values).fetchall()
        for _, wall_s, name, detail in checked(connection, table, rows, (is_count, is_time, is_text, is_text)):
            events.append(MonitorEvent(wall_s, kind, name, detail))
    return sorted((event for event in events if event.wall_s >= since_s), key=lambda event: event.wall_s)


def pattern_condition(connection: sqlite3.Connection, column: str, pattern: Optional[str]) -> Tuple[str, List[Any]]:
    """Returns an SQL condition on a column, and its parameters; pattern None: everything matches.

    The connection receives the function `matches_pattern`: SQLite's GLOB needs exponential time for some patterns.
    """
    if pattern is None:
        return "1", []
    if "*" not in pattern and "?" not in pattern:
        return f"{column} = ?", [pattern]
    connection.create_function("matches_pattern", 2, matches_pattern)
    return f"matches_pattern({column}, ?)", [pattern]
