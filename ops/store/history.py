"""The history of one monitor process: stores transitions before they are announced, and the state for a restart.

One thread writes it, everything in the order in which it was requested.
"""

from __future__ import annotations

import hashlib
import json
import math
import threading
import time
from collections import deque
from contextlib import contextmanager
from sqlite3 import Connection, OperationalError
from typing import Any, Callable, Iterable, Iterator, Mapping, Sequence, TypeVar

from ...core.judge import PERIOD_S, SampleSummary, SavedSignal
from ...core.values import Clock, Faults, JsonObject, ServiceError, Transition, printable
from ..configuration import HistorySettings
from .database import PART, Database, Job
from .database_file import is_file_error
from .present_state import store_transition, write_states
from .queries import read_states
from .rows import pack_samples, transition_row
from .samples import StoredSamples, store
from .schema import altered_error

Result = TypeVar("Result")
OnRecord = Callable[[Connection, int, Transition, float], None]
"""Receives the connection, the number of the transition that began the alert, the transition, and the wall time in
s."""

COMMIT_TIMEOUT_S = 0.2
"""How long a transition waits for the disk before it is announced."""
MAX_WAITING_SAMPLES = 50_000
"""Most rows of samples that wait while the disk hangs, about 20 MB; the oldest are dropped."""
LOST_PART = "history queue"
"""The part whose fault counts transitions that were not stored."""

_MOST_EVIDENT = 1_000  # signals per robot whose latest samples are known: a driver may rename itself
# At most 1,000 are stored with an alert, likewise.
_STORE_EFFECT = """
    INSERT OR IGNORE INTO effects (transition_id, signal)
    SELECT alert_id, ? FROM open_alerts WHERE robot = ? AND signal = ?
        AND (SELECT count(*) FROM effects WHERE transition_id = alert_id) < 1000
"""
_RESTORE_TIMEOUT_S = 5.0
_HOOK_PART = "notifications"


class History(Database):
    """Writes a history file, or keeps a history in memory. All methods may be called from any thread."""

    def __init__(
        self,
        settings: HistorySettings | None,
        wall_time_s: Clock = time.time,
        faults: Faults | None = None,
    ) -> None:
        """Opens the history, in its own thread. Whatever is wrong with the file is a fault, and the monitor goes on.

        Args:
            settings: the file and what to keep; None for a history in memory, with the same tables.
            wall_time_s: seconds since 1970.
            faults: receives what is wrong with it; None if it is not to be reported.
        """
        super().__init__(settings, wall_time_s, faults)
        self.keeps_samples = settings is None or settings.samples
        """Whether samples are stored."""
        self._samples_lock = threading.Lock()
        self._open_samples: deque[StoredSamples] | None = None
        """Those that wait for the writer; None if there are none."""
        self.on_record: list[OnRecord] = []
        """Called inside the transaction that stores a transition, in the writer's thread.

        One may run again for the same transition if the database has to be replaced: its effects belong into the
        database.
        """
        self.lost = 0
        """Transitions that could not be stored."""

    def of_robot(self, robot: str) -> RobotHistory:
        """Returns the history of one robot, for its AlertSystem: the only one until that is closed."""
        self.put(lambda connection: self.present_run.begin_watch(connection, robot))
        return RobotHistory(self, robot)

    def put_samples(self, rows: Iterable[StoredSamples]) -> None:
        """Stores samples after everything requested before; returns at once."""
        with self._samples_lock:
            if self._open_samples is not None:
                self._open_samples.extend(rows)
                return
            waiting = self._open_samples = deque(rows, MAX_WAITING_SAMPLES)

        def write(connection: Connection) -> None:
            with self._samples_lock:
                if self._open_samples is waiting:
                    self._open_samples = None
            store(connection, waiting)

        # Also if many jobs are waiting: there is one such job at most.
        self.submit(Job(write), is_urgent=True)

    def store(
        self, connection: Connection, row: Sequence[Any], samples: bytes, transition: Transition, wall_s: float
    ) -> None:
        """Stores a transition, by its row and its packed samples. Call inside a transaction."""
        number, alert = store_transition(connection, row, transition, wall_s)
        connection.execute("INSERT INTO evidence VALUES (?, ?)", (number, samples))
        if self._retention is not None:
            self._retention.note_transition(row[1], row[2])
        self.present_run.note_alive(connection)
        for hook in self.on_record:
            # Their mistakes do not affect the transition.
            connection.execute("SAVEPOINT hook")
            try:
                hook(connection, alert, transition, wall_s)
            except Exception as error:
                if is_file_error(error):
                    raise
                connection.execute("ROLLBACK TO hook")
                altered = altered_error(connection) if isinstance(error, OperationalError) else None
                if altered is not None:
                    raise altered from None
                self.faults.report(_HOOK_PART, f"{type(error).__name__}: {error}")
            else:
                self.faults.clear(_HOOK_PART)
            connection.execute("RELEASE hook")


