"""The history of one monitor process: stores transitions before they are announced, and the state for a restart."""

from __future__ import annotations

import hashlib
import json
import math
import sqlite3
import threading
import time
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, TypeVar

from robot_health_monitor.core.continuity import SavedSignal
from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Transition

from ..configuration import HistorySettings
from .database_file import is_file_error
from .queries import read_states
from .reader import HistoryReader
from .rows import INSERT_TRANSITION, pack_samples, transition_row
from .storage import PART, SLOW_S, Storage, report_skipped
from .writer import Job, Writer

Result = TypeVar("Result")
OnRecord = Callable[[sqlite3.Connection, int, Transition, float], None]
"""Receives the connection, the id of the transition, the transition, and the wall time in s."""

COMMIT_TIMEOUT_S = 0.2
"""How long a transition waits for the disk before it is announced."""

_RESTORE_TIMEOUT_S = 5.0
_CLOSE_TIMEOUT_S = 2.0
_HOOK_PART = "notifications"
LOST_PART = "history queue"
"""The part whose fault counts transitions that were not stored."""
_DEFAULT_KEEP = HistorySettings("")


class History:
    """Writes a history file, or keeps a history in memory. All methods may be called from any thread."""

    def __init__(
        self,
        settings: Optional[HistorySettings],
        wall_time_s: Callable[[], float] = time.time,
        faults: Optional[Faults] = None,
    ) -> None:
        """Opens the history, in its own thread. Whatever is wrong with the file is a fault, and the monitor goes on.

        Args:
            settings: the file and what to keep; None: a history in memory, with the same tables.
            wall_time_s: seconds since 1970.
            faults: receives what is wrong with it; None: not reported.
        """
        self.file = None if settings is None else settings.file
        """Path of the file; None: the history is in memory."""
        self.wall_s = wall_time_s
        keep = settings or _DEFAULT_KEEP
        self._lock = threading.Lock()
        self._on_record: List[OnRecord] = []
        self.faults = Faults() if faults is None else faults
        """What is wrong with the history."""
        self._open_saves: Dict[str, Dict[str, str]] = {}
        self._evidence_until_s: Dict[Tuple[str, str], float] = {}
        self._lost = 0
        self._storage = Storage(self.file, keep.keep_days, keep.keep_mb, self.faults, wall_time_s)
        self._writer = Writer(self._storage)

    def on_record(self, hook: OnRecord) -> None:
        """Calls a function inside the transaction that stores a transition, in the writer's thread.

        It may run again for the same transition if the database has to be replaced: its effects belong into the
        database.
        """
        self._on_record.append(hook)

    def of_robot(self, robot: str) -> RobotHistory:
        """Returns the history of one robot, for its AlertSystem."""
        self.put(lambda connection: self._storage.begin_watch(robot))
        return RobotHistory(self, robot)

    def run(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float = 5.0) -> Result:
        """Runs a function in the writer's thread, in a separate transaction. Not for the path of an alert.

        Args:
            function: receives the connection; must not keep it.
            timeout_s: limit in s. A function that has not begun by then is not run.

        Raises:
            ServiceError: the database failed, or did not answer in time.
        """
        self._check_progress()
        return self._writer.run(function, timeout_s)

    def read(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float = 5.0) -> Result:
        """Runs a query: on a separate connection for a file, else in the writer's thread.

        Raises:
            ServiceError: the database failed, or did not answer in time.
            ConfigError: the file cannot be read.
        """
        if self.file is None or self._storage.is_in_memory:
            return self.run(function, timeout_s)
        with HistoryReader(self.file) as reader:
            result = function(reader.connection)
            report_skipped(self.faults, reader.connection)
            return result

    def close(self) -> None:
        """Stores the end of the run and closes the file; waits at most 2 s."""
        self.put(lambda connection: self._storage.end_run())
        self._writer.close(_CLOSE_TIMEOUT_S)

    def record(self, robot: str, transition: Transition, state: str, evidence: Sequence[Tuple[float, Any]]) -> None:
        """Stores a transition and the state after it; waits at most 0.2 s for the disk. See `RobotHistory.record`."""
        wall_s = self.wall_s()
        row = transition_row(transition, wall_s)
        signal = (robot, transition.signal)
        samples = pack_samples(evidence, self._evidence_until_s.get(signal, -math.inf))

        def insert(connection: sqlite3.Connection) -> None:
            number = connection.execute(INSERT_TRANSITION, row).lastrowid or 0
            connection.execute("INSERT INTO evidence VALUES (?, ?)", (number, samples))
            self._storage.note_transition(number, row[1], row[2], row[4], row[13])
            self._storage.write_states(robot, {transition.signal: state})
            for hook in self._on_record:
                self._run_hook(hook, connection, number, transition, wall_s)

        job = Job(insert)
        self._check_progress()
        with self._lock:
            is_waiting = self._writer.put(job)
            if is_waiting:
                self._open_saves.pop(robot, None)  # later states go behind this transition
                if evidence:
                    self._evidence_until_s[signal] = evidence[-1][0]
        if is_waiting:
            self._writer.wait(job, COMMIT_TIMEOUT_S)
        else:
            self._lost += 1
            self.faults.report(LOST_PART, f"{self._lost} transitions were announced, but could not be stored in time")
            self.save(robot, {transition.signal: state})

    def save(self, robot: str, states: Mapping[str, str]) -> None:
        """Stores states of signals, in JSON; returns at once."""
        with self._lock:
            waiting = self._open_saves.get(robot)
            if waiting is not None:
                waiting.update(states)
                return
            waiting = self._open_saves[robot] = dict(states)

            def write(connection: sqlite3.Connection) -> None:
                with self._lock:
                    if self._open_saves.get(robot) is waiting:
                        del self._open_saves[robot]
                self._storage.write_states(robot, waiting)

            # Also if many jobs are waiting: between two transitions there is one such job per robot at most.
            self._writer.put(Job(write), is_urgent=True)

    def put(self, function: Callable[[sqlite3.Connection], object]) -> None:
        """Runs a function in the writer's thread, after everything requested before; returns at once."""
        self._check_progress()
        self._writer.put(Job(function))

    def remove(self, robot: str) -> None:
        """Stores that a robot is no longer watched."""
        self.put(lambda connection: self._storage.end_watch(robot))

    def _check_progress(self) -> None:
        busy_s = self._writer.busy_s
        if busy_s > SLOW_S:
            self.faults.report(PART, f"{self.file}: the disk has not responded for {busy_s:.0f} s")

    def _run_hook(
        self, hook: OnRecord, connection: sqlite3.Connection, number: int, transition: Transition, wall_s: float
    ) -> None:
        """Runs a hook so that its mistakes do not affect the transition."""
        connection.execute("SAVEPOINT hook")
        try:
            hook(connection, number, transition, wall_s)
        except Exception as error:
            if is_file_error(error):
                raise
            connection.execute("ROLLBACK TO hook")
            self.faults.report(_HOOK_PART, f"{type(error).__name__}: {error}")
        else:
            self.faults.clear(_HOOK_PART)
        connection.execute("RELEASE hook")


