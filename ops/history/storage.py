"""The database in use: the history file, or a database in memory while the file cannot be used.

Whatever happens to the file, the monitor goes on with the same tables, so that notifications and silences keep working:

- The file is damaged: it is renamed, and a new one is begun with the present state.
- The file cannot be written (full, read-only, deleted folder): the present state is copied into memory. The file is
  tried again, with growing waits; once it works, what is in memory is stored in it.
- Another monitor writes the file, or it is from a newer version: memory, for the rest of the run.

Numbers of rows continue in memory where the file ended, so that rows can be moved back without changing references.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from typing import Callable, Dict, Mapping, Optional, Tuple

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.version import package_version
from robot_health_monitor.runtime.backoff import Backoff

from . import samples, schema
from .database_file import (
    DatabaseFile,
    InUseError,
    NotAHistoryError,
    is_damage,
    is_file_error,
    open_read_only,
    reason,
    set_aside,
)  # fmt: skip
from .retention import AgeClock, Retention
from .rows import CheckedConnection, is_text, is_time

PART = "history"
"""The part whose fault says that the history is not written to its file."""
REPLACED_PART = "history file"
"""The part whose fault says that an earlier history was lost or put aside; it lasts until the monitor is restarted."""

ROWS_PART = "history rows"
"""The part whose fault says that rows were skipped, because something else has changed them."""

SLOW_S = 3.0
"""A disk that takes longer is reported, in s."""

_MEMORY_BYTES = 16e6
_EMPTY_BYTES = 120_000
"""Of a database without rows: each table takes a page or two."""
_LOG_BYTES = 8e6
_BATCH_BYTES = 200e3
_FIRST_RETRY_S, _LAST_RETRY_S = 5.0, 60.0
_ALIVE_PERIOD_S = 1.0
_RETENTION_PERIOD_S = 60.0
_DAY_S = 86_400.0
# Not REPLACE, which would change the index, too.
_STORE_STATE = """
INSERT INTO signal_states (robot, signal, state) VALUES (?, ?, ?)
ON CONFLICT (robot, signal) DO UPDATE SET state = excluded.state
"""


class Storage:
    """Owns the connection. Used by the writer's thread only."""

    def __init__(
        self, file: Optional[str], keep_days: float, keep_mb: float, faults: Faults, wall_s: Callable[[], float]
    ) -> None:
        """Opens nothing yet; the arguments are those of `History` and `HistorySettings`."""
        self._path = file
        self._keep_s = keep_days * _DAY_S
        keep_bytes = keep_mb * 1e6
        self._log_bytes = min(_LOG_BYTES, 0.2 * keep_bytes)
        self._max_log_bytes = 1.5 * self._log_bytes
        self._max_bytes = 1.05 * keep_bytes - self._max_log_bytes - _BATCH_BYTES
        self._max_memory_bytes = (
            _MEMORY_BYTES if file is None else min(_MEMORY_BYTES, _EMPTY_BYTES + 0.5 * self._log_bytes)
        )
        self._faults = faults
        self._wall_s = wall_s
        self._file: Optional[DatabaseFile] = None
        self._memory: Optional[sqlite3.Connection] = None
        self._backoff = Backoff(_FIRST_RETRY_S, _LAST_RETRY_S)
        self._next_retry_s = 0.0
        self._is_copy = False
        self._retention: Optional[Retention] = None
        self._alive_at_s = 0.0
        self._old_at_s = 0.0
        self._surplus_at_s = 0.0
        self._age_clock = AgeClock(wall_s(), _boot_s())
        self._run: Tuple[int, float] = (0, 0.0)
        self._watches: Dict[str, Tuple[int, float]] = {}
        self._states: Dict[Tuple[str, str], str] = {}
        self._last_id = 0

    @property
    def connection(self) -> sqlite3.Connection:
        """The connection, in autocommit mode."""
        if self._file is not None:
            return self._file.connection
        assert self._memory is not None
        return self._memory

    @property
    def is_in_memory(self) -> bool:
        """Whether the file is not in use; from any thread."""
        return self._memory is not None

    def open(self) -> None:
        """Opens the file or, if that is not possible, a database in memory. Never raises."""
        if self._path is None:
            self._use_memory(None)
        else:
            self._open_file()

    def handle(self, error: BaseException, was_own: bool) -> bool:
        """Reacts to an error of a transaction, which has been rolled back.

        `was_own`: it came from a statement of this package, not from a function of another module. Returns whether
        another database is in use now: repeat the transaction.
        """
        if was_own:
            self._retention = None  # it has counted what was rolled back
        if self._file is None or not (is_file_error(error) or (was_own and isinstance(error, sqlite3.Error))):
            return False
        file, self._file = self._file, None
        try:
            self._use_memory(file.connection, error)
        finally:
            _close(file)
        if is_damage(error):
            try:
                self._put_aside(file.path, error)
            except OSError as rename_error:
                problem = reason(rename_error, file.path)
                self._report(f"{file.path} is damaged ({error}) and {problem}; continuing in memory")
            else:
                self._open_file()
        return True

    def note_committed(self) -> None:
        """A transaction with changes was committed: it is to be flushed to the disk."""
        if self._file is not None:
            self._file.note_written()

    def note_transition(self, number: int, robot: str, signal: str, to_level: int, repeated: int) -> None:
        """Notes a transition that is stored: its number and the values in its row."""
        self._last_id = max(self._last_id, number)
        if self._retention is not None:
            self._retention.note_transition(number, robot, signal, to_level, repeated)

    def write_states(self, robot: str, states: Mapping[str, str]) -> None:
        """Stores the states of signals of a robot in JSON; `{}` deletes one. Inside a transaction."""
        for signal, state in states.items():  # first: a statement may fail
            if state == "{}":
                self._states.pop((robot, signal), None)
            else:
                self._states[robot, signal] = state
        for signal, state in states.items():
            if state == "{}":
                self.connection.execute("DELETE FROM signal_states WHERE robot = ? AND signal = ?", (robot, signal))
            else:
                self.connection.execute(_STORE_STATE, (robot, signal, state))

    def begin_watch(self, robot: str) -> None:
        """Stores that a robot is watched from now on. Inside a transaction."""
        now_s = self._wall_s()
        insert = "INSERT INTO watches (run_id, robot, started_s) VALUES (?, ?, ?)"
        number = self.connection.execute(insert, (self._run[0], robot, now_s)).lastrowid
        self._watches[robot] = (number or 0, now_s)

    def end_watch(self, robot: str) -> None:
        """Stores that a robot is no longer watched. Inside a transaction."""
        number, _ = self._watches.pop(robot, (0, 0.0))
        self.connection.execute("UPDATE watches SET stopped_s = ? WHERE id = ?", (self._wall_s(), number))

    def end_run(self) -> None:
        """Stores that the run ends now. Inside a transaction."""
        now_s = self._wall_s()
        update = "UPDATE runs SET alive_s = ?, stopped_s = ? WHERE id = ?"
        self.connection.execute(update, (now_s, now_s, self._run[0]))

    def maintain(self) -> None:
        """Does what is due: the time of the last sign of life, retention, another attempt to use the file.

        Call about once a second, outside of a transaction. A sqlite3.Error is for `handle`.
        """
        now_s = time.monotonic()
        if self._backoff.is_failing and now_s >= self._next_retry_s:
            self._open_file()
        if self._file is not None:
            self._check_file(self._file)
        connection = self.connection
        report_skipped(self._faults, connection)
        if now_s >= self._alive_at_s + _ALIVE_PERIOD_S:
            self._alive_at_s = now_s
            connection.execute("UPDATE runs SET alive_s = ? WHERE id = ?", (self._wall_s(), self._run[0]))
        if now_s >= self._old_at_s:
            age_s = self._age_clock.now_s(self._wall_s(), _boot_s())
            with schema.transaction(connection):
                is_more = self._used_retention.delete_old(self._run[0], age_s, self._keep_s)
            self._old_at_s = 0.0 if is_more else now_s + _RETENTION_PERIOD_S

    def limit_size(self) -> bool:
        """Keeps the file and its log within their limits, in a small step; returns whether there is more to do.

        Call after each transaction. A sqlite3.Error is for `handle`.
        """
        if self._file is not None:
            self._shorten_log(self._file)
        now_s = time.monotonic()
        if now_s < self._surplus_at_s or not self._used_retention.is_due():
            return False
        age_s = self._age_clock.now_s(self._wall_s(), _boot_s())
        with schema.transaction(self.connection):
            is_done = not self._used_retention.delete_surplus(self._run[0], age_s)
        if is_done:
            self._surplus_at_s = now_s + _ALIVE_PERIOD_S  # everything that is left has to stay
            return False
        self.note_committed()
        return True

    def close(self) -> None:
        """Closes the database; what is in memory is stored in the file if that is possible now."""
        if self._backoff.is_failing:
            self._open_file()
        if self._file is not None:
            self._file.close()
        if self._memory is not None:
            self._memory.close()

    def _open_file(self) -> None:
        """Opens the file and moves what is in memory into it, or uses memory."""
        assert self._path is not None
        try:
            file = self._opened(self._path)
        except (InUseError, NotAHistoryError, schema.UnknownSchemaError) as error:
            self._backoff.reset()
            self._report(f"{self._path} is not used: {error}; continuing without a history file")
            self._require_memory(None)
        except (OSError, sqlite3.Error) as error:
            self._retry_later()
            self._report(f"{reason(error, self._path)}; continuing in memory")
            self._require_memory(self._path)
        else:
            if self._memory is not None:
                self._memory.close()
            self._memory, self._file, self._retention = None, file, None
            self._backoff.reset()
            self._faults.clear(PART)

    def _opened(self, path: str) -> DatabaseFile:
        """Returns the open file with the present run in it; a damaged one is replaced. Raises as `DatabaseFile`."""
        try:
            return self._adopted(DatabaseFile(path, self._log_bytes))
        except sqlite3.Error as error:
            if not is_damage(error):
                raise
            self._put_aside(path, error)
            return self._adopted(DatabaseFile(path, self._log_bytes))

    def _adopted(self, file: DatabaseFile) -> DatabaseFile:
        connection = file.connection
        try:
            self._shorten_log(file)
            with schema.transaction(connection):
                if self._memory is None:
                    self._begin_run(connection)
                else:
                    self._move_from_memory(self._memory, connection)
        except BaseException:
            _close(file)
            raise
        return file

    def _begin_run(self, connection: sqlite3.Connection) -> None:
        now_s = self._wall_s()
        last = connection.execute("SELECT alive_s FROM runs ORDER BY id DESC LIMIT 1").fetchone()
        self._age_clock = AgeClock(min(last[0], now_s) if last and is_time(last[0]) else now_s, _boot_s())
        insert = "INSERT INTO runs (started_s, alive_s, version) VALUES (?, ?, ?)"
        self._run = (connection.execute(insert, (now_s, now_s, package_version())).lastrowid or 0, now_s)
        for robot, signal, state in connection.execute("SELECT robot, signal, state FROM signal_states"):
            if is_text(robot) and is_text(signal) and is_text(state):
                self._states.setdefault((robot, signal), state)

    def _check_file(self, file: DatabaseFile) -> None:
        """Looks whether the file was deleted or replaced, or its disk fails."""
        if not file.is_in_place():
            assert self._path is not None
            text = f"{self._path} was deleted or replaced while in use: the present state was written to a new file"
            self._use_memory(file.connection)
            self._file = None
            _close(file)
            self._report_replaced(text)
            self._open_file()
        elif file.problem:
            self._report(f"{self._path} cannot be flushed to the disk: {file.problem}")
        elif file.flushing_s > SLOW_S:
            self._report(f"{self._path}: the disk has not responded for {file.flushing_s:.0f} s")
        else:
            self._faults.clear(PART)

    def _put_aside(self, path: str, error: BaseException) -> None:
        """Renames a damaged file, or raises OSError."""
        aside = set_aside(path, self._wall_s())
        self._report_replaced(f"{path} is damaged ({error}): kept as {aside}, a new history was begun")

    def _use_memory(self, source: Optional[sqlite3.Connection], error: Optional[BaseException] = None) -> None:
        """Goes on in memory, with what can be read of `source`, which was used until now; `error`: why no longer."""
        memory = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False, factory=CheckedConnection)
        schema.prepare(memory)
        memory.execute("BEGIN IMMEDIATE")
        self._is_copy = source is not None and schema.copy_state(source, memory)
        if not self._is_copy and self._path is not None:
            schema.number_from(memory, int(self._wall_s() * 1000.0))  # larger than any number in the file
        memory.executemany(_STORE_STATE, [(*key, state) for key, state in self._states.items()])
        number, started_s = self._run
        if number:
            row = (number, started_s, self._wall_s(), package_version())
            memory.execute("INSERT OR REPLACE INTO runs (id, started_s, alive_s, version) VALUES (?, ?, ?, ?)", row)
            watches = [(watch, number, robot, begin_s) for robot, (watch, begin_s) in self._watches.items()]
            memory.executemany("INSERT INTO watches (id, run_id, robot, started_s) VALUES (?, ?, ?, ?)", watches)
        else:
            self._begin_run(memory)
        schema.number_from(memory, self._last_id, ("transitions",))
        memory.execute("COMMIT")
        self._memory, self._retention = memory, None
        if error is not None:
            self._report(f"{reason(error, str(self._path))}; continuing in memory")
            self._retry_later()

    def _require_memory(self, readable: Optional[str]) -> None:
        """Goes on in memory unless that is already so; `readable`: path of a file that may have the present state."""
        if self._memory is not None:
            return
        try:
            source = None if readable is None else open_read_only(readable)
        except (OSError, sqlite3.Error, schema.UnknownSchemaError):
            source = None
        self._use_memory(source)
        if source is not None:
            source.close()

    def _retry_later(self) -> None:
        self._next_retry_s = time.monotonic() + self._backoff.next_s()

    def _move_from_memory(self, memory: sqlite3.Connection, connection: sqlite3.Connection) -> None:
        for table in schema.tables(memory):
            if self._is_copy and table in schema.LIVE_TABLES and table not in schema.SHARED_TABLES:
                connection.execute(f"DELETE FROM {table}")
            if table == "samples":  # of which the file may have the first part of a period
                samples.store(connection, samples.read(memory))
            elif table != "robot_levels":  # which follow from the samples
                schema.copy_table(memory, connection, table)
        schema.number_from(connection, self._last_id, ("transitions",))  # a new file continues, too

    @property
    def _used_retention(self) -> Retention:
        if self._retention is None:
            max_bytes = self._max_bytes if self._file is not None else self._max_memory_bytes
            self._retention = Retention(self.connection, max_bytes)
        return self._retention

    def _shorten_log(self, file: DatabaseFile) -> None:
        """Empties the log if it has become too long although its thread copies it; else raises OperationalError."""
        if file.log_bytes() > self._max_log_bytes:
            file.empty_log()
            if file.log_bytes() > self._max_log_bytes:
                problem = "its log is locked: another program keeps reading it, or the disk does not respond"
                raise sqlite3.OperationalError(problem)

    def _report(self, text: str) -> None:
        self._faults.report(PART, text)

    def _report_replaced(self, text: str) -> None:
        self._faults.report(REPLACED_PART, text)


def report_skipped(faults: Faults, connection: sqlite3.Connection) -> None:
    """Reports the first row that was skipped because of its values; the fault lasts until the monitor is restarted."""
    if isinstance(connection, CheckedConnection) and connection.skipped and ROWS_PART not in faults.current():
        faults.report(ROWS_PART, connection.skipped_text, Level.WARN)


def _boot_s() -> float:
    """Returns monotonic seconds that include suspension."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def _close(file: DatabaseFile) -> None:
    with contextlib.suppress(OSError, sqlite3.Error):  # closed before, or its disk fails
        file.close()
