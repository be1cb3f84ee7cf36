"""Deletes entries of a history, a few at a time, so that a transition never waits for it.

Entries that are too old go first. While the database is too large, the oldest transitions of the robot and configured
signal that have most of them go: one noisy signal, or a driver that renames itself, does not displace the alerts of all
others. Samples make room before transitions.
"""

from __future__ import annotations

import time
from collections import Counter
from itertools import islice
from sqlite3 import Connection
from typing import List, Tuple

from ...core.config import template_name
from ...core.values import Clock
from .samples import SampleUpkeep
from .schema import INDEX_STEP, INDEXED

_MAX_ROWS = 200  # per call and table
_MAX_PAGES = 1000  # given back to the file system per call
_NEARLY = 1 / 2
_UNUSED_BYTES = 256_000  # unused pages that are kept for the next entries
_TRUSTED_STEP_S = 3600.0
_DISTRUST_S = 86_400.0

_NOT_OPEN = "AND id NOT IN (SELECT alert_id FROM open_alerts UNION SELECT transition_id FROM open_alerts)"

_OTHERS = (
    ("runs", "coalesce(stopped_s, alive_s) < :before_s", "id < :run_id", 1),
    ("resets", "wall_s < :before_s", "1", 1),
    (
        "configuration_changes",
        "wall_s < :before_s",
        "id NOT IN (SELECT max(id) FROM configuration_changes GROUP BY robot)",
        20,
    ),
)
"""The other tables of the past: which rows are too old, which may be deleted at all, and how many transitions take as
much space as one of them."""

_Rows = List[Tuple[int, str, str]]
"""Transitions: id, robot, signal."""


def _boot_s() -> float:
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class AgeClock:
    """Wall time for the age of entries. A step forward by more than an hour counts only once it has lasted a day.

    Otherwise a clock that is wrong by years for a minute would delete the whole history.
    """

    def __init__(self, known_s: float, clock: Clock = _boot_s) -> None:
        """Starts with the latest wall time that is known, in s since 1970; `clock` gives monotonic seconds."""
        self._reference_s = known_s
        self._clock = clock
        self._boot_s = clock()
        self._step_at_s: float | None = None

    def now_s(self, wall_s: float) -> float:
        """Returns the time for ages, for what the wall clock shows, both in s since 1970."""
        boot_s = self._clock()
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