class RobotHistory:
    """The history of one robot: what its AlertSystem needs (`core.continuity.SignalHistory`)."""

    def __init__(self, history: History, robot: str) -> None:
        """Use `History.of_robot`."""
        self._history = history
        self._robot = robot
        self._faults = history.faults

    @property
    def is_kept(self) -> bool:
        """Whether it is in a file."""
        return self._history.file is not None

    def wall_s(self) -> float:
        """Returns the time in seconds since 1970."""
        return self._history.wall_s()

    def restore(self) -> Mapping[str, SavedSignal]:
        """Returns the last stored state of each signal, by name; empty if the history cannot be read."""
        try:
            return self._history.run(lambda connection: read_states(connection, self._robot), _RESTORE_TIMEOUT_S)
        except ServiceError as error:
            self._faults.report(PART, str(error))
            return {}

    def watched_until_s(self) -> Optional[float]:
        """Returns when the robot was last watched before this run, in s since 1970; None if that is unknown."""
        query = """
            SELECT max(coalesce(watches.stopped_s, runs.stopped_s, runs.alive_s))
            FROM watches JOIN runs ON runs.id = run_id
            WHERE robot = ?1 AND watches.id < (SELECT max(id) FROM watches WHERE robot = ?1)
        """
        try:
            row = self._history.run(
                lambda connection: connection.execute(query, (self._robot,)).fetchone(), _RESTORE_TIMEOUT_S
            )
        except ServiceError as error:
            self._faults.report(PART, str(error))
            return None
        return row[0] if isinstance(row[0], float) else None

    def record(self, transition: Transition, saved: SavedSignal, evidence: Sequence[Tuple[float, Any]]) -> None:
        """Stores a transition, and the state of its signal after it, in one transaction. Call before the outlets.

        Returns when it is committed, after 0.2 s at the latest.

        Args:
            transition: what is about to be announced.
            saved: the state of its signal, plain JSON values; empty: the signal is no longer watched.
            evidence: the window's samples: wall time in s since 1970, value; at most 300.
        """
        try:
            self._history.record(self._robot, transition, json.dumps(saved), evidence)
        except Exception as error:
            self._faults.report(PART, f"a transition was not stored: {type(error).__name__}: {error}")

    def save(self, states: Mapping[str, SavedSignal]) -> None:
        """Stores states of signals without a transition; returns at once.

        Args:
            states: those that changed, by signal; plain JSON values. Empty: the signal is no longer watched.
        """
        try:
            self._history.save(self._robot, {signal: json.dumps(state) for signal, state in states.items()})
        except Exception as error:
            self._faults.report(PART, f"states were not stored: {type(error).__name__}: {error}")

    def record_reset(self) -> None:
        """Stores that latched alerts were reset; returns at once."""
        row = (self.wall_s(), self._robot)
        self._history.put(
            lambda connection: connection.execute("INSERT INTO resets (wall_s, robot) VALUES (?, ?)", row)
        )

    def record_configuration(self, configuration: Mapping[str, Mapping[str, Any]]) -> None:
        """Stores the configuration in force as JSON; returns at once. The same configuration is stored only once.

        Args:
            configuration: the settings of each signal by its name, those of the node under the empty name.
        """
        text = json.dumps(configuration, default=str)
        key = hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()
        row = (self.wall_s(), self._robot, key)

        def insert(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT OR IGNORE INTO configurations VALUES (?, ?)", (key, text))
            connection.execute("INSERT INTO configuration_changes (wall_s, robot, hash) VALUES (?, ?, ?)", row)

        self._history.put(insert)

    def close(self) -> None:
        """Stores that the robot is no longer watched. Not needed at the end of the process."""
        self._history.remove(self._robot)
