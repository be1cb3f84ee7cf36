"""The database of the store: a file, or memory if none is named or the file cannot be used. One thread writes it.

Whatever happens to the file, the monitor goes on with the same tables, so that notifications and silences keep working:

- The file is damaged, or its tables were altered: it is renamed, and a new one is begun with the present state.
- The file cannot be written (full, read-only, deleted folder): the present state is copied into memory. The file is
  tried again, with growing waits; once it works, what is in memory is stored in it.
- Another monitor writes the file, or it is from a newer version: memory, for the rest of the run.

Numbers of rows continue in memory where the file ended, so that rows can be moved back without changing references.
"""

from __future__ import annotations

import contextlib
import sqlite3
import threading
import time
from collections import deque
from dataclasses import dataclass
from sqlite3 import Connection
from typing import Any, Callable, Generic, TypeVar

from ...core.values import Clock, ConfigError, Faults, Level, ServiceError
from ...runtime.backoff import Backoff
from ...runtime.threads import MonotonicEvent, StepThread
from ..configuration import HistorySettings
from . import samples, schema
from .database_file import DatabaseFile, is_damage, is_file_error, reading, set_aside
from .present_state import PresentRun
from .retention import AgeClock, Retention
from .rows import CheckedConnection

Result = TypeVar("Result")

PART = "history"
"""The part whose fault says that the history is not written to its file."""
REPLACED_PART = "history file"
"""The part whose fault says that an earlier history was lost or put aside; it lasts until the monitor is restarted."""
ROWS_PART = "history rows"
"""The part whose fault says that rows were skipped, because something else has changed them."""

SLOW_S = 3.0
"""A disk that takes longer is reported, in s."""
MAX_WAITING = 2_000
"""Most jobs that wait; a transition with its evidence takes up to 8 kB."""

_MAX_ATTEMPTS = 3
_PERIOD_S = 1.0  # of the sign of life, and of looking after the file
_MEMORY_BYTES = 16e6
_EMPTY_BYTES = 120_000
"""Of a database without rows: each table takes a page or two."""
_LOG_BYTES = 8e6
_READERS_S = 1.0  # how long a log that must not grow any more may be in use
_JOB_BYTES = 200e3  # that a transaction adds at most
_FIRST_RETRY_S, _LAST_RETRY_S = 5.0, 60.0
_RETENTION_PERIOD_S = 60.0
_DAY_S = 86_400.0


@dataclass(eq=False)
class Job(Generic[Result]):
    """A function to run in the writer's thread, inside a transaction; again if the database has to be replaced."""

    function: Callable[[Connection], Result]
    event: MonotonicEvent | None = None
    """Set when it is done, if something waits for that."""
    is_done: bool = False
    is_cancelled: bool = False
    result: Result | None = None
    error: BaseException | None = None


