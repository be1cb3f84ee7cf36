"""The history of a monitor: what it stores, its thread, and what a restarted monitor finds."""

from __future__ import annotations

import sqlite3
import threading
import time
from pathlib import Path
from typing import Iterator

import pytest
from harness.histories import fault_texts, transition

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.judge.sample_summary import SampleSummary
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store import history as history_module
from robot_health_monitor.ops.store import queries
from robot_health_monitor.ops.store.database import MAX_WAITING, Job
from robot_health_monitor.ops.store.database_file import reading
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.samples import read


def low_battery(now_s: float = 1.0) -> Transition:
    """Returns the transition to WARN of a monitor of the robot r1."""
    monitor = Monitor(load_config({"signals": {"battery_level": {"warn_below": 20.0}}}), "r1")
    [transition] = monitor.observe(Sample("battery_level", 15.0, now_s))
    return transition


@pytest.fixture
def history(tmp_path: Path) -> Iterator[History]:
    opened = History(HistorySettings(str(tmp_path / "history.db")), wall_time_s=lambda: 1_000_000.0)
    opened.of_robot("r1").restore()  # waits until the file is open, as AlertSystem does
    yield opened
    opened.close()


def test_a_transition_is_committed_when_record_returns(history: History) -> None:
    robot = history.of_robot("r1")
    robot.record(low_battery(), {"level": 1}, [(999_999.0, 15.0)])
    assert history.file is not None
    with reading(history.file) as connection:
        [stored] = queries.transitions(connection)
        assert (stored.wall_s, stored.robot, stored.to_level, stored.value) == (1_000_000.0, "r1", Level.WARN, 15.0)
        assert queries.evidence(connection, stored.id) == [(999_999.0, 15.0)]


def test_samples_that_several_transitions_have_are_stored_once(history: History) -> None:
    robot = history.of_robot("r1")
    first, second = [(1.0, 15.0), (2.0, 14.0)], [(2.0, 14.0), (3.0, 13.0)]
    robot.record(low_battery(), {"level": 1}, first)
    robot.record(low_battery(2.0), {"level": 1}, second)
    robot.record(low_battery(3.0), {"level": 1}, [])
    assert history.file is not None
    with reading(history.file) as connection:
        found = [queries.evidence(connection, stored.id) for stored in queries.transitions(connection)]
        assert found == [first, second, []]
        sizes = connection.execute("SELECT length(samples) FROM evidence ORDER BY transition_id").fetchall()
        assert sizes == [(32,), (20,), (0,)]


def test_a_restarted_monitor_finds_the_latest_state_of_each_signal(tmp_path: Path) -> None:
    settings = HistorySettings(str(tmp_path / "history.db"))
    first = History(settings)
    robot = first.of_robot("r1")
    robot.save({"battery_level": {"level": 0}, "temperature": {"level": 0}})
    robot.record(low_battery(), {"level": 1}, [])
    robot.save({"temperature": {"level": 2}, "cpu_usage": {"level": 0}})
    robot.save({"cpu_usage": {}})
    first.close()
    second = History(settings)
    assert second.of_robot("r1").restore() == {"battery_level": {"level": 1}, "temperature": {"level": 2}}
    assert second.of_robot("r2").restore() == {}
    second.close()


@pytest.mark.parametrize("with_samples", [True, False])
def test_a_clean_stop_stores_all_samples_unless_they_are_switched_off(with_samples: bool, tmp_path: Path) -> None:
    bus = LocalBus(on_log=lambda line: None)
    settings = HistorySettings(str(tmp_path / "history.db"), samples=with_samples)
    for _ in range(2):  # the second run goes on in the period in which the first one stopped
        node = bus.node("alert_system", parameters={"robot_name": "r1", "signals": {"load": {"warn_above": 80.0}}})
        history = History(settings, lambda: 1_000_000.0 + bus.now_s)
        system = AlertSystem(node, history=history.of_robot("r1"))
        robot = bus.node("robot")
        robot.advertise("load", "std_msgs/Float32")
        for number in range(12):
            robot.publish("load", {"data": 50.0 + number})
            bus.run_until(bus.now_s + 1.0)
        system.close()
        history.close()
        robot.close()
    with reading(settings.file) as connection:
        stored = [(each.start_s - 1e6, each.least, each.most, each.good) for each in read(connection, signal="load")]
    expected = [(0.0, 50.0, 59.0, 10), (10.0, 50.0, 61.0, 10), (20.0, 58.0, 61.0, 4)]
    assert stored == (expected if with_samples else [])