class Retention:
    """Deletes entries of one database. The state of signals, open alerts, notifications and silences stay."""

    def __init__(self, connection: Connection, max_bytes: float) -> None:
        """`max_bytes` limits the database. Reads nothing yet: counting takes time, and a start must not wait for it."""
        self._connection = connection
        self._max_bytes = max_bytes
        self._counts: Counter[tuple[str, str]] | None = None
        """Transitions per robot and configured signal: a robot can choose any number of names of elements."""
        self._deleted_until = 0
        """The transitions of frequent signals up to this number were deleted."""
        self._samples = SampleUpkeep(connection)

    @property
    def _stored(self) -> Counter[tuple[str, str]]:
        if self._counts is None:
            self._counts = Counter()
            for robot, signal in self._connection.execute("SELECT robot, signal FROM transitions"):
                self._counts[robot, _template(signal)] += 1
        return self._counts

    def note_transition(self, robot: str, signal: str) -> None:
        """Counts a transition that is stored, by the names in its row."""
        if self._counts is not None:
            self._counts[robot, _template(signal)] += 1

    def is_due(self) -> bool:
        """Returns whether the database is too large, or has unused space to give back."""
        used, unused = used_bytes(self._connection)
        return used > self._max_bytes or used + unused > self._max_bytes + _UNUSED_BYTES

    def delete_old(self, run_id: int, now_s: float, keep_s: float) -> bool:
        """Deletes some of the entries that are older than `keep_s`, except the present run, and merges old samples.

        `now_s` is in s since 1970. Returns whether there may be more. Call inside a transaction.
        """
        before_s = now_s - keep_s
        query = f"SELECT max(+id) FROM transitions WHERE {INDEXED} AND wall_s < ?"
        (indexed,) = self._connection.execute(query, (before_s,)).fetchone()
        query = f"SELECT id, robot, signal FROM transitions WHERE id < ? AND wall_s < ? {_NOT_OPEN} ORDER BY id LIMIT ?"
        values = ((indexed or 0) + INDEX_STEP, before_s, _MAX_ROWS)
        deleted = self._delete(self._connection.execute(query, values).fetchall())
        for table, is_old, is_past, _ in _OTHERS:
            deleted += self._delete_others(table, f"{is_old} AND {is_past}", run_id, before_s)
        return self._samples.merge_old(before_s, now_s) or deleted > 0

    def delete_surplus(self, run_id: int, now_s: float) -> bool:
        """Deletes some entries if the database is too large, else gives unused space back to the file system.

        The present run stays. `now_s` is in s since 1970. Returns whether anything was done.
        """
        if used_bytes(self._connection)[0] > self._max_bytes:
            return self._samples.make_room(now_s) or self._delete_most_frequent(run_id)
        self._connection.execute(f"PRAGMA incremental_vacuum({_MAX_PAGES})").fetchall()
        return True

    def _delete_most_frequent(self, run_id: int) -> bool:
        """Deletes some of the oldest transitions of the signals that have most of them.

        Signals that have half as many as the largest count as equal, and lose their entries by age. Then neighbours are
        deleted together, and share the pages that have to be written.
        """
        if self._delete_most_frequent_others(run_id):
            return True
        counts = self._stored.copy()
        least = _NEARLY * max(counts.values(), default=0)

        def is_chosen(row: tuple[int, str, str]) -> bool:
            name = row[1], _template(row[2])
            counts[name] -= 1
            return counts[name] >= least - 1

        query = f"SELECT id, robot, signal FROM transitions WHERE id > ? {_NOT_OPEN} ORDER BY id"
        for from_id in (self._deleted_until, 0):
            rows = list(islice(filter(is_chosen, self._connection.execute(query, (from_id,))), _MAX_ROWS))
            if rows:
                self._deleted_until = rows[-1][0]
                return self._delete(rows) > 0
        # What is open needs all the space: it stays, without its samples.
        query = f"SELECT transition_id FROM evidence ORDER BY transition_id LIMIT {_MAX_ROWS}"
        return self._connection.execute(f"DELETE FROM evidence WHERE transition_id IN ({query})").rowcount > 0

    def _delete_most_frequent_others(self, run_id: int) -> int:
        """Deletes rows of the other tables that have more of them than any signal has transitions."""
        most = max(self._stored.values(), default=0)
        deleted = 0
        for table, _, is_past, weight in _OTHERS:
            if weight * self._connection.execute(f"SELECT count(*) FROM {table}").fetchone()[0] > most:
                deleted += self._delete_others(table, is_past, run_id, 0.0)
        return deleted

    def _delete(self, rows: _Rows) -> int:
        self._connection.executemany("DELETE FROM transitions WHERE id = ?", [(number,) for number, _, _ in rows])
        if self._counts is not None:
            self._counts.subtract((robot, _template(signal)) for _, robot, signal in rows)
            self._counts += Counter()  # without those of which nothing is left
        return len(rows)

    def _delete_others(self, table: str, condition: str, run_id: int, before_s: float) -> int:
        selected = f"SELECT id FROM {table} WHERE {condition} ORDER BY id LIMIT {_MAX_ROWS}"
        values = {"run_id": run_id, "before_s": before_s}
        return self._connection.execute(f"DELETE FROM {table} WHERE id IN ({selected})", values).rowcount


def _template(signal: object) -> str:
    return template_name(signal) if isinstance(signal, str) else ""


def used_bytes(connection: Connection) -> tuple[int, int]:
    """Returns the size of the used and of the unused pages of the database, in bytes."""
    page, pages, unused = (
        connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("page_size", "page_count", "freelist_count")
    )
    return (pages - unused) * page, unused * page
