"""The stored samples: how each signal developed between its alerts.

One row per signal and 10 s, of `core.sample_summary`. After two days they are merged into 5 minutes: the smallest and
the largest value stay exactly. A row may be stored in parts, and a restarted monitor continues the one that was open.
"""

from __future__ import annotations

from sqlite3 import Connection
from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Optional, Sequence, Tuple, get_type_hints

from ...core.config import LATEST_S
from ...core.judge import PERIOD_S
from ...core.values import Level
from ...runtime.times import iso_time
from .queries import pattern_condition
from .rows import Rows, records, select

MERGED_S = 300.0
"""Length of the periods into which old ones are merged, in s."""
FINE_S = 2.0 * 86_400.0
"""Age at which they are merged, in s."""

_STEP_S = 3600.0
_MOST_ROWS = 300  # merged per step of the upkeep: 200 robots of ten signals store 200 per second
_MOST_DELETED = 4_000  # 50 bytes each: as much as a transaction of the writer adds
_LEAST_FINE_S = 3600.0
_PAGE = 2_000
_OF_SIGNAL = "robot = ? AND signal = ?"
_SEVERITY = "CASE {0} WHEN 2 THEN 3 WHEN 3 THEN 2 ELSE {0} END"  # OK, WARN, STALE, ERROR; and back to the level
_WORST = f"max({_SEVERITY.format('level')}, {_SEVERITY.format('excluded.level')})"

# The mean of two parts is kept between theirs: it may be rounded.
_STORE = f"""
    INSERT INTO samples VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
    ON CONFLICT (robot, signal, start_s) DO UPDATE SET
        least = coalesce(min(least, excluded.least), least, excluded.least),
        most = coalesce(max(most, excluded.most), most, excluded.most),
        mean = coalesce(
            min(max(mean, excluded.mean), max(min(mean, excluded.mean), mean * (1.0 * good / (good + excluded.good))
                + excluded.mean * (1.0 * excluded.good / (good + excluded.good)))), mean, excluded.mean),
        last = coalesce(excluded.last, last), good = good + excluded.good, bad = bad + excluded.bad,
        level = {_SEVERITY.format(_WORST)}
"""
"""Stores samples; those of a period that is stored already are joined with it."""

MOST_COARSE = 2_000
"""Most periods that `read_coarse` returns."""

_SCALE = 2.0**-60  # a sum of values near the largest double would be infinite

# `last` is that of the latest period.
_COARSE = f"""
    SELECT :robot, :signal, number * :seconds AS start_s, max(:seconds, longest), least, most, mean,
        (SELECT last FROM samples WHERE robot = :robot AND signal = :signal AND start_s = newest_s), good, bad,
        {_SEVERITY.format("level")}
    FROM (
        SELECT CAST(start_s / :seconds AS INTEGER) AS number, min(least) AS least, max(most) AS most,
            min(max(mean), max(min(mean),
                sum(mean * {_SCALE} * good) / sum(CASE WHEN mean IS NOT NULL THEN good END) / {_SCALE})) AS mean,
            max(CASE WHEN last IS NOT NULL THEN start_s END) AS newest_s, sum(good) AS good, sum(bad) AS bad,
            max(seconds) AS longest, max({_SEVERITY.format("level")}) AS level
        FROM samples
        WHERE robot = :robot AND signal = :signal AND start_s > :since AND start_s < :until
        GROUP BY number ORDER BY number DESC LIMIT :most
    )
"""

# From each robot to the next, and then from each of its signals: DISTINCT would read every row.
_SERIES = """
    WITH RECURSIVE robots (robot) AS (
        SELECT min(robot) FROM samples
        UNION ALL SELECT (SELECT min(robot) FROM samples WHERE robot > robots.robot) FROM robots WHERE robot IS NOT NULL
    ), series (robot, signal) AS (
        SELECT robot, (SELECT min(signal) FROM samples WHERE robot = robots.robot) FROM robots WHERE robot IS NOT NULL
        UNION ALL SELECT robot, (SELECT min(signal) FROM samples WHERE robot = series.robot AND signal > series.signal)
        FROM series WHERE signal IS NOT NULL
    )
    SELECT robot, signal FROM series WHERE signal IS NOT NULL
"""

