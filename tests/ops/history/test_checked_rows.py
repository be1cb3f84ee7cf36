"""Unexpected values in a history file: each reader gives the rest, and nothing of it stops the monitor."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, Iterator, List, Tuple

import pytest
from harness.filled_history import fill_history, read_everything
from harness.histories import fault_texts, opened, texts, transition

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.ops.active_silences import Silences
from robot_health_monitor.ops.history import schema
from robot_health_monitor.ops.history.checked_rows import CheckedConnection, checked, is_count, is_time, skip
from robot_health_monitor.ops.history.reader import HistoryReader

ODD = ("'text'", "9e999", "9223372036854775807", "x'ff00'", "CAST(x'ff' AS TEXT)")
"""SQL values."""
_WITHOUT_ROWID = ("configurations", "silenced_alerts")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns a history with rows in every table."""
    path = tmp_path / "history.db"
    fill_history(path)
    return path


def columns() -> Iterator[Tuple[str, str]]:
    """Yields every column of every table."""
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    for table in schema.tables(connection):
        for row in connection.execute(f"PRAGMA table_info({table})"):
            yield table, row[1]


@pytest.mark.newest_python
@pytest.mark.parametrize(("table", "column"), list(columns()), ids=lambda name: str(name))
def test_an_odd_value_anywhere_stops_no_reader_and_no_monitor(file: Path, table: str, column: str) -> None:
    for odd in ODD:
        connection = sqlite3.connect(str(file), isolation_level=None)
        connection.execute("BEGIN")
        where = "1" if table in _WITHOUT_ROWID else f"rowid = (SELECT min(rowid) FROM {table})"
        try:
            connection.execute(f"UPDATE {table} SET {column} = {odd} WHERE {where}")
        except sqlite3.Error:  # the key is an integer
            connection.execute("ROLLBACK")
            continue
        finally:
            if connection.in_transaction:
                connection.execute("COMMIT")
            connection.close()
        with HistoryReader(file) as reader:
            assert len(read_everything(reader.connection)) >= 4
        faults = Faults()
        history = opened(file, faults, keep_days=30_000.0)
        robot = history.of_robot("r9")
        silences = Silences(history, faults)
        robot.restore()
        robot.watched_until_s()
        robot.record(transition(77, robot="r9"), {"level": 1}, [])
        assert "battery_level WARN: number 77" in texts(history)
        silences.silence_of("r9", "battery_level")
        silences.close()
        history.close()
        assert not [text for part, text in fault_texts(faults) if part not in ("history rows", "silence list")]


def database() -> CheckedConnection:
    return sqlite3.connect(":memory:", isolation_level=None, factory=CheckedConnection)


def test_skipped_rows_are_noted_in_one_line() -> None:
    connection = database()
    assert connection.skipped_text == ""
    rows: List[Tuple[Any, ...]] = [(1, 1.0), (2, "x"), (3, 9e999), (4, 4.0)]
    assert [*checked(connection, "resets", rows, (is_count, is_time))] == [(1, 1.0), (4, 4.0)]
    assert connection.skipped_text == "2 rows have unexpected values and are skipped (resets 2)"
    assert [*checked(connection, "resets", rows, (is_count, is_time))] == [(1, 1.0), (4, 4.0)]
    assert len(connection.skipped) == 2


def test_the_notes_are_bounded() -> None:
    connection = database()
    for number in range(5000):
        skip(connection, "resets", "x" * number)
    assert len(connection.skipped) <= 1000
    assert max(map(len, connection.skipped)) < 100


def test_text_that_is_not_utf_8_is_read() -> None:
    assert database().execute("SELECT CAST(x'41ff' AS TEXT)").fetchone() == ("A\ufffd",)
