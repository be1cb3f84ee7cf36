"""Tables and versions of a history file."""

from __future__ import annotations

import sqlite3

import pytest

from robot_health_monitor.ops.history import schema


def test_an_empty_database_gets_the_tables_of_the_current_version() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    schema.prepare(connection)
    schema.require_known(connection)
    assert connection.execute("SELECT count(*) FROM transitions").fetchone() == (0,)


def test_a_newer_version_is_refused_and_left_alone() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    connection.execute("PRAGMA user_version = 99")
    with pytest.raises(schema.UnknownSchemaError, match=r"newer version \(schema 99; "):
        schema.prepare(connection)
    assert connection.execute("PRAGMA user_version").fetchone() == (99,)


def test_another_database_is_refused() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    connection.execute("CREATE TABLE songs (title)")
    with pytest.raises(schema.UnknownSchemaError, match="an SQLite database, but not a history"):
        schema.prepare(connection)
