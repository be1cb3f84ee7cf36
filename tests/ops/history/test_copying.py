"""Copies between databases."""

from __future__ import annotations

import sqlite3

import pytest

from robot_health_monitor.ops.history import schema
from robot_health_monitor.ops.history.copying import copy_state, copy_table, number_from


def database() -> sqlite3.Connection:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    return connection


def test_a_table_that_cannot_be_read_does_not_keep_the_others_from_being_copied() -> None:
    source, target = database(), database()
    source.execute("INSERT INTO signal_states (robot, signal, state) VALUES ('r1', 'a', '1')")
    source.execute("DROP TABLE notifications")
    source.execute("INSERT INTO silences VALUES (7, 'robot=r1', '', '', 1.0, NULL, 0, NULL, NULL, '', '')")
    assert not copy_state(source, target)
    assert target.execute("SELECT state FROM signal_states").fetchall() == [("1",)]
    assert target.execute("SELECT id FROM silences").fetchall() == [(7,)]
    assert target.execute("SELECT seq FROM sqlite_sequence WHERE name = 'silences'").fetchall() == [(7,)]


def test_a_row_that_the_tables_do_not_allow_is_left_out() -> None:
    source, target = database(), database()
    source.execute("DROP TABLE resets")
    source.execute("CREATE TABLE resets (id INTEGER PRIMARY KEY, wall_s, robot)")
    source.execute("INSERT INTO resets VALUES (1, 1.0, 'r1'), (2, 2.0, NULL), (3, 3.0, 'r3')")
    copy_table(source, target, "resets")
    assert target.execute("SELECT id FROM resets ORDER BY id").fetchall() == [(1,), (3,)]


@pytest.mark.parametrize(("number", "expected"), [(5, 11), (50, 51)])
def test_numbers_continue_after_the_larger_one(number: int, expected: int) -> None:
    connection = database()
    connection.execute("INSERT INTO resets VALUES (10, 1.0, 'r1')")
    number_from(connection, number, ("resets",))
    assert connection.execute("INSERT INTO resets (wall_s, robot) VALUES (2.0, 'r1')").lastrowid == expected
