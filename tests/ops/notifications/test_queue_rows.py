"""Rows of the queue with unexpected values."""

from __future__ import annotations

import json
import sqlite3
from typing import Any

import pytest
from harness.histories import transition

from robot_health_monitor.core import Level
from robot_health_monitor.core.transition_json import json_line
from robot_health_monitor.ops.history import schema
from robot_health_monitor.ops.history.checked_rows import CheckedConnection
from robot_health_monitor.ops.notifications.queue_rows import delete_odd_rows, is_transition, restore_open_alerts

LINE = json_line(transition(1, fingerprint="fp"))


@pytest.fixture
def connection() -> CheckedConnection:
    connection = sqlite3.connect(":memory:", isolation_level=None, factory=CheckedConnection)
    schema.prepare(connection)
    return connection


def test_what_the_monitor_writes_is_a_transition() -> None:
    assert is_transition(LINE)


@pytest.mark.parametrize("line", [None, 5, b"x", "", "[]", "{}", "[" * 100_000, '"text"', "NaN"], ids=repr)
def test_other_values_are_no_transition(line: Any) -> None:
    assert not is_transition(line)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("robot", 5), ("text", None), ("to_level", "BAD"), ("from_level", []), ("now_s", "x"),
        ("since_s", float("inf")), ("repeat", 1), ("hint", 5),
    ],
)  # fmt: skip
def test_an_unexpected_field_makes_it_none(name: str, value: Any) -> None:
    assert not is_transition(json.dumps({**json.loads(LINE), name: value}))


def test_only_odd_rows_are_deleted_and_each_is_noted(connection: CheckedConnection) -> None:
    insert = "INSERT INTO noted_transitions (at_s, transition_json) VALUES (?, ?)"
    connection.executemany(insert, [(1.0, LINE), ("soon", LINE), (2.0, "?"), (float("inf"), LINE), (3.0, LINE)])
    insert = "INSERT INTO notifications (target, fingerprint, level, at_s, transition_json) VALUES (?, ?, ?, ?, ?)"
    rows = [("chat", "fp", 1, 1.0, LINE), ("chat", "fp", 7, 1.0, LINE), ("a", b"b", 1, 1.0, LINE)]
    connection.executemany(insert, rows)
    delete_odd_rows(connection)
    assert connection.execute("SELECT id FROM noted_transitions").fetchall() == [(1,), (5,)]
    assert connection.execute("SELECT id FROM notifications").fetchall() == [(1,)]
    assert len(connection.skipped) == 5


def test_an_open_alert_whose_row_is_odd_stays_open_if_a_target_knows_it(connection: CheckedConnection) -> None:
    connection.execute("INSERT INTO open_alerts VALUES ('fp', 'r1', 'battery_level', 'odd', 1.0, ?)", (LINE,))
    connection.execute("INSERT INTO notified VALUES ('chat', 'fp', 1, 1.0, ?)", (LINE,))
    connection.execute("INSERT INTO notified VALUES ('chat', 'ended', 1, 1.0, ?)", (LINE,))
    delete_odd_rows(connection)
    found = connection.execute("SELECT fingerprint, robot, signal, level, at_s FROM open_alerts").fetchall()
    assert found == [("fp", "r1", "battery_level", int(Level.WARN), 1.0)]
    restore_open_alerts(connection)
    found = connection.execute("SELECT fingerprint FROM open_alerts ORDER BY fingerprint").fetchall()
    assert found == [("ended",), ("fp",)]