CELL_S = 900.0
"""Length of the cells in which the worst level of each robot is kept, in s."""

_NOTE_LEVEL = """
    INSERT INTO robot_levels (robot, start_s, level, severity) VALUES (?, ?, ?, ?)
    ON CONFLICT (robot, start_s) DO UPDATE SET level = excluded.level, severity = excluded.severity
    WHERE excluded.severity > severity
"""

_Series = Tuple[str, str]
"""Robot and signal."""


class StoredSamples(NamedTuple):
    """The samples of a signal in one period; the fields are the columns of the table `samples`."""

    robot: str
    signal: str
    start_s: float
    """Begin of the period, in s since 1970."""
    seconds: float
    """Its length: 10 or 300."""
    least: Optional[float]
    """As the fields of `SampleSummary` of the same names, down to `level`."""
    most: Optional[float]
    mean: Optional[float]
    last: Optional[float]
    good: int
    bad: int
    level: Level


SAMPLES_FIELDS = ("robot", "signal", "start", "seconds", "min", "max", "mean", "last", "good", "bad", "level")
"""Names of the fields for users, in the order of those of `StoredSamples`."""


def samples_fields(samples: StoredSamples) -> Dict[str, Any]:
    """Returns samples as JSON values, for users: the begin as ISO 8601, the level by its name."""
    robot, signal, start_s, *values, level = samples
    return dict(zip(SAMPLES_FIELDS, (robot, signal, iso_time(start_s), *values, level.name)))


def store(connection: Connection, samples: Iterable[StoredSamples]) -> None:
    """Stores samples; those of a period that is stored already are joined with it. Inside a transaction."""
    for each in samples:
        connection.execute(_STORE, each)
        cell = each.robot, each.start_s // CELL_S * CELL_S
        connection.execute(_NOTE_LEVEL, (*cell, each.level, each.level.severity))


def read(
    connection: Connection,
    *,
    robot: str | None = None,
    signal: str | None = None,
    since_s: float | None = None,
    until_s: float | None = None,
) -> Iterator[StoredSamples]:
    """Yields samples by robot, signal and time.

    Args:
        connection: the database.
        robot: of this robot only; `*` and `?` work as in file names.
        signal: of this signal only, likewise.
        since_s: only periods that end after this time, in s since 1970.
        until_s: only periods that begin before this time.
    """
    for series in _series(connection, robot, signal):
        after_s = -LATEST_S if since_s is None else since_s - MERGED_S
        while True:  # page by page: an open query would keep the writer's log from being shortened
            values = (after_s, LATEST_S if until_s is None else until_s)
            rows = _rows(connection, series, "start_s > ? AND start_s < ?", values, _PAGE)
            yield from (each for each in rows if since_s is None or each.start_s + each.seconds > since_s)
            if not rows.raw:
                break
            after_s = rows.raw[-1][2]


def read_coarse(
    connection: Connection, robot: str, signal: str, since_s: float, until_s: float, seconds: float
) -> List[StoredSamples]:
    """Returns the samples of one signal in longer periods; smallest and largest values stay exactly.

    A period that was stored belongs to the one in which it begins; `seconds` of the result is its length if that is
    longer than asked. At most `MOST_COARSE` are returned, the newest.

    Args:
        connection: the database.
        robot: the robot.
        signal: the signal.
        since_s: only periods that end after this time, in s since 1970.
        until_s: only periods that begin before this time.
        seconds: length of the periods.
    """
    values = {"robot": robot, "signal": signal, "since": since_s - seconds, "until": until_s, "seconds": seconds,
              "most": MOST_COARSE}  # fmt: skip
    types = get_type_hints(StoredSamples).values()
    return select(connection, "samples", types, _COARSE, values, StoredSamples._make)[::-1]


def read_levels(connection: Connection, since_s: float) -> Sequence[Tuple[Any, ...]]:
    """Returns robot, begin and worst level of each cell of `CELL_S` that begins at a time or later; at most two days.

    Times are in s since 1970. There is no cell for a time in which nothing was known.
    """
    query = "SELECT robot, start_s, level FROM robot_levels WHERE start_s >= ?"
    return select(connection, "robot_levels", (str, float, Level), query, (since_s,))