def test_states_in_any_form_do_not_prevent_the_start(history: History) -> None:
    rows = [
        ("a", "{"),
        ("b", "[]"),
        ("c", b"\xff\x00"),
        ("d", 5),
        (b"e", "{}"),
        ("f", "[" * 100_000),
        ("g", '{"x": NaN}'),
    ]
    insert = "INSERT INTO signal_states VALUES ('r1', ?, ?)"
    history.run(lambda connection: connection.executemany(insert, rows))
    robot = history.of_robot("r1")
    assert set(robot.restore()) == {"a", "b", "c", "d", "f", "g"}
    bus = LocalBus()
    signals = {name: {"warn_below": 20.0} for name in "abcdefg"}
    AlertSystem(bus.node("alert_system", parameters={"signals": signals}), history=robot)
    [notice] = [line.text for line in bus.log_lines if "starts without its saved state" in line.text]
    assert notice.startswith("a: ") and notice.endswith("(and 4 other signals)")  # b, c, d and f


def test_a_signal_whose_state_is_not_json_keeps_the_level_that_was_announced(history: History) -> None:
    robot = history.of_robot("r1")
    robot.record(low_battery(), {"announced": {"level": "WARN"}}, [])
    history.run(lambda connection: connection.execute("UPDATE signal_states SET state = 'odd'"))
    bus, announced = LocalBus(), []
    node = bus.node("alert_system", parameters={"robot_name": "r1", "signals": {"battery_level": {"warn_below": 20.0}}})
    AlertSystem(node, {"noted": announced.append}, history=history.of_robot("r1"))
    sensor = bus.node("sensor")
    sensor.advertise("battery_level", "std_msgs/Float32")
    sensor.publish("battery_level", {"data": 15.0})
    assert [event for event in announced if isinstance(event, Transition)] == []
    sensor.publish("battery_level", {"data": 50.0})
    assert [event.to_level for event in announced if isinstance(event, Transition)] == [Level.OK]


def test_hooks_store_rows_in_the_transaction_of_the_transition(history: History) -> None:
    seen: list[object] = []
    history.on_record.append(
        lambda connection, alert, transition, wall_s: seen.append((alert, transition.signal, wall_s))
    )
    history.of_robot("r1").record(low_battery(), {}, [])
    assert seen == [(1, "battery_level", 1_000_000.0)]


def test_a_hook_that_fails_is_a_fault_and_does_not_affect_the_transition(history: History) -> None:
    def fail(connection: sqlite3.Connection, alert: int, transition: Transition, wall_s: float) -> None:
        connection.execute("INSERT INTO resets (wall_s, robot) VALUES (1.0, 'r1')")
        connection.execute("INSERT INTO missing VALUES (1)")

    history.on_record.append(fail)
    history.of_robot("r1").record(low_battery(), {}, [])
    counts = "SELECT (SELECT count(*) FROM transitions), (SELECT count(*) FROM resets)"
    assert history.run(lambda connection: connection.execute(counts).fetchone()) == (1, 0)
    assert fault_texts(history.faults) == [("notifications", "OperationalError: no such table: missing")]


def test_an_alert_keeps_its_number_while_its_level_changes(history: History) -> None:
    robot, seen = history.of_robot("r1"), []
    history.on_record.append(lambda connection, alert, transition, wall_s: seen.append(alert))
    levels = (Level.OK, Level.WARN, Level.ERROR, Level.WARN, Level.OK, Level.STALE)
    for before, after in zip(levels, levels[1:]):
        robot.record(transition(0, after, from_level=before), {}, [])
        robot.record(transition(0, after, from_level=before, signal="fan"), {}, [])
    stored = history.run(lambda connection: [*queries.transitions(connection)])
    assert [(each.id, each.alert_id) for each in stored if each.signal == "fan"] == [
        (2, 2), (4, 2), (6, 2), (8, 2), (10, 10)
    ]  # fmt: skip
    assert seen == [each.alert_id for each in stored]
    query = "SELECT signal, alert_id, transition_id FROM open_alerts"
    assert history.run(lambda connection: connection.execute(query).fetchall()) == [
        ("battery_level", 9, 9), ("fan", 10, 10)
    ]  # fmt: skip


def test_an_alert_keeps_its_number_after_a_restart(tmp_path: Path) -> None:
    settings = HistorySettings(str(tmp_path / "history.db"))
    for before, after in ((Level.OK, Level.WARN), (Level.WARN, Level.ERROR), (Level.ERROR, Level.OK)):
        history = History(settings)
        history.of_robot("r1").record(transition(0, after, from_level=before), {}, [])
        history.close()
    with reading(settings.file) as connection:
        assert [each.alert_id for each in queries.transitions(connection)] == [1, 1, 1]


