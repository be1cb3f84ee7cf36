"""The thread that writes the history: everything in the order in which it was requested."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections import deque
from typing import Callable, Deque, Generic, List, Optional, TypeVar

from robot_health_monitor.core.errors import ServiceError

from . import schema
from .storage import Storage

Result = TypeVar("Result")

MAX_WAITING = 2_000
"""Most jobs that wait; a transition with its evidence takes up to 8 kB."""

_MAX_BATCH = 50  # jobs per transaction: about 200 kB
_PERIOD_S = 1.0  # of `Storage.maintain`
_MAX_ATTEMPTS = 3


class Job(Generic[Result]):
    """A function to run in the writer's thread, inside a transaction."""

    def __init__(self, function: Callable[[sqlite3.Connection], Result], is_foreign: bool = False) -> None:
        """Wraps a function.

        Args:
            function: what to run. It runs again if the database has to be replaced.
            is_foreign: a function of another module: in a separate transaction; its errors go to the caller.
        """
        self.function = function
        self.is_foreign = is_foreign
        self.done = threading.Event()
        self.result: Optional[Result] = None
        self.error: Optional[BaseException] = None
        self.is_cancelled = False


class Writer:
    """Runs jobs one after the other, several in one transaction if they are waiting."""

    def __init__(self, storage: Storage) -> None:
        """Starts the thread, which opens the storage."""
        self._storage = storage
        self._condition = threading.Condition()
        self._jobs: Deque[Job[object]] = deque()
        self._is_closing = False
        self._busy_since_s: Optional[float] = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="history", daemon=True)
        self._thread.start()

    @property
    def busy_s(self) -> float:
        """For how long the present transaction has lasted, in s; 0: there is none."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    def put(self, job: Job[Result], is_urgent: bool = False) -> bool:
        """Adds a job; returns False if too many are waiting, or the writer is closing.

        Args:
            job: what to run.
            is_urgent: also if too many are waiting.
        """
        with self._condition:
            if (len(self._jobs) >= MAX_WAITING and not is_urgent) or self._is_closing:
                return False
            self._jobs.append(job)  # type: ignore[arg-type]
            self._condition.notify()
            return True

    def wait(self, job: Job[Result], timeout_s: float) -> None:
        """Waits until a job is done, but not while the disk hangs: the first caller has waited for it.

        Args:
            job: what has been added.
            timeout_s: limit in s; a transaction that has lasted longer hangs.
        """
        if self.busy_s < timeout_s:
            job.done.wait(timeout_s)

    def run(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float) -> Result:
        """Runs a function in a separate transaction and returns its result.

        Raises:
            ServiceError: it failed in the database, or did not end in time.
        """
        job = Job(function, is_foreign=True)
        if not self.put(job):
            raise ServiceError("history: too many requests are waiting, or it is closed")
        if not job.done.wait(timeout_s):
            job.is_cancelled = True
            raise ServiceError(f"history: no answer within {timeout_s:g} s")
        if isinstance(job.error, sqlite3.Error):
            raise ServiceError(f"history: {job.error}") from job.error
        if job.error is not None:
            raise job.error
        return job.result  # type: ignore[return-value]

    def close(self, timeout_s: float) -> bool:
        """Runs the waiting jobs and ends the thread, which closes the storage; returns whether it did so in time."""
        with self._condition:
            self._is_closing = True
            self._condition.notify()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._storage.open()
        maintain_at_s = time.monotonic() + _PERIOD_S
        is_too_large = False
        while True:
            with self._condition:
                if not self._jobs:
                    self._busy_since_s = None
                    if self._is_closing:
                        break
                    self._condition.wait(0.0 if is_too_large else max(0.0, maintain_at_s - time.monotonic()))
                self._busy_since_s = time.monotonic()
                batch = self._next_batch()
            if batch:
                self._run_batch(batch)
            is_too_large = self._limit_size()
            if time.monotonic() >= maintain_at_s:
                self._busy_since_s = time.monotonic()
                self._maintain()
                maintain_at_s = time.monotonic() + _PERIOD_S
        self._storage.close()

    def _next_batch(self) -> List[Job[object]]:
        batch: List[Job[object]] = []
        while self._jobs and len(batch) < _MAX_BATCH:
            if batch and (self._jobs[0].is_foreign or batch[0].is_foreign):
                break
            job = self._jobs.popleft()
            if not job.is_cancelled:
                batch.append(job)
        return batch

    def _run_batch(self, batch: List[Job[object]]) -> None:
        is_foreign = batch[0].is_foreign
        error: Optional[BaseException] = None
        for _ in range(_MAX_ATTEMPTS):
            error = self._attempt(batch)
            if error is None or not self._storage.handle(error, not is_foreign):
                break
        for job in batch:
            job.error = error
            job.done.set()

    def _attempt(self, batch: List[Job[object]]) -> Optional[BaseException]:
        connection = self._storage.connection
        try:
            with schema.transaction(connection):
                for job in batch:
                    job.result = job.function(connection)
        except Exception as error:
            return error
        self._storage.note_committed()
        return None

    def _limit_size(self) -> bool:
        try:
            return self._storage.limit_size()
        except sqlite3.Error as error:
            self._storage.handle(error, was_own=True)
            return False

    def _maintain(self) -> None:
        try:
            self._storage.maintain()
        except sqlite3.Error as error:
            self._storage.handle(error, was_own=True)
