"""Queries of the history."""

from __future__ import annotations

import sqlite3

from robot_health_monitor.ops.history import queries, schema


def test_a_gap_lies_between_the_end_of_a_run_and_the_start_of_the_next() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    runs = [(100.0, 150.0, 150.0), (160.0, 190.0, None), (200.0, 210.0, None)]
    connection.executemany("INSERT INTO runs (started_s, alive_s, stopped_s, version) VALUES (?, ?, ?, '1')", runs)
    assert queries.gaps(connection) == [(150.0, 160.0, False), (190.0, 200.0, True)]
    assert queries.gaps(connection, since_s=161.0) == [(190.0, 200.0, True)]