def test_a_driver_that_renames_itself_leaves_nothing_in_memory(history: History) -> None:
    """Issue: each name of an element that was ever seen stayed in memory."""
    robot = history.of_robot("r1")
    for number in range(3_000):
        name = f"drivers[{number}]"
        robot.record(transition(0, Level.STALE, signal=name), {"level": 1}, [(float(number), 1.0)])
        robot.record(transition(0, Level.OK, from_level=Level.STALE, signal=name), {}, [])
        if number % 500 == 499:  # on a busy machine, too many would wait
            history.run(lambda connection: None, 60.0)
    for table in ("signal_states", "open_alerts"):
        query = f"SELECT count(*) FROM mirrored_{table}"
        assert history.run(lambda connection, query=query: connection.execute(query).fetchone()) == (0,)  # type: ignore[misc]
    assert len(robot._evidence_until_s) <= 1_000


def test_only_the_first_caller_waits_while_the_disk_hangs(history: History, monkeypatch: pytest.MonkeyPatch) -> None:
    has_begun, proceed, waited = threading.Event(), threading.Event(), []
    monkeypatch.setattr(history_module, "COMMIT_TIMEOUT_S", 0.05)
    monkeypatch.setattr(history, "wait", lambda job, timeout_s: waited.append(timeout_s))
    history.put(lambda connection: has_begun.set() or proceed.wait(60.0))  # type: ignore[func-returns-value]
    assert has_begun.wait(60.0)
    while history.busy_s < 0.05:
        pass
    history.of_robot("r1").record(low_battery(), {}, [])
    assert waited == []
    proceed.set()


def test_without_a_file_the_history_is_in_memory() -> None:
    history = History(None, time.time)
    history.of_robot("r1").record(low_battery(), {}, [])
    assert history.run(lambda connection: connection.execute("SELECT count(*) FROM transitions").fetchone()) == (1,)
    history.close()


def test_samples_of_all_robots_wait_in_one_job_and_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history_module, "MAX_WAITING_SAMPLES", 30)
    history = History(None)
    robots = [history.of_robot(name) for name in ("r1", "r2")]
    proceed, has_begun = threading.Event(), threading.Event()

    def hang(connection: sqlite3.Connection) -> None:
        has_begun.set()
        proceed.wait(60.0)

    history.put(hang)
    has_begun.wait(60.0)
    # More jobs than may wait: transitions that do not fit are lost, but samples take no more room.
    while history.submit(Job(lambda connection: None)):
        pass
    for number in range(20):
        for robot in robots:
            robot.record_samples({"a": [SampleSummary(10.0 * number, 1.0, 1.0, 1.0, 1.0, 1, 0, Level.OK)]})
    assert len(history._jobs) == MAX_WAITING + 1
    proceed.set()
    job = Job(lambda connection: [(each.robot, each.start_s) for each in read(connection)])
    assert history.submit(job, is_urgent=True)
    assert history.wait(job, 60.0)
    assert job.result == [(robot, 10.0 * number) for robot in ("r1", "r2") for number in range(5, 20)]
    history.close()


def test_effects_are_stored_with_the_alert_that_is_open(history: History) -> None:
    robot = history.of_robot("r1")
    robot.record_effects({"battery_level": ["lift"]})  # before there is an alert
    robot.record(transition(1, Level.WARN, cause="motor"), {}, [])
    robot.record_effects({"battery_level": ["left", "right"], "other": ["left"]})
    robot.record(transition(2, Level.ERROR, from_level=Level.WARN), {}, [])
    robot.record_effects({"battery_level": ["right", "arm\n1"]})
    history.of_robot("r2").record_effects({"battery_level": ["of_r2"]})
    robot.record(transition(3, Level.OK, from_level=Level.ERROR), {}, [])
    robot.record_effects({"battery_level": ["late"]})
    first, *others = history.run(lambda connection: [*queries.transitions(connection)])
    assert (first.cause, first.effects, first.affects) == ("motor", ["left", "right", "arm?1"], 3)
    assert [(each.cause, each.effects) for each in others] == [("", ()), ("", ())]


def test_a_robot_that_invents_names_cannot_make_an_alert_endless(history: History) -> None:
    robot = history.of_robot("r1")
    robot.record(transition(1, Level.WARN), {}, [])
    for start in (0, 900):
        robot.record_effects({"battery_level": [f"cell[{number}]" for number in range(start, start + 900)]})
    [stored] = history.run(lambda connection: [*queries.transitions(connection)])
    assert (stored.affects, stored.effects[-1]) == (1000, "cell[999]")
