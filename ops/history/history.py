"""The history of one monitor process: stores transitions before they are announced, and the state for a restart."""

from __future__ import annotations

import hashlib
import json
import sqlite3
import threading
import time
from typing import Any, Callable, Dict, List, Mapping, Optional, Sequence, Tuple, TypeVar

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Transition
from robot_health_monitor.core.version import package_version

from ..configuration import HistorySettings
from . import schema
from .reader import HistoryReader
from .rows import TRANSITION_COLUMNS, pack_samples, transition_row
from .writer import Job, Writer

Result = TypeVar("Result")
OnRecord = Callable[[sqlite3.Connection, int, Transition, float], None]
"""Receives the connection, the id of the transition, the transition, and the wall time in s."""

COMMIT_TIMEOUT_S = 0.2
"""How long a transition waits for the disk before it is announced."""

_RESTORE_TIMEOUT_S = 5.0
_CLOSE_TIMEOUT_S = 2.0
_PART = "history"
_NO_STATE = "{}"

_INSERT_TRANSITION = f"INSERT INTO transitions ({TRANSITION_COLUMNS}) VALUES ({', '.join('?' * 14)})"


class History:
    """Writes a history file, or keeps a history in memory. All methods may be called from any thread."""

    def __init__(self, settings: Optional[HistorySettings], wall_time_s: Callable[[], float] = time.time) -> None:
        """Opens the history.

        Args:
            settings: the file and what to keep; None: a history in memory, with the same tables.
            wall_time_s: seconds since 1970.
        """
        self._settings = settings
        self.wall_s = wall_time_s
        self._lock = threading.Lock()
        self._on_record: List[OnRecord] = []
        self._faults: List[Faults] = []
        self._open_saves: Dict[str, Dict[str, str]] = {}
        self._is_late = False
        self._run_id = 0
        self._writer = Writer(self._open, self._keep_alive)

    @property
    def file(self) -> Optional[str]:
        """Path of the file; None: the history is in memory."""
        return None if self._settings is None else self._settings.file

    def on_record(self, hook: OnRecord) -> None:
        """Calls a function inside the transaction that stores a transition, in the writer thread."""
        self._on_record.append(hook)

    def of_robot(self, robot: str, faults: Faults) -> RobotHistory:
        """Returns the history of one robot, for its AlertSystem.

        Args:
            robot: its name.
            faults: receives the faults of the history.
        """
        self._faults.append(faults)
        return RobotHistory(self, robot, faults)

    def run(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float = 5.0) -> Result:
        """Runs a function in the writer thread, in a transaction of its own. Not for the path of an alert.

        Args:
            function: receives the connection; must not keep it.
            timeout_s: limit in s. A function that has not begun by then is not run.

        Raises:
            ServiceError: the database failed, or did not answer in time.
        """
        return self._writer.run(function, timeout_s)

    def read(self, function: Callable[[sqlite3.Connection], Result], timeout_s: float = 5.0) -> Result:
        """Runs a query: on a connection of its own for a file, else in the writer thread.

        Raises:
            ServiceError: the database failed, or did not answer in time.
            ConfigError: the file cannot be read.
        """
        if self.file is None:
            return self.run(function, timeout_s)
        with HistoryReader(self.file) as reader:
            return function(reader.connection)

    def close(self) -> None:
        """Stores the end of the run and closes the file; waits at most 2 s."""
        self._writer.put(Job(self._end_run))
        self._writer.close(_CLOSE_TIMEOUT_S)

    def record(self, robot: str, transition: Transition, state: str, evidence: Sequence[Tuple[float, Any]]) -> None:
        """Stores a transition and the state after it; waits at most 0.2 s for the disk. See `RobotHistory.record`."""
        wall_s = self.wall_s()
        row = transition_row(transition, wall_s)
        samples = pack_samples(evidence)

        def insert(connection: sqlite3.Connection) -> None:
            number = connection.execute(_INSERT_TRANSITION, row).lastrowid
            assert number is not None
            connection.execute("INSERT INTO evidence VALUES (?, ?)", (number, samples))
            _write_states(connection, robot, {transition.signal: state})
            for hook in self._on_record:
                hook(connection, number, transition, wall_s)

        with self._lock:
            self._open_saves.pop(robot, None)  # later states go behind this transition
        job = Job(insert)
        if self._writer.put(job) and not self._is_late:
            self._is_late = not job.done.wait(COMMIT_TIMEOUT_S)

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
            _write_states(connection, robot, waiting)

        self._writer.put(Job(write))

    def put(self, function: Callable[[sqlite3.Connection], object]) -> None:
        """Runs a function in the writer thread, after everything requested before; returns at once."""
        self._writer.put(Job(function))

    def _open(self) -> sqlite3.Connection:
        name = ":memory:" if self._settings is None else self._settings.file
        connection = sqlite3.connect(name, isolation_level=None, check_same_thread=False)
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA synchronous = NORMAL")
        schema.prepare(connection)
        now_s = self.wall_s()
        insert = "INSERT INTO runs (started_s, alive_s, version) VALUES (?, ?, ?)"
        self._run_id = connection.execute(insert, (now_s, now_s, package_version())).lastrowid or 0
        return connection

    def _keep_alive(self, connection: sqlite3.Connection) -> None:
        self._is_late = False
        connection.execute("UPDATE runs SET alive_s = ? WHERE id = ?", (self.wall_s(), self._run_id))

    def _end_run(self, connection: sqlite3.Connection) -> None:
        now_s = self.wall_s()
        update = "UPDATE runs SET alive_s = ?, stopped_s = ? WHERE id = ?"
        connection.execute(update, (now_s, now_s, self._run_id))


