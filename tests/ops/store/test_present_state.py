"""What a new database begins with, whatever became of the old one."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path
from typing import Sequence

from harness.histories import opened, transition

from robot_health_monitor.core import Level
from robot_health_monitor.ops.store import schema
from robot_health_monitor.ops.store.present_state import PresentState


def watching() -> PresentState:
    """Returns the state of a run that watches r1: a WARN that became an ERROR, and a state."""
    connection = schema.in_memory()
    state = PresentState(lambda: 1000.0)
    state.begin(connection)
    state.begin_watch(connection, "r0")
    state.begin_watch(connection, "r1")
    state.end_watch(connection, "r0")
    state.write_states(connection, "r1", {"fan": '{"level": 2}', "gone": "{}"})
    for number, before, after in ((7, Level.OK, Level.WARN), (9, Level.WARN, Level.ERROR)):
        event = transition(number, after, from_level=before)
        state.note_transition(connection, number, state.alert_of(event), event, 1000.0 + number)
    return state


def written(state: PresentState, unreadable: Sequence[str]) -> object:
    """Returns what is in a new database: runs, watched robots, states, open alerts, and the next number."""
    connection = schema.in_memory()
    state.write(connection, unreadable)
    queries = (
        "SELECT started_s FROM runs", "SELECT robot FROM watches", "SELECT robot, signal, state FROM signal_states",
        "SELECT signal, alert_id, transition_id, level, begun_s, at_s FROM open_alerts",
        "SELECT seq FROM sqlite_sequence WHERE name = 'transitions'",
    )  # fmt: skip
    return [connection.execute(query).fetchall() for query in queries]


def test_a_new_database_has_the_run_its_robots_states_and_open_alerts() -> None:
    run = [[(1000.0,)], [("r1",)], [("r1", "fan", '{"level": 2}')]]
    alert = ("battery_level", 7, 9, int(Level.ERROR), 1007.0, 1009.0)
    assert written(watching(), ["open_alerts"]) == [*run, [alert], [(9,)]]
    assert written(watching(), []) == [*run, [], [(9,)]]  # those of the old database were copied


def test_an_alert_that_begins_again_has_a_new_number() -> None:
    state, connection = watching(), schema.in_memory()
    for number, before, after in ((10, Level.ERROR, Level.OK), (11, Level.OK, Level.STALE)):
        event = transition(number, after, from_level=before)
        began = state.alert_of(event)
        assert began == (7 if after is Level.OK else 0)
        state.note_transition(connection, number, began, event, 1000.0 + number)
    query = "SELECT alert_id, begun_s FROM open_alerts"
    assert connection.execute(query).fetchall() == [(11, 1011.0)]


def test_the_json_of_open_alerts_is_stored_once_something_needs_it(tmp_path: Path) -> None:
    file, query = tmp_path / "history.db", "SELECT signal, transition_json FROM open_alerts ORDER BY signal"
    with closing(opened(file)) as history:
        robot = history.of_robot("r1")
        robot.record_configuration({"fan": {"what_to_do": "clean it"}})
        robot.record(transition(signal="fan", value=15.0), {}, ())
        assert history.run(lambda connection: connection.execute(query).fetchall()) == [("fan", "")]
    with closing(opened(file)) as history:
        history.of_robot("r1").record(transition(signal="link"), {}, ())
        history.run(history.state.keep_lines)
        history.of_robot("r1").record(transition(signal="motor"), {}, ())
        lines = {
            signal: json.loads(line)
            for signal, line in history.run(lambda connection: connection.execute(query).fetchall())
        }
    found = [(line["signal"], line["alert_id"], line["to_level"], line["value"]) for line in lines.values()]
    expected = [(name, number, "WARN", 15.0) for number, name in enumerate(("fan", "link", "motor"), 1)]
    assert found == expected  # fan is of the run before
    assert lines["fan"].pop("what_to_do") == "clean it"
    assert lines["fan"].keys() == lines["motor"].keys()


def test_a_run_continues_from_the_latest_time_that_is_known() -> None:
    connection = schema.in_memory()
    connection.execute("INSERT INTO runs (started_s, alive_s, version) VALUES (1.0, 500.0, '1')")
    assert PresentState(lambda: 1000.0).begin(connection) == 500.0
    assert PresentState(lambda: 300.0).begin(connection) == 300.0  # the wall clock was set back
