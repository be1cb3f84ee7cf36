"""The present run in each database, and the open alerts."""

from __future__ import annotations

from harness.histories import transition

from robot_health_monitor.core import Level
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.present_state import PresentRun, store_transition, write_states
from robot_health_monitor.ops.store.rows import transition_row


def test_a_new_database_has_the_run_and_the_robots_that_are_watched() -> None:
    run = PresentRun(lambda: 1000.0)
    old, new = schema.in_memory(), schema.in_memory()
    run.write(old)
    for robot in ("r0", "r1"):
        run.begin_watch(old, robot)
    run.end_watch(old, "r0")
    run.write(new)
    queries = ("SELECT id, started_s, alive_s, stopped_s FROM runs", "SELECT id, run_id, robot, stopped_s FROM watches")
    found = [new.execute(query).fetchall() for query in queries]
    assert found == [[(1, 1000.0, 1000.0, None)], [(2, 1, "r1", None)]]


def test_an_alert_keeps_its_number_and_its_begin_until_it_begins_again() -> None:
    connection = schema.in_memory()
    schema.number_from(connection, 6)
    query = "SELECT alert_id, transition_id, level, begun_s, at_s FROM open_alerts"
    steps = (
        (Level.OK, Level.WARN, (7, 7, Level.WARN, 1007.0, 1007.0)),
        (Level.WARN, Level.ERROR, (7, 8, Level.ERROR, 1007.0, 1008.0)),
        (Level.ERROR, Level.OK, None),
        (Level.OK, Level.STALE, (10, 10, Level.STALE, 1010.0, 1010.0)),
        (Level.OK, Level.WARN, (11, 11, Level.WARN, 1011.0, 1011.0)),  # its end is missing
    )
    for number, (before, after, expected) in enumerate(steps, 7):
        event = transition(number, after, from_level=before)
        stored, _ = store_transition(connection, transition_row(event, 1000.0 + number), event, 1000.0 + number)
        assert stored == number
        assert connection.execute(query).fetchone() == expected


def test_an_empty_state_deletes_the_one_that_is_stored() -> None:
    connection = schema.in_memory()
    write_states(connection, "r1", {"fan": '{"level": 1}', "gone": '{"level": 2}'})
    write_states(connection, "r1", {"fan": '{"level": 2}', "gone": "{}"})
    query = "SELECT robot, signal, state FROM signal_states"
    assert connection.execute(query).fetchall() == [("r1", "fan", '{"level": 2}')]


def test_a_run_continues_from_the_latest_time_that_is_known() -> None:
    connection = schema.in_memory()
    connection.execute("INSERT INTO runs (started_s, alive_s, version) VALUES (1.0, 500.0, '1')")
    assert PresentRun(lambda: 1000.0).write(connection) == 500.0
    assert PresentRun(lambda: 300.0).write(connection) == 300.0  # the wall clock was set back
