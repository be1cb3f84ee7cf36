"""Tables and versions of a history file, and copies between databases."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from harness.histories import opened

from robot_health_monitor.ops.store import schema


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
    with pytest.raises(schema.UnusableFileError, match=r"newer version \(schema 99; "):
        schema.prepare(connection)
    assert connection.execute("PRAGMA user_version").fetchone() == (99,)


def test_another_database_is_refused() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    connection.execute("CREATE TABLE songs (title)")
    with pytest.raises(schema.UnusableFileError, match="an SQLite database, but not a history"):
        schema.prepare(connection)


def older(connection: sqlite3.Connection) -> None:
    """Makes a history of the version before the current one: without the column `robot` of resets."""
    schema.prepare(connection)
    connection.execute("INSERT INTO resets (wall_s, robot) VALUES (5.0, 'r1')")
    connection.execute("ALTER TABLE resets RENAME TO new_resets")
    connection.execute("CREATE TABLE resets (id INTEGER PRIMARY KEY AUTOINCREMENT, wall_s REAL NOT NULL)")
    connection.execute("INSERT INTO resets SELECT id, wall_s FROM new_resets")
    connection.execute("DROP TABLE new_resets")


ADD_ROBOT = "ALTER TABLE resets ADD COLUMN robot TEXT NOT NULL DEFAULT ''"
"""Migrates what `older` makes."""


def test_an_older_version_is_migrated_once_and_keeps_its_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "history.db"
    connection = sqlite3.connect(path, isolation_level=None)
    older(connection)
    connection.close()
    monkeypatch.setattr(schema, "SCHEMA_VERSION", schema.SCHEMA_VERSION + 1)
    monkeypatch.setattr(schema, "MIGRATIONS", {schema.SCHEMA_VERSION - 1: (ADD_ROBOT,)})
    connection = sqlite3.connect(path, isolation_level=None)
    with pytest.raises(schema.UnusableFileError, match="an older version of the monitor, which has to open it once"):
        schema.require_known(connection)
    connection.close()
    for _ in range(2):
        history = opened(path)
        assert history.run(lambda database: database.execute("SELECT wall_s, robot FROM resets").fetchall()) == [
            (5.0, "")
        ]
        history.close()
    connection = sqlite3.connect(path)
    assert connection.execute("PRAGMA user_version").fetchone() == (schema.SCHEMA_VERSION,)
    connection.close()


def test_a_migration_that_fails_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    connection = sqlite3.connect(tmp_path / "history.db", isolation_level=None)
    older(connection)
    version = schema.SCHEMA_VERSION
    before = connection.execute("SELECT sql FROM sqlite_master ORDER BY name").fetchall()
    monkeypatch.setattr(schema, "SCHEMA_VERSION", version + 1)
    monkeypatch.setattr(schema, "MIGRATIONS", {version: (ADD_ROBOT, "INSERT INTO missing VALUES (1)")})
    with pytest.raises(sqlite3.Error, match="no such table: missing"):
        schema.prepare(connection)
    assert connection.execute("SELECT sql FROM sqlite_master ORDER BY name").fetchall() == before
    assert connection.execute("PRAGMA user_version").fetchone() == (version,)


def run(connection: sqlite3.Connection, *statements: str) -> None:
    """Executes statements in one transaction."""
    with schema.transaction(connection):
        for statement in statements:
            connection.execute(statement)


def test_a_transaction_is_rolled_back_if_its_block_or_its_commit_fails() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    connection.execute("PRAGMA foreign_keys = ON")
    connection.execute("CREATE TABLE parents (id INTEGER PRIMARY KEY)")
    connection.execute("CREATE TABLE children (parent REFERENCES parents DEFERRABLE INITIALLY DEFERRED)")
    with pytest.raises(sqlite3.OperationalError, match="no such table"):
        run(connection, "INSERT INTO parents VALUES (1)", "DELETE FROM missing")
    with pytest.raises(sqlite3.IntegrityError, match="FOREIGN KEY"):
        run(connection, "INSERT INTO children VALUES (7)")  # found at the commit
    assert not connection.in_transaction
    run(connection, "INSERT INTO parents VALUES (2)")
    assert connection.execute("SELECT id FROM parents").fetchall() == [(2,)]
    assert connection.execute("SELECT parent FROM children").fetchall() == []


def test_an_error_that_has_ended_the_transaction_stays_the_error() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    with pytest.raises(sqlite3.OperationalError, match="no such table"):
        run(connection, "ROLLBACK", "DELETE FROM missing")
    assert not connection.in_transaction


def database() -> sqlite3.Connection:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    return connection


def test_the_present_state_outlasts_the_tables_of_the_file() -> None:
    source, target = database(), database()
    store = "INSERT INTO signal_states VALUES ('r1', ?, ?)"
    source.execute(store, ("a", "1"))
    schema.mirror(source)
    source.execute(store, ("b", "2"))
    source.execute(f"{store} ON CONFLICT (robot, signal) DO UPDATE SET state = excluded.state", ("a", "3"))
    source.execute("INSERT OR REPLACE INTO signal_states VALUES ('r1', 'b', '4')")
    source.execute(store, ("c", "5"))
    source.execute("DELETE FROM signal_states WHERE signal = 'c'")
    with pytest.raises(sqlite3.OperationalError, match="no such table: missing"):
        run(source, "DELETE FROM signal_states", "DELETE FROM missing")
    source.execute("INSERT INTO resets VALUES (10, 1.0, 'r1')")
    for table in schema.LIVE_TABLES:
        source.execute(f"DROP TABLE {table}")
    assert schema.copy_state(source, target)
    assert target.execute("SELECT robot, signal, state FROM signal_states").fetchall() == [
        ("r1", "a", "3"), ("r1", "b", "4"),
    ]  # fmt: skip
    assert target.execute("SELECT seq FROM sqlite_sequence WHERE name = 'resets'").fetchall() == [(10,)]


def test_a_row_that_the_tables_do_not_allow_is_left_out() -> None:
    source, target = database(), database()
    source.execute("DROP TABLE resets")
    source.execute("CREATE TABLE resets (id INTEGER PRIMARY KEY, wall_s, robot)")
    source.execute("INSERT INTO resets VALUES (1, 1.0, 'r1'), (2, 2.0, NULL), (3, 3.0, 'r3')")
    schema.copy_table(source, target, "resets")
    assert target.execute("SELECT id FROM resets ORDER BY id").fetchall() == [(1,), (3,)]


def test_numbers_continue_where_they_were_in_another_database_but_after_those_in_use() -> None:
    source, target = database(), database()
    for connection, rows in ((source, (1, 20)), (target, (10,))):
        for number in rows:
            connection.execute("INSERT INTO resets VALUES (?, 1.0, 'r1')", (number,))
    source.execute("DELETE FROM resets WHERE id = 20")
    schema.copy_numbers(source, target)
    insert = "INSERT INTO resets (wall_s, robot) VALUES (1.0, 'r1')"
    assert target.execute(insert).lastrowid == 21
    schema.copy_numbers(database(), target)
    assert target.execute(insert).lastrowid == 22


def test_numbers_continue_after_a_number() -> None:
    connection = database()
    schema.number_from(connection, 50)
    assert connection.execute("INSERT INTO resets (wall_s, robot) VALUES (1.0, 'r1')").lastrowid == 51
