"""Queries of the history."""

from __future__ import annotations

import math
import sqlite3
from typing import Any

import pytest
from harness.histories import transition

from robot_health_monitor.core import Level
from robot_health_monitor.ops.store import queries, schema
from robot_health_monitor.ops.store.rows import INSERT_TRANSITION, pack_samples, transition_row


def test_a_gap_lies_between_the_end_of_a_run_and_the_start_of_the_next() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    runs = [(100.0, 150.0, 150.0), (160.0, 190.0, None), (200.0, 210.0, None)]
    connection.executemany("INSERT INTO runs (started_s, alive_s, stopped_s, version) VALUES (?, ?, ?, '1')", runs)
    assert queries.gaps(connection) == [(150.0, 160.0), (190.0, 200.0)]
    assert queries.gaps(connection, since_s=161.0) == [(190.0, 200.0)]


@pytest.fixture
def connection() -> sqlite3.Connection:
    """Returns a database with five transitions; before the third the wall clock was set back by 100 s."""
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    rows = [
        (1000.0, transition(1, Level.WARN, robot="r1", signal="battery_level")),
        (1010.0, transition(2, Level.ERROR, robot="r2", signal="battery_temp")),
        (920.0, transition(3, Level.OK, robot="r1", signal="battery_level")),
        (930.0, transition(4, Level.WARN, robot="r2", signal="cpu_usage")),
        (1020.0, transition(5, Level.STALE, robot="r1", signal="cpu_usage")),
    ]
    connection.executemany(INSERT_TRANSITION, [transition_row(each, wall_s) for wall_s, each in rows])
    columns = "robot, signal, alert_id, transition_id, level, begun_s, at_s, fingerprint, transition_json"
    opened = [("r2", "battery_temp", 2), ("r2", "cpu_usage", 4), ("r1", "cpu_usage", 5)]
    insert = f"INSERT INTO open_alerts ({columns}) VALUES (?1, ?2, ?3, ?3, 1, 0.0, 0.0, '', '')"
    connection.executemany(insert, opened)
    return connection


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, [1, 2, 3, 4, 5]),
        ({"newest": 9}, [5, 4, 3, 2, 1]),
        ({"since_s": 930.0}, [1, 2, 4, 5]),
        ({"since_s": 2000.0}, []),
        ({"robot": "r1"}, [1, 3, 5]),
        ({"robot": "r*"}, [1, 2, 3, 4, 5]),
        ({"signal": "battery*"}, [1, 2, 3]),
        ({"signal": "battery_[lt]*"}, []),
        ({"robot": "r?", "signal": "cpu_usage"}, [4, 5]),
        ({"level": Level.WARN}, [1, 4]),
        ({"before_id": 3}, [1, 2]),
        ({"before_id": 4, "newest": 2}, [3, 2]),
        ({"newest": 3}, [5, 4, 3]),
        ({"newest": 1, "level": Level.WARN}, [4]),
        ({"open_only": True}, [2, 4, 5]),
        ({"open_only": True, "level": Level.WARN}, [4]),
        ({"open_only": True, "robot": "r1", "newest": 9}, [5]),
    ],
)
@pytest.mark.parametrize("page", [1, 2, 500])
def test_transitions_are_filtered_and_come_in_their_order(
    connection: sqlite3.Connection,
    options: dict[str, Any],
    expected: list[int],
    page: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(queries, "_PAGE", page)
    assert [each.id for each in queries.transitions(connection, **options)] == expected


def test_a_pattern_with_many_stars_takes_no_time(connection: sqlite3.Connection) -> None:
    connection.execute("UPDATE transitions SET signal = ?", ("a" * 200,))
    assert list(queries.transitions(connection, signal="*a" * 60 + "*b")) == []


def test_the_begin_of_a_time_is_found_by_the_index(connection: sqlite3.Connection) -> None:
    plans = []
    connection.set_trace_callback(plans.append)
    queries.number_range(connection, 1000.0)
    connection.set_trace_callback(None)
    [query] = [each for each in plans if "wall_s" in each]
    steps = [row[3] for row in connection.execute(f"EXPLAIN QUERY PLAN {query}")]
    assert ["transitions_by_time" in step for step in steps] == [True]


def test_one_transition_and_its_evidence(connection: sqlite3.Connection) -> None:
    connection.execute("INSERT INTO evidence VALUES (2, ?)", (pack_samples([(1.0, 2.0)]),))
    found = queries.transition(connection, 2)
    assert found is not None and found.text == "battery_temp ERROR: number 2"
    assert queries.transition(connection, 99) is None
    assert queries.evidence(connection, 2) == [(1.0, 2.0)]
    assert queries.evidence(connection, 1) == []


def test_samples_that_are_stored_with_earlier_transitions_are_found(connection: sqlite3.Connection) -> None:
    connection.execute("DELETE FROM transitions")
    insert = INSERT_TRANSITION.replace("(wall_s", "(id, wall_s").replace("(?", "(?, ?")
    windows = {
        1: [(10.0, 0.0), (12.0, 1.0)],
        2: [(10.0, 0.0), (12.0, 1.0), (13.0, 2.0)],
        3: [(12.0, 1.0), (13.0, 2.0)],  # the window has moved on, without a new sample
        5: [(12.0, 1.0), (13.0, 2.0), (14.0, 3.0)],
    }
    until_s = -math.inf
    for number, samples in windows.items():
        row = transition_row(transition(number, signal="a"), 100.0)
        connection.execute(insert, (number, *row))
        connection.execute("INSERT INTO evidence VALUES (?, ?)", (number, pack_samples(samples, until_s)))
        until_s = samples[-1][0]
    connection.execute(insert, (4, *transition_row(transition(4, signal="b"), 100.0)))
    connection.execute("INSERT INTO evidence VALUES (4, ?)", (pack_samples([(13.5, 9.0)]),))
    sizes = connection.execute("SELECT length(samples) FROM evidence ORDER BY transition_id").fetchall()
    assert sizes == [(32,), (20,), (8,), (20,), (20,)]
    for number, samples in windows.items():
        assert queries.evidence(connection, number) == samples
    connection.execute("DELETE FROM transitions WHERE id = 1")
    assert queries.evidence(connection, 2) == [(13.0, 2.0)]


def test_monitor_events_are_starts_stops_resets_and_configurations(connection: sqlite3.Connection) -> None:
    runs = [(100.0, 150.0, 150.0), (160.0, 190.0, None), (200.0, 210.0, None)]
    connection.executemany("INSERT INTO runs (started_s, alive_s, stopped_s, version) VALUES (?, ?, ?, '1.0')", runs)
    connection.execute("INSERT INTO resets (wall_s, robot) VALUES (110.0, 'r1'), (111.0, 'r2')")
    connection.execute("INSERT INTO configuration_changes (wall_s, robot, hash) VALUES (101.0, 'r1', 'abc')")
    assert queries.monitor_events(connection, 101.0, robot="r1") == [
        (101.0, "configuration", "r1", "abc"),
        (110.0, "reset", "r1", ""),
        (150.0, "stopped", "", ""),
        (160.0, "started", "", "1.0"),
        (190.0, "killed", "", ""),
        (200.0, "started", "", "1.0"),  # the present run has neither ended nor been killed
    ]


def test_the_configuration_is_the_one_in_force_at_a_time() -> None:
    connection = sqlite3.connect(":memory:", isolation_level=None)
    schema.prepare(connection)
    for number, (wall_s, robot) in enumerate(((10.0, "r1"), (20.0, "r1"), (15.0, "r1"), (12.0, "r2")), 1):
        connection.execute("INSERT INTO configurations VALUES (?, ?)", (str(number), f'{{"number": {number}}}'))
        insert = "INSERT INTO configuration_changes (wall_s, robot, hash) VALUES (?, ?, ?)"
        connection.execute(insert, (wall_s, robot, str(number)))

    def number(robot: str, at_s: float) -> int | None:
        found = queries.configuration(connection, robot, at_s)
        return None if found is None else found["number"]

    assert [number("r1", at_s) for at_s in (10.0, 12.0, 16.0, 30.0)] == [1, 1, 3, 3]  # the clock was set back at 20
    assert number("r1", 5.0) == 1  # the first one, if all are later
    assert (number("r2", 30.0), number("r3", 30.0)) == (4, None)
    connection.execute("UPDATE configurations SET text = '[]'")
    assert number("r1", 30.0) is None
