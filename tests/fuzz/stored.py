"""What is fuzzed of a history file: rows that another program, a crash or a bad disk has changed."""

from __future__ import annotations

import random
import shutil
import sqlite3
import tempfile
from pathlib import Path
from typing import Any, Sequence, Tuple

from fuzz.mutations import NUMBERS, any_text
from fuzz.targets import Target
from fuzz.work import Work
from harness.filled_history import fill_history, read_everything
from harness.histories import opened, texts, transition

from robot_health_monitor.core.values.faults import Faults
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.database_file import reading

Change = Tuple[str, str, Any]
"""Table, column, value."""


class HistoryRows(Target):
    """A history file with changed values: every reader gives the rest, and a monitor starts with it."""

    name = "history"

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory()
        self._filled = Path(self._folder.name) / "filled.db"
        self._file = Path(self._folder.name) / "history.db"
        fill_history(self._filled)
        connection = sqlite3.connect(str(self._filled))
        query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%'"
        self._columns = [
            (table, row[1])
            for (table,) in connection.execute(query).fetchall()
            for row in connection.execute(f"PRAGMA table_info({table})")
        ]
        connection.close()

    def make(self, chance: random.Random) -> list[Change]:
        return [(*chance.choice(self._columns), self._value(chance)) for _ in range(chance.randrange(1, 5))]

    def use(self, data: list[Change]) -> None:
        shutil.copyfile(self._filled, self._file)
        connection = sqlite3.connect(str(self._file), isolation_level=None)
        for table, column, value in data:
            try:
                connection.execute(f"UPDATE {table} SET {column} = ?", (value,))
            except (sqlite3.Error, OverflowError, UnicodeError):
                pass  # SQLite refuses the value: a key twice, no integer
        connection.close()
        with reading(self._file) as connection:
            read_everything(connection)
        faults = Faults()
        history = opened(self._file, faults, keep_days=30_000.0)
        try:
            robot = history.of_robot("r9")
            Silences(history)
            robot.restore()
            robot.watched_until_s()
            robot.record(transition(77, robot="r9"), {"level": 1}, [])
            assert "battery_level WARN: number 77" in texts(history)
        finally:
            history.close()

    def allowed(self, data: list[Change]) -> Work:
        return Work(2_000_000, 50_000_000)  # SQLite's files, whatever the values

    def close(self) -> None:
        self._folder.cleanup()

    def _value(self, chance: random.Random) -> Any:
        kind = chance.randrange(5)
        if kind == 0:
            return any_text(chance)
        if kind == 1:
            return chance.choice(NUMBERS)
        if kind == 2:
            return bytes(chance.randrange(256) for _ in range(chance.randrange(40)))
        return chance.choice((None, "", 0, -1, 2**63 - 1, -(2**63), float("inf"), "[" * 5_000, '{"a": NaN}'))


STORED_TARGETS: Sequence[type[Target]] = (HistoryRows,)