class Database:
    """Owns the connection and its thread, which runs jobs, each in a transaction."""

    def __init__(self, settings: HistorySettings | None, wall_time_s: Clock, faults: Faults | None) -> None:
        """Starts the thread, which opens the file. The arguments are those of `History`."""
        self.file = None if settings is None else settings.file
        """Path of the file; None if the history is in memory."""
        self.wall_s = wall_time_s
        self.faults = Faults() if faults is None else faults
        """What is wrong with the history."""
        keep = settings or HistorySettings("")
        self._keep_s = keep.keep_days * _DAY_S
        keep_bytes = keep.keep_mb * 1e6
        self._log_bytes = min(_LOG_BYTES, 0.2 * keep_bytes)
        self._max_log_bytes = 1.5 * self._log_bytes
        self._max_bytes = 1.05 * keep_bytes - self._max_log_bytes - _JOB_BYTES
        self._max_memory_bytes = (
            _MEMORY_BYTES if settings is None else min(_MEMORY_BYTES, _EMPTY_BYTES + 0.5 * self._log_bytes)
        )
        self.present_run = PresentRun(wall_time_s)
        self.on_second: list[Callable[[Connection], object]] = []
        """Called about once a second by the writer's thread, in a transaction."""
        self._file: DatabaseFile | None = None
        self._memory: CheckedConnection | None = None
        self._is_copy = False
        self._backoff = Backoff(_FIRST_RETRY_S, _LAST_RETRY_S)
        self._next_retry_s = 0.0
        self._retention: Retention | None = None
        self._age_clock = AgeClock(wall_time_s())
        self._maintain_at_s = time.monotonic() + _PERIOD_S
        self._old_at_s = self._surplus_at_s = 0.0
        self._is_closing = False
        self._lock = threading.Lock()
        self._jobs: deque[Job[Any]] = deque()
        self._busy_since_s: float | None = time.monotonic()
        self._thread = StepThread("history", self._step, lambda error: self._report(f"internal error: {error!r}"))
        self._thread.start()

    # From any thread

    @property
    def busy_s(self) -> float:
        """For how long the present transaction has lasted, in s; 0 if there is none."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    def submit(self, job: Job[Result], is_urgent: bool = False) -> bool:
        """Adds a job; returns False if the writer is closing, or too many are waiting and it is not urgent."""
        busy_s = self.busy_s
        if busy_s > SLOW_S:
            self._report(f"{self.file}: the disk has not responded for {busy_s:.0f} s")
        with self._lock:
            if (len(self._jobs) >= MAX_WAITING and not is_urgent) or self._is_closing:
                return False
            self._jobs.append(job)
        self._thread.wake()
        return True

    def wait(self, job: Job[Result], timeout_s: float) -> bool:
        """Waits until a job is done, whatever becomes of the wall clock; returns whether it is."""
        job.event = MonotonicEvent()
        if not job.is_done:
            job.event.wait(timeout_s)
        return job.is_done

    def put(self, function: Callable[[Connection], object]) -> None:
        """Runs a function in the writer's thread, after everything requested before; returns at once."""
        self.submit(Job(function))

    def run(self, function: Callable[[Connection], Result], timeout_s: float = 5.0) -> Result:
        """Runs a function in the writer's thread, in a transaction. Not for the path of an alert.

        The function must not keep the connection; it is not run if it has not begun after `timeout_s`.

        Raises:
            ServiceError: the database failed, or did not answer in time.
        """
        job = Job(function)
        if not self.submit(job):
            raise ServiceError("history: too many requests are waiting, or it is closed")
        if not self.wait(job, timeout_s):
            job.is_cancelled = True
            raise ServiceError(f"history: no answer within {timeout_s:g} s")
        if isinstance(job.error, sqlite3.Error):
            raise ServiceError(f"history: {job.error}") from job.error
        if job.error is not None:
            raise job.error
        return job.result  # type: ignore[return-value]

    def read(self, function: Callable[[Connection], Result]) -> Result:
        """Runs a query: on a separate connection for a file, else in the writer's thread.

        Raises:
            ServiceError: the database failed, or did not answer in time.
            ConfigError: the file cannot be read.
        """
        if self.file is None or self._memory is not None:
            return self.run(function)
        with reading(self.file) as connection:
            result = function(connection)
            self._report_skipped(connection)
            return result

    def close(self, timeout_s: float = 2.0) -> None:
        """Runs the waiting jobs, stores the end of the run and closes the file; waits at most `timeout_s`."""
        with self._lock:
            self._is_closing = True
        self._thread.wake()
        self._thread.join(timeout_s)

    # In the writer's thread

    @property
    def connection(self) -> CheckedConnection:
        """The connection, in autocommit mode."""
        connection = self._memory if self._file is None else self._file.connection
        assert connection is not None
        return connection

    def _step(self) -> float:
        """Runs what waits, or what is due once a second; returns the time until the next call, in s."""
        self._busy_since_s = time.monotonic()
        if self._file is None and self._memory is None:
            if self.file is None:
                self._use_memory(None)
            else:
                self._open_file()
        with self._lock:
            job = self._jobs.popleft() if self._jobs else None
        if job is not None and not job.is_cancelled:
            self._run(job)
        is_too_large = self._care(self._limit_size)
        now_s = time.monotonic()
        if now_s >= self._maintain_at_s:
            self._care(self._maintain)
            self._maintain_at_s = time.monotonic() + _PERIOD_S
        with self._lock:
            is_idle = not self._jobs
            if is_idle:
                self._busy_since_s = None
        if self._is_closing and is_idle:
            self._close()
            self._thread.close()
        return 0.0 if is_too_large or not is_idle else max(0.0, self._maintain_at_s - time.monotonic())

    def _run(self, job: Job[Any]) -> None:
        for _ in range(_MAX_ATTEMPTS):
            job.error = None
            try:
                with schema.transaction(self.connection):
                    job.result = job.function(self.connection)
            except Exception as error:
                job.error = error
                if self._handle(error):
                    continue
            break
        if job.error is not None and job.event is None:
            self._report(f"internal error: {type(job.error).__name__}")
        job.is_done = True
        if job.event is not None:
            job.event.set()

    def _care(self, step: Callable[[], Result]) -> Result | None:
        """Runs a step of the database's own work."""
        try:
            return step()
        except sqlite3.Error as error:
            self._retention = None  # it knows of what was rolled back
            self._handle(error)
            return None

    def _handle(self, error: BaseException) -> bool:
        """Reacts to an error of a transaction, which has been rolled back.

        Returns whether another database is in use now: repeat the transaction.
        """
        file = self._file
        if file is None:
            return False
        if not is_file_error(error) and isinstance(error, sqlite3.OperationalError):
            with contextlib.suppress(sqlite3.Error):
                error = schema.altered_error(file.connection) or error
        if not is_file_error(error):
            return False
        self._leave(file)
        if is_damage(error):
            self._open_file(error)
        else:
            self._retry_later(f"{self.file}: {error}")
        return True

    def _maintain(self) -> None:
        """Does what is due: the time of the last sign of life, retention, another attempt to use the file."""
        now_s = time.monotonic()
        if self._backoff.is_failing and now_s >= self._next_retry_s:
            self._open_file()
        if self._file is not None:
            self._check_file(self._file)
        connection = self.connection
        self._report_skipped(connection)
        with schema.transaction(connection):
            if self._file is not None:
                schema.mirror_shared(connection)
            self.present_run.note_alive(connection)
            for hook in self.on_second:
                hook(connection)
        if now_s >= self._old_at_s:
            with schema.transaction(connection):
                is_more = self._used_retention.delete_old(self.present_run.id, self._age_s(), self._keep_s)
            self._old_at_s = 0.0 if is_more else now_s + _RETENTION_PERIOD_S

    def _limit_size(self) -> bool:
        """Keeps the file and its log within their limits, in a small step; returns whether there is more to do."""
        if self._file is not None:
            self._shorten_log(self._file)
        now_s = time.monotonic()
        if now_s < self._surplus_at_s or not self._used_retention.is_due():
            return False
        with schema.transaction(self.connection):
            is_done = not self._used_retention.delete_surplus(self.present_run.id, self._age_s())
        if is_done:
            self._surplus_at_s = now_s + _PERIOD_S  # everything that is left has to stay
            return False
        return True

    def _age_s(self) -> float:
        return self._age_clock.now_s(self.wall_s())

    def _close(self) -> None:
        """Closes the database; what is in memory is stored in the file if that is possible now."""
        if self._backoff.is_failing:
            self._open_file()
        self._care(lambda: self.present_run.note_alive(self.connection, has_stopped=True))
        if self._file is not None:
            self._file.close()
        if self._memory is not None:
            self._memory.close()

    def _open_file(self, damage: BaseException | None = None) -> None:
        """Opens the file and moves what is in memory into it, or goes on in memory.

        A damaged file is replaced; `damage` says that it is one.
        """
        path = str(self.file)
        try:
            try:
                if damage is not None:
                    raise damage
                file = self._adopted(path)
            except sqlite3.DatabaseError as error:
                if not is_damage(error):
                    raise
                text = f"{path} is damaged ({error}): kept as {set_aside(path, self.wall_s())}, a new history was begun"
                self.faults.report(REPLACED_PART, text)
                file = self._adopted(path)
        except schema.UnusableFileError as error:
            self._backoff.reset()
            self._report(f"{path} is not used: {error}; continuing without a history file")
            if self._memory is None:
                self._use_memory(None)
        except (OSError, sqlite3.Error) as error:
            file_name = getattr(error, "filename", None) or path  # a folder of it cannot be used
            self._retry_later(f"{file_name}: {getattr(error, 'strerror', None) or error}")
            if self._memory is None:
                try:
                    with reading(path) as source:
                        schema.mirror(source)
                        self._use_memory(source)
                except ConfigError:
                    self._use_memory(None)
        else:
            if self._memory is not None:
                self._memory.close()
            self._memory, self._file, self._retention = None, file, None
            self._backoff.reset()
            self.faults.clear(PART)

    def _adopted(self, path: str) -> DatabaseFile:
        """Returns the open file with the present run in it. Raises as `DatabaseFile`."""
        file = DatabaseFile(path, self._log_bytes)
        connection = file.connection
        try:
            self._shorten_log(file)
            altered = schema.altered_error(connection)
            if altered is not None:
                raise altered
            schema.mirror(connection)
            with schema.transaction(connection):
                if self._memory is None:
                    self._age_clock = AgeClock(self.present_run.write(connection))
                else:
                    self._move_from_memory(self._memory, connection)
        except BaseException:
            file.close()
            raise
        return file

    def _leave(self, file: DatabaseFile) -> None:
        """Goes on in memory, with what can be read of the file."""
        self._file = None
        try:
            self._use_memory(file.connection)
        finally:
            file.close()

    def _check_file(self, file: DatabaseFile) -> None:
        """Looks whether the file was deleted or replaced, or its disk fails."""
        if not file.is_in_place():
            text = f"{self.file} was deleted or replaced while in use: the present state was written to a new file"
            self._leave(file)
            self.faults.report(REPLACED_PART, text)
            self._open_file()
        elif file.problem:
            self._report(f"{self.file} cannot be flushed to the disk: {file.problem}")
        elif file.flushing_s > SLOW_S:
            self._report(f"{self.file}: the disk has not responded for {file.flushing_s:.0f} s")
        else:
            self.faults.clear(PART)

    def _use_memory(self, source: Connection | None) -> None:
        """Goes on in memory, with what can be read of `source`."""
        memory = schema.in_memory()
        with schema.transaction(memory):
            self._is_copy = source is not None and schema.copy_state(source, memory)
            if not self._is_copy and self.file is not None:
                schema.number_from(memory, int(self.wall_s() * 1000.0))  # larger than any number in the file
            self.present_run.write(memory)
        self._memory, self._retention = memory, None

    def _retry_later(self, problem: str) -> None:
        self._next_retry_s = time.monotonic() + self._backoff.next_s()
        self._report(f"{problem}; continuing in memory")

    def _move_from_memory(self, memory: Connection, connection: Connection) -> None:
        for table in schema.tables(memory):
            if self._is_copy and table in schema.LIVE_TABLES and table != schema.SHARED_TABLE:
                connection.execute(f"DELETE FROM {table}")
            if table == "samples":  # of which the file may have the first part of a period
                samples.store(connection, samples.read(memory))
            elif table != "robot_levels":  # which follow from the samples
                schema.copy_table(memory, connection, table)
        schema.copy_numbers(memory, connection)

    @property
    def _used_retention(self) -> Retention:
        if self._retention is None:
            max_bytes = self._max_bytes if self._file is not None else self._max_memory_bytes
            self._retention = Retention(self.connection, max_bytes)
        return self._retention

    def _shorten_log(self, file: DatabaseFile) -> None:
        """Copies the log if it has become too long although its thread does; else raises OperationalError."""
        until_s = time.monotonic() + _READERS_S
        while file.log_bytes() > self._max_log_bytes:
            if time.monotonic() > until_s:
                problem = "its log is locked: another program keeps reading it, or the disk does not respond"
                raise sqlite3.OperationalError(problem)
            file.copy_log()

    def _report(self, text: str) -> None:
        self.faults.report(PART, text)

    def _report_skipped(self, connection: CheckedConnection) -> None:
        """Reports the first row that was skipped because of its values; the fault lasts until a restart."""
        if connection.skipped_text:
            self.faults.report(ROWS_PART, connection.skipped_text, Level.WARN)