class SampleUpkeep:
    """Merges and deletes the samples of one database, some rows at a time. Call inside a transaction."""

    def __init__(self, connection: Connection) -> None:
        """Reads nothing yet."""
        self._connection = connection
        self._fine_s = FINE_S
        self._is_making_room = False
        self._kept_from_s = -LATEST_S
        self._due: List[_Series] = []
        self._merged_until_s = self._round_until_s = -LATEST_S
        """Until when all signals are merged, by the latest whole round, and by the present one."""

    def merge_old(self, before_s: float, now_s: float) -> bool:
        """Deletes some periods before a time, and merges some of those that are fine; returns whether to call again.

        Both times are in s since 1970. A round goes through all signals.
        """
        if not self._due:
            self._round_until_s = (now_s - self._fine_s) // MERGED_S * MERGED_S
            self._due = _series(self._connection)
            self._connection.execute("DELETE FROM robot_levels WHERE start_s < ?", (now_s - FINE_S,))
        work = 0.0
        while self._due and work < 1.0:
            series = self._due[-1]
            deleted = self._delete(series, before_s)
            merged = self._merge(series, self._round_until_s)
            work += deleted / _MOST_DELETED + (1 + merged) / _MOST_ROWS
            if not deleted and not merged:
                self._due.pop()
        if not self._due:
            self._merged_until_s = self._round_until_s
        return bool(self._due)

    def make_room(self, now_s: float) -> bool:
        """Merges periods that are younger than two days, until an hour is fine; then deletes the oldest hours.

        `now_s` is in s since 1970. Returns False if there are no samples.
        """
        if not self._is_making_room:
            self._due = []
            if self._fine_s > _LEAST_FINE_S:
                self._fine_s = max(0.5 * self._fine_s, _LEAST_FINE_S)
            else:
                query = f"SELECT min(start_s) FROM samples WHERE {_OF_SIGNAL}"
                begins = [self._connection.execute(query, series).fetchone() for series in _series(self._connection)]
                if not begins:
                    return False
                self._kept_from_s = min(begins)[0] + _STEP_S
        self._is_making_room = self.merge_old(self._kept_from_s, now_s)
        return True

    def _delete(self, series: _Series, before_s: float) -> int:
        oldest = f"SELECT start_s FROM samples WHERE {_OF_SIGNAL} AND start_s < ? ORDER BY start_s LIMIT 1000"
        delete = f"DELETE FROM samples WHERE {_OF_SIGNAL} AND start_s IN ({oldest})"
        return self._connection.execute(delete, (*series, *series, before_s)).rowcount

    def _merge(self, series: _Series, before_s: float) -> int:
        """Merges the oldest hour that is fine and before a time; returns how many rows that was."""
        where = f"start_s >= ? AND start_s < ? AND seconds < {MERGED_S}"
        rows = _rows(self._connection, series, where, (self._merged_until_s, before_s), int(_STEP_S / PERIOD_S))
        if not rows.raw:
            return 0
        begin_s = rows.raw[0][2] // MERGED_S * MERGED_S
        end_s = min(begin_s + _STEP_S, before_s)
        merged = [
            each._replace(start_s=each.start_s // MERGED_S * MERGED_S, seconds=MERGED_S)
            for each in rows
            if each.start_s < end_s
        ]
        self._connection.execute(f"DELETE FROM samples WHERE {_OF_SIGNAL} AND {where}", (*series, begin_s, end_s))
        self._connection.executemany(_STORE, merged)
        return len(rows.raw)


def _series(connection: Connection, robot: str | None = None, signal: str | None = None) -> List[_Series]:
    """Returns robot and signal of all samples, sorted, or of those that match; does not read every row."""
    query = f"{_SERIES} AND {pattern_condition(connection, 'robot', 'signal')} ORDER BY robot, signal"
    return select(connection, "samples", (str, str), query, {"robot": robot, "signal": signal})


def _rows(
    connection: Connection, series: _Series, where: str, values: Iterable[object], limit: int
) -> Rows[StoredSamples]:
    tail = f"WHERE {_OF_SIGNAL} AND {where} ORDER BY start_s LIMIT {limit}"
    return records(connection, "samples", StoredSamples, tail, (*series, *values))
