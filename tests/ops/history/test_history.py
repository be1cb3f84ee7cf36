"""The history of a monitor: what it stores, and what a restarted monitor finds."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Iterator, List

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.local import LocalBus
from robot_health_monitor.core.model import Transition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.history.history import History
from robot_health_monitor.ops.history.reader import HistoryReader


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
    with HistoryReader(history.file) as reader:
        [stored] = reader.transitions()
        assert (stored.wall_s, stored.robot, stored.to_level, stored.value) == (1_000_000.0, "r1", Level.WARN, 15.0)
        assert reader.evidence(stored.id) == [(999_999.0, 15.0)]


def test_samples_that_several_transitions_have_are_stored_once(history: History) -> None:
    robot = history.of_robot("r1")
    first, second = [(1.0, 15.0), (2.0, 14.0)], [(2.0, 14.0), (3.0, 13.0)]
    robot.record(low_battery(), {"level": 1}, first)
    robot.record(low_battery(2.0), {"level": 1}, second)
    robot.record(low_battery(3.0), {"level": 1}, [])
    assert history.file is not None
    with HistoryReader(history.file) as reader:
        found = [reader.evidence(stored.id) for stored in reader.transitions()]
        assert found == [first, second, []]
        sizes = reader.connection.execute("SELECT length(samples) FROM evidence ORDER BY transition_id").fetchall()
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
    notices = [line.text for line in bus.log_lines if "starts without its saved state" in line.text]
    assert [text[0] for text in notices] == ["a", "b", "c", "d", "f"]


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


@pytest.mark.parametrize("in_file", [False, True])
def test_only_a_history_in_a_file_is_kept(in_file: bool, tmp_path: Path) -> None:
    opened = History(HistorySettings(str(tmp_path / "history.db")) if in_file else None)
    assert opened.of_robot("r1").is_kept is in_file
    opened.close()


def test_hooks_store_rows_in_the_transaction_of_the_transition(history: History) -> None:
    seen: List[object] = []
    history.on_record(lambda connection, number, transition, wall_s: seen.append((number, transition.signal, wall_s)))
    history.of_robot("r1").record(low_battery(), {}, [])
    assert seen == [(1, "battery_level", 1_000_000.0)]


def test_without_a_file_the_history_is_in_memory() -> None:
    history = History(None, time.time)
    history.of_robot("r1").record(low_battery(), {}, [])
    assert history.run(lambda connection: connection.execute("SELECT count(*) FROM transitions").fetchone()) == (1,)
    history.close()