class RobotHistory:
    """The history of one robot: implements `core.judge.continuity.SignalHistory`, which documents its methods."""

    def __init__(self, history: History, robot: str) -> None:
        """Use `History.of_robot`."""
        self._history = history
        self._robot = robot
        self.wall_s = history.wall_s
        self.keeps_samples = history.keeps_samples
        self._lock = threading.Lock()
        self._open_save: dict[str, str] | None = None
        self._evidence_until_s: dict[str, float] = {}

    def restore(self) -> Mapping[str, SavedSignal]:
        """Returns the last stored state of each signal, by name; empty if the history cannot be read."""
        return self._read(lambda connection: read_states(connection, self._robot)) or {}

    def watched_until_s(self) -> float | None:
        """Returns when the robot was last watched before this run, in s since 1970; None if that is unknown."""
        query = """
            SELECT max(coalesce(watches.stopped_s, runs.stopped_s, runs.alive_s))
            FROM watches JOIN runs ON runs.id = run_id
            WHERE robot = :robot AND watches.id < (SELECT max(id) FROM watches WHERE robot = :robot)
        """
        row = self._read(lambda connection: connection.execute(query, {"robot": self._robot}).fetchone())
        return row[0] if row is not None and isinstance(row[0], float) else None

    def record(self, transition: Transition, saved: SavedSignal, evidence: Sequence[tuple[float, Any]]) -> None:
        """Stores a transition, and the state of its signal after it, in one transaction. Call before the outlets.

        Returns when it is committed, after 0.2 s at the latest.
        """
        with self._reporting("a transition was not stored"):
            history, signal = self._history, transition.signal
            wall_s, state = self.wall_s(), {signal: json.dumps(saved)}
            row = transition_row(transition, wall_s)
            samples = pack_samples(evidence, self._evidence_until_s.get(signal, -math.inf))

            def insert(connection: Connection) -> None:
                history.store(connection, row, samples, transition, wall_s)
                write_states(connection, self._robot, state)

            job = Job(insert)
            with self._lock:
                is_waiting = history.submit(job)
                if is_waiting:
                    self._open_save = None  # later states go behind this transition
                    if evidence:
                        self._evidence_until_s.pop(signal, None)  # the newest are at the end
                        self._evidence_until_s[signal] = evidence[-1][0]
                    if len(self._evidence_until_s) > _MOST_EVIDENT:
                        del self._evidence_until_s[next(iter(self._evidence_until_s))]
            if not is_waiting:
                history.lost += 1
                text = f"{history.lost} transitions were announced, but could not be stored in time"
                history.faults.report(LOST_PART, text)
                self._save(state)
            elif history.busy_s < COMMIT_TIMEOUT_S:  # while the disk hangs, the first caller has waited
                history.wait(job, COMMIT_TIMEOUT_S)

    def save(self, states: Mapping[str, SavedSignal]) -> None:
        """Stores states of signals without a transition; returns at once."""
        with self._reporting("states were not stored"):
            self._save({signal: json.dumps(state) for signal, state in states.items()})

    def record_samples(self, samples: Mapping[str, Sequence[SampleSummary]]) -> None:
        """Stores what was collected of the samples of signals, by their names; returns at once."""
        with self._reporting("samples were not stored"):
            self._history.put_samples(
                StoredSamples(self._robot, printable(signal), each.start_s, PERIOD_S, *each[1:])
                for signal, summaries in samples.items()
                for each in summaries
            )

    def record_effects(self, effects: Mapping[str, Sequence[str]]) -> None:
        """Stores with open alerts, by the names of their signals, which signals they keep from being announced."""

        def add(connection: Connection) -> None:
            for cause, names in effects.items():
                rows = [(printable(name), printable(self._robot), printable(cause)) for name in names]
                connection.executemany(_STORE_EFFECT, rows)

        self._history.put(add)

    def record_reset(self) -> None:
        """Stores that latched alerts were reset; returns at once."""
        row = (self.wall_s(), self._robot)
        self._history.put(
            lambda connection: connection.execute("INSERT INTO resets (wall_s, robot) VALUES (?, ?)", row)
        )

    def record_configuration(self, configuration: Mapping[str, JsonObject]) -> None:
        """Stores the configuration in force as JSON, the same one only once; returns at once."""
        text = json.dumps(configuration, default=str)
        key = hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()
        row = (self.wall_s(), self._robot, key)

        def insert(connection: Connection) -> None:
            connection.execute("INSERT OR IGNORE INTO configurations VALUES (?, ?)", (key, text))
            connection.execute("INSERT INTO configuration_changes (wall_s, robot, hash) VALUES (?, ?, ?)", row)

        self._history.put(insert)

    def close(self) -> None:
        """Stores that the robot is no longer watched. Not needed at the end of the process."""
        self._history.put(lambda connection: self._history.present_run.end_watch(connection, self._robot))

    def _read(self, function: Callable[[Connection], Result]) -> Result | None:
        try:
            return self._history.run(function, _RESTORE_TIMEOUT_S)
        except ServiceError as error:
            self._history.faults.report(PART, str(error))
            return None

    def _save(self, states: Mapping[str, str]) -> None:
        with self._lock:
            if self._open_save is not None:
                self._open_save.update(states)
                return
            waiting = self._open_save = dict(states)

            def write(connection: Connection) -> None:
                with self._lock:
                    if self._open_save is waiting:
                        self._open_save = None
                write_states(connection, self._robot, waiting)

            # Also if many jobs are waiting: between two transitions there is one such job per robot at most.
            self._history.submit(Job(write), is_urgent=True)

    @contextmanager
    def _reporting(self, problem: str) -> Iterator[None]:
        """Reports what a block raises."""
        try:
            yield
        except Exception as error:
            self._history.faults.report(PART, f"{problem}: {type(error).__name__}: {error}")
