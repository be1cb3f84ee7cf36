"""The thread that owns the database: everything is written here, in the order in which it was requested."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections import deque
from typing import Callable, Deque, Generic, List, Optional, TypeVar

from robot_health_monitor.core.errors import ServiceError

Result = TypeVar("Result")

_MAX_BATCH = 500  # jobs per transaction
_MAX_WAITING = 5_000
_IDLE_S = 1.0


class Job(Generic[Result]):
    """A function to run in the writer thread, inside a transaction."""

    def __init__(self, function: Callable[[sqlite3.Connection], Result], alone: bool = False) -> None:
        """Wraps a function.

        Args:
            function: what to run.
            alone: in a transaction of its own, so that its failure affects no other job.
        """
        self.function = function
        self.alone = alone
        self.done = threading.Event()
        self.result: Optional[Result] = None
        self.error: Optional[BaseException] = None
        self.is_cancelled = False


class Writer:
    """Runs jobs one after the other, several in one transaction if they are waiting."""

    def __init__(self, open_database: Callable[[], sqlite3.Connection], on_idle: Callable[[sqlite3.Connection], None]):
        """Starts the thread, which opens the database.

        Args:
            open_database: returns the connection, in autocommit mode.
            on_idle: called each second, inside a transaction.
        """
        self._open_database = open_database
        self._on_idle = on_idle
        self._condition = threading.Condition()
        self._jobs: Deque[Job[object]] = deque()
        self._is_closing = False
        self._thread = threading.Thread(target=self._run, name="history", daemon=True)
        self._thread.start()

    def put(self, job: Job[Result]) -> bool:
        """Adds a job; returns False if too many are waiting."""
        with self._condition:
            if len(self._jobs) >= _MAX_WAITING or self._is_closing:
                return False
            self._jobs.append(job)  # type: ignore[arg-type]
            self._condition.notify()
            return True

    def run(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float) -> Result:
        """Runs a function in a transaction of its own and returns its result.

        Raises:
            ServiceError: it failed in the database, or did not start or end in time.
        """
        job = Job(function, alone=True)
        if not self.put(job):
            raise ServiceError("history: too many requests are waiting")
        if not job.done.wait(timeout_s):
            job.is_cancelled = True
            raise ServiceError(f"history: no answer within {timeout_s:g} s")
        if isinstance(job.error, sqlite3.Error):
            raise ServiceError(f"history: {job.error}") from job.error
        if job.error is not None:
            raise job.error
        return job.result  # type: ignore[return-value]

    def close(self, timeout_s: float) -> None:
        """Runs the waiting jobs and ends the thread, which closes the database."""
        with self._condition:
            self._is_closing = True
            self._condition.notify()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        connection = self._open_database()
        idle_at_s = time.monotonic() + _IDLE_S
        while True:
            with self._condition:
                if not self._jobs and not self._is_closing:
                    self._condition.wait(max(0.0, idle_at_s - time.monotonic()))
                if not self._jobs and self._is_closing:
                    break
                batch = self._next_batch()
            self._run_batch(connection, batch)
            if time.monotonic() >= idle_at_s:
                idle_at_s = time.monotonic() + _IDLE_S
                self._run_batch(connection, [Job(self._on_idle)])
        connection.close()

    def _next_batch(self) -> List[Job[object]]:
        batch: List[Job[object]] = []
        while self._jobs and len(batch) < _MAX_BATCH and not (batch and (self._jobs[0].alone or batch[0].alone)):
            batch.append(self._jobs.popleft())
        return batch

    def _run_batch(self, connection: sqlite3.Connection, batch: List[Job[object]]) -> None:
        batch = [job for job in batch if not job.is_cancelled]
        if not batch:
            return
        error: Optional[BaseException] = None
        try:
            connection.execute("BEGIN IMMEDIATE")
            for job in batch:
                job.result = job.function(connection)
            connection.execute("COMMIT")
        except Exception as caught:
            error = caught
            if connection.in_transaction:
                connection.execute("ROLLBACK")
        for job in batch:
            job.error = error
            job.done.set()
