"""The thread that owns the database."""

from __future__ import annotations

import sqlite3
from typing import Iterator

import pytest

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.ops.history.writer import Writer


@pytest.fixture
def writer() -> Iterator[Writer]:
    def open_database() -> sqlite3.Connection:
        return sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)

    opened = Writer(open_database, lambda connection: None)
    yield opened
    opened.close(2.0)


def test_a_function_runs_in_a_transaction(writer: Writer) -> None:
    assert writer.run(lambda connection: connection.in_transaction, 5.0) is True


def test_a_function_that_fails_in_the_database_changes_nothing(writer: Writer) -> None:
    def create_then_fail(connection: sqlite3.Connection) -> None:
        connection.execute("CREATE TABLE made (x)")
        connection.execute("INSERT INTO missing VALUES (1)")

    with pytest.raises(ServiceError, match="history: no such table: missing"):
        writer.run(create_then_fail, 5.0)
    assert writer.run(lambda connection: connection.execute("SELECT * FROM sqlite_master").fetchall(), 5.0) == []
