"""Errors of real SQLite databases are recognized."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest

from robot_health_monitor.ops.history.database_errors import is_damage, is_file_error, reason


def error_of(connection: sqlite3.Connection, statement: str) -> sqlite3.Error:
    """Returns the error of a statement."""
    with pytest.raises(sqlite3.Error) as caught:
        connection.execute(statement).fetchall()
    return caught.value


def test_garbage_is_damage(tmp_path: Path) -> None:
    file = tmp_path / "file.db"
    file.write_bytes(b"garbage " * 1000)
    error = error_of(sqlite3.connect(file), "SELECT * FROM sqlite_master")
    assert is_damage(error) and is_file_error(error)


def test_overwritten_pages_are_damage(tmp_path: Path) -> None:
    file = tmp_path / "file.db"
    connection = sqlite3.connect(file)
    connection.execute("CREATE TABLE samples (x)")
    connection.executemany("INSERT INTO samples VALUES (?)", [("x" * 1000,)] * 100)
    connection.commit()
    connection.close()
    with file.open("r+b") as damaged:
        damaged.seek(4096)
        damaged.write(b"\xa5" * 4096)
    error = error_of(sqlite3.connect(file), "SELECT * FROM samples")
    assert is_damage(error) and is_file_error(error)


def test_a_full_disk_is_an_error_of_the_file_but_no_damage() -> None:
    connection = sqlite3.connect(":memory:")
    connection.execute("PRAGMA max_page_count = 1")
    error = error_of(connection, "CREATE TABLE samples (x)")
    assert is_file_error(error) and not is_damage(error)


def test_a_read_only_file_is_an_error_of_the_file(tmp_path: Path) -> None:
    sqlite3.connect(tmp_path / "file.db").execute("CREATE TABLE samples (x)")
    connection = sqlite3.connect(f"file:{tmp_path}/file.db?mode=ro", uri=True)
    error = error_of(connection, "INSERT INTO samples VALUES (1)")
    assert is_file_error(error) and not is_damage(error)


def test_a_locked_file_is_an_error_of_the_file(tmp_path: Path) -> None:
    holder = sqlite3.connect(tmp_path / "file.db", isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    error = error_of(sqlite3.connect(tmp_path / "file.db", timeout=0.0, isolation_level=None), "BEGIN IMMEDIATE")
    assert is_file_error(error) and not is_damage(error)


def test_a_folder_that_does_not_exist_is_an_error_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(sqlite3.Error) as caught:
        sqlite3.connect(tmp_path / "none" / "file.db")
    assert is_file_error(caught.value) and not is_damage(caught.value)


def test_a_mistake_in_a_statement_is_no_error_of_the_file() -> None:
    assert not is_file_error(error_of(sqlite3.connect(":memory:"), "SELECT * FROM missing"))


def test_the_reason_names_the_file_once() -> None:
    assert reason(PermissionError(13, "Permission denied", "/var/x.lock"), "/var/x") == "/var/x.lock: Permission denied"
    assert reason(sqlite3.OperationalError("disk I/O error"), "/var/x") == "/var/x: disk I/O error"
