"""A queue whose tables in the history are damaged: notifications go on, and the monitor says so."""

from __future__ import annotations

import json
import sqlite3
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Callable, Iterator, List, Tuple

import pytest
from harness.histories import fault_texts, texts, transition
from harness.http_server import HttpServer
from harness.waiting import WAIT_S, wait_for

from robot_health_monitor.core import Level
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.outlets import json_line
from robot_health_monitor.ops.active_silences import Silences
from robot_health_monitor.ops.configuration import HistorySettings, TargetSettings
from robot_health_monitor.ops.history import schema
from robot_health_monitor.ops.history.history import History
from robot_health_monitor.ops.history.rows import CheckedConnection
from robot_health_monitor.ops.history.schema import QUEUE_TABLES
from robot_health_monitor.ops.matchers import parse_matchers
from robot_health_monitor.ops.notifications import Notifier
from robot_health_monitor.ops.notifications.database import (
    QueueDatabase,
    delete_odd_rows,
    is_transition,
    restore_open_alerts,
)

DAMAGE = ("DROP TABLE {0}", "ALTER TABLE {0} RENAME TO other", "ALTER TABLE {0} RENAME COLUMN transition_json TO other")


@contextmanager
def running(file: Path, server: HttpServer) -> Iterator[Tuple[History, Notifier, Faults, Silences]]:
    faults = Faults()
    history = History(HistorySettings(str(file)), faults=faults)
    silences = Silences(history)
    notifier = Notifier(history, [TargetSettings("chat", "webhook", url=server.url)], silences, faults)
    history.of_robot("r3")
    try:
        yield history, notifier, faults, silences
    finally:
        notifier.close()
        silences.close()
        history.close()


def record(history: History, level: Level, signal: str = "battery") -> None:
    event = transition(0, level, robot="r3", signal=signal, fingerprint=signal, text=f"{signal} {level.name}")
    history.of_robot("r3").record(event, {"level": 1}, [])


def received(server: HttpServer) -> str:
    return str(server.next().json["text"])


def received_without(server: HttpServer, ignored: str) -> str:
    found = received(server)
    while found == ignored:
        found = received(server)
    return found


def change(file: Path, *statements: str) -> None:
    """Changes a file as another program would."""
    connection = sqlite3.connect(str(file), timeout=WAIT_S, isolation_level=None)
    for statement in statements:
        connection.execute(statement)
    connection.close()


@pytest.mark.parametrize("table", QUEUE_TABLES)
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_queue_whose_table_is_damaged_goes_on_in_memory(
    server: HttpServer, tmp_path: Path, damage: str, table: str
) -> None:
    file = tmp_path / "history.db"
    with running(file, server) as (history, notifier, faults, silences):
        record(history, Level.WARN, "before")
        assert received(server) == "r3: before WARN"
        wait_for(lambda: notifier.waiting == 0)
        silences.add(parse_matchers("signal=silenced"), for_s=3600.0)
        change(file, damage.format(table))
        record(history, Level.WARN, "silenced")
        record(history, Level.WARN)
        record(history, Level.OK)
        # What was sent may be unknown now: it is sent at least once.
        assert received_without(server, "r3: before WARN") == "r3: battery WARN"
        assert received_without(server, "r3: before WARN") == "r3: battery OK"
        wait_for(lambda: any(part == "notification queue" for part, _ in fault_texts(faults)))
        [text] = [text for part, text in fault_texts(faults) if part == "notification queue"]
        assert text.startswith("its tables in the history cannot be used (")
        record(history, Level.OK, "before")
        assert received_without(server, "r3: before WARN") == "r3: before OK"
        assert texts(history)[-1] == "before OK"


@pytest.mark.parametrize("table", QUEUE_TABLES)
def test_a_queue_that_is_damaged_at_the_start_is_in_memory(server: HttpServer, tmp_path: Path, table: str) -> None:
    file = tmp_path / "history.db"
    with running(file, server):
        pass
    change(file, f"DROP TABLE {table}")
    with running(file, server) as (history, _, faults, _):
        record(history, Level.WARN)
        assert received(server) == "r3: battery WARN"
        wait_for(lambda: any(part == "notification queue" for part, _ in fault_texts(faults)))


def odd_rows() -> List[Tuple[str, str]]:
    """Returns statements that put an odd value into each column of the queue, by table."""
    values = ("'text'", "9e999", "x'ff00'", "'{}'", "'[1]'")
    return [
        (table, f"UPDATE {table} SET {column} = {value}")
        for table, columns in {
            "open_alerts": ("robot", "level", "at_s", "transition_json"),
            "notified": ("level", "since_s", "transition_json"),
        }.items()
        for column in columns
        for value in values
    ]


@pytest.mark.parametrize(("table", "statement"), odd_rows())
def test_an_odd_row_stops_no_other_notification(server: HttpServer, tmp_path: Path, table: str, statement: str) -> None:
    file = tmp_path / "history.db"
    with running(file, server) as (history, notifier, _, _):
        record(history, Level.WARN)
        assert received(server) == "r3: battery WARN"
        wait_for(lambda: notifier.waiting == 0)
    change(file, statement)
    with running(file, server) as (history, _, _, _):
        record(history, Level.WARN, "temperature")
        found = received(server)
        while found != "r3: temperature WARN":
            assert found.startswith("r3: battery")  # again, or its end
            found = received(server)


def test_another_mistake_reaches_the_caller(tmp_path: Path) -> None:
    history: Any = History(None)
    database = QueueDatabase(history, Faults(), lambda connection, is_unknown: None)

    def fail(connection: sqlite3.Connection) -> None:
        raise LookupError("x")

    function: Callable[[sqlite3.Connection], None] = fail
    with pytest.raises(LookupError):
        database.run(function)
    history.close()


# Rows with unexpected values

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