class RobotHistory:
    """The history of one robot: what its AlertSystem needs (`core.continuity.SignalHistory`)."""

    def __init__(self, history: History, robot: str, faults: Faults) -> None:
        """Use `History.of_robot`."""
        self._history = history
        self._robot = robot
        self._faults = faults

    def wall_s(self) -> float:
        """Returns the time in seconds since 1970."""
        return self._history.wall_s()

    def restore(self) -> Mapping[str, Mapping[str, Any]]:
        """Returns the last stored state of each signal, by name; empty if the history cannot be read."""
        query = "SELECT signal, state FROM signal_states WHERE robot = ?"
        try:
            rows = self._history.run(
                lambda connection: connection.execute(query, (self._robot,)).fetchall(), _RESTORE_TIMEOUT_S
            )
        except ServiceError as error:
            self._faults.report(_PART, str(error))
            return {}
        return {signal: json.loads(state) for signal, state in rows}

    def record(self, transition: Transition, saved: Mapping[str, Any], evidence: Sequence[Tuple[float, Any]]) -> None:
        """Stores a transition, and the state of its signal after it, in one transaction. Call before the outlets.

        Returns when it is committed, after 0.2 s at the latest. Never raises.

        Args:
            transition: what is about to be announced.
            saved: the state of its signal, plain JSON values; empty: the signal is no longer watched.
            evidence: the window's samples: wall time in s since 1970, value; at most 300.
        """
        self._history.record(self._robot, transition, json.dumps(saved), evidence)

    def save(self, states: Mapping[str, Mapping[str, Any]]) -> None:
        """Stores states of signals without a transition; returns at once.

        Args:
            states: those that changed, by signal; plain JSON values. Empty: the signal is no longer watched.
        """
        if states:
            self._history.save(self._robot, {signal: json.dumps(state) for signal, state in states.items()})

    def record_reset(self) -> None:
        """Stores that latched alerts were reset; returns at once."""
        row = (self.wall_s(), self._robot)
        self._history.put(
            lambda connection: connection.execute("INSERT INTO resets (wall_s, robot) VALUES (?, ?)", row)
        )

    def record_configuration(self, text: str) -> None:
        """Stores the configuration in force; returns at once. The same text is stored only once.

        Args:
            text: the configuration, for instance in JSON.
        """
        key = hashlib.sha256(text.encode("utf-8", "backslashreplace")).hexdigest()
        row = (self.wall_s(), self._robot, key)

        def insert(connection: sqlite3.Connection) -> None:
            connection.execute("INSERT OR IGNORE INTO configurations VALUES (?, ?)", (key, text))
            connection.execute("INSERT INTO configuration_changes (wall_s, robot, hash) VALUES (?, ?, ?)", row)

        self._history.put(insert)


def _write_states(connection: sqlite3.Connection, robot: str, states: Mapping[str, str]) -> None:
    kept = [(robot, signal, state) for signal, state in states.items() if state != _NO_STATE]
    gone = [(robot, signal) for signal, state in states.items() if state == _NO_STATE]
    connection.executemany("INSERT OR REPLACE INTO signal_states VALUES (?, ?, ?)", kept)
    connection.executemany("DELETE FROM signal_states WHERE robot = ? AND signal = ?", gone)
