"""The black box of one robot: when a recording begins and ends, and what is in it. In virtual time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from harness.black_boxes import BATTERY, BOOT_S, RecordedRobot, attachments, recorded

pytest.importorskip("mcap")

from robot_health_monitor.core import Level


def test_an_alert_is_recorded_from_before_until_after_it(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path, before_s=30.0, after_s=10.0)
    robot.feed(100.0, 50.0)
    robot.feed(5.0, 15.0)  # WARN at 1100.1
    robot.feed(30.0, 50.0)
    (file,) = robot.files()
    assert file.name == "r1_20231114T223140.099Z_battery.mcap"
    messages = recorded(file)
    times_s = [time_s for time_s, _ in messages["/battery"]]
    # A state is saved every 5 s: that of 1070 is the last one at least 30 s before. The file ends at the first
    # whole second after 1110.1.
    assert times_s[0] == pytest.approx(1070.0, abs=0.11)
    assert times_s[-1] == pytest.approx(1111.0, abs=0.11)
    assert len(times_s) == pytest.approx(411, abs=1)
    assert json.loads(messages["/battery"][0][1]) == {"data": 50.0}
    ((at_s, alert),) = [each for each in messages["/alerts"] if json.loads(each[1])["level"] == 1]
    assert at_s == pytest.approx(1100.1, abs=1e-5)
    assert json.loads(alert)["message"] == "battery WARN: 15 % is below 20 % (was OK for 100 s)"
    statuses = [json.loads(data)["status"] for _, data in messages["/diagnostics"]]
    assert {status["name"] for status in statuses[-1]} == {"alert_system: battery", "alert_system: monitor"}
    robot.close()


def test_an_alert_is_announced_before_the_thread_that_writes_wakes_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The states of all signals, and the thread that writes, would delay it by tens of milliseconds."""
    robot = RecordedRobot(tmp_path)
    robot.feed(10.0, 50.0)
    box = robot.operations.black_box
    assert box is not None
    order: list[str] = []
    monkeypatch.setattr(box, "wake", lambda: order.append("wake"))
    robot.bus.add_log(lambda line: order.append("alert") if "battery WARN" in line.text else None)
    robot.feed(1.0, 15.0)
    assert order == ["alert", "wake"]
    monkeypatch.undo()
    robot.close()


def test_the_transition_and_the_history_name_the_file(tmp_path: Path) -> None:
    from robot_health_monitor.ops.store import queries

    robot = RecordedRobot(tmp_path)
    robot.feed(1.0, 50.0)
    robot.feed(1.0, 15.0)
    robot.feed(1.0, 5.0)
    robot.feed(20.0, 50.0)
    name = robot.files()[0].name
    expected = [(Level.WARN, name), (Level.ERROR, name), (Level.OK, "")]
    assert [(each.to_level, each.black_box) for each in robot.transitions] == expected
    history = robot.operations.history
    assert history is not None
    stored = history.run(lambda connection: list(queries.transitions(connection)))
    assert [(each.to_level, each.black_box) for each in stored] == expected
    robot.close()


def test_the_attachments_are_the_configuration_and_the_states_at_the_beginning(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path, {"battery": {**BATTERY, "topic": "power/battery"}}, namespace="husky")
    robot.feed(20.0, 15.0, "power/battery")  # WARN at 1000.1
    robot.feed(60.0, 15.0, "power/battery")
    robot.feed(1.0, 5.0, "power/battery")  # ERROR at 1080.1
    robot.feed(20.0, 50.0, "power/battery")
    files = robot.files()
    assert len(files) == 2
    found = attachments(files[1])
    assert yaml.safe_load(found["thresholds.yaml"]) == {
        "alert_system": {
            "ros__parameters": {
                "robot_name": "r1",
                "publish_rate": 1.0,
                "signals": {"battery": {**BATTERY, "topic": "/husky/power/battery"}},
            }
        }
    }
    state: Any = json.loads(found["state.json"])
    assert (state["robot"], state["time_s"]) == ("r1", BOOT_S + 1050.0)
    battery = state["signals"]["battery"]
    assert battery["announced"]["level"] == "WARN"
    assert battery["since"]["announced"] == pytest.approx(BOOT_S + 1000.1, abs=1e-5)
    robot.close()


def test_alerts_at_once_and_alerts_meanwhile_share_the_file(tmp_path: Path) -> None:
    signals = {f"s{number}": {**BATTERY, "topic": f"t{number}"} for number in range(100)}
    robot = RecordedRobot(tmp_path, signals, after_s=10.0)
    for number in range(100):
        robot.publish(f"t{number}", 50.0)
    robot.wait(1.0)
    for number in range(100):
        robot.publish(f"t{number}", 15.0)
    robot.wait(8.0)  # one alert for all: their topics fall silent together
    robot.wait(12.0)
    (file,) = robot.files()
    assert {each.black_box for each in robot.transitions} == {file.name}
    assert len(robot.transitions) == 101
    assert len(recorded(file)["/alerts"]) == 101
    robot.close()


def test_an_alert_after_the_end_has_a_file_of_its_own_with_the_same_past(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path, before_s=30.0, after_s=2.0)
    robot.feed(1.0, 15.0)
    robot.feed(6.0, 50.0)
    robot.feed(1.0, 15.0)
    robot.feed(6.0, 50.0)
    first, second = robot.files()
    assert recorded(second)["/battery"][0] == recorded(first)["/battery"][0]
    robot.close()


def test_levels_below_min_level_begin_no_file(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path, min_level=Level.STALE)
    robot.feed(5.0, 15.0)  # WARN
    assert robot.transitions[-1].black_box == ""
    robot.wait(10.0)  # STALE
    assert robot.transitions[-1].to_level is Level.STALE
    robot.wait(12.0)
    assert robot.transitions[-1].black_box == robot.files()[0].name
    robot.close()


def test_a_repetition_names_the_file_of_its_alert_and_does_not_prolong_it(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path, {"battery": {**BATTERY, "repeat_s": 3.0}}, after_s=10.0)
    robot.feed(30.0, 15.0)
    (file,) = robot.files()
    assert len(robot.transitions) > 5
    assert {each.black_box for each in robot.transitions} == {file.name}
    assert recorded(file)["/battery"][-1][0] < 1013.0
    robot.close()


def test_a_stop_completes_the_file(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path)
    robot.feed(10.0, 15.0)
    robot.close()
    (file,) = tmp_path.glob("*.mcap")
    assert len(recorded(file)["/battery"]) == 100


def test_the_status_shows_how_far_the_memory_reaches_back(tmp_path: Path) -> None:
    robot = RecordedRobot(tmp_path, before_s=30.0, memory_mb=1.0, topics=("/camera/image",))
    robot.feed(10.0, 50.0)
    image = {"data": "A" * 100_000}
    for _ in range(20):
        robot.wait(1.0)
        robot.publish("/camera/image", image, "sensor_msgs/Image")
    values = dict(robot.alert_system.self_monitor.status().values)
    assert 3.0 <= float(values["black_box_s"]) <= 6.0  # half of the memory: at most 5 images of 100 kB
    robot.close()


def test_a_robot_without_a_black_box_has_no_such_key(tmp_path: Path) -> None:
    from robot_health_monitor.core.nodes import AlertSystem
    from robot_health_monitor.core.port.local import LocalBus

    status = AlertSystem(LocalBus().node("alert_system")).self_monitor.status()
    assert [key for key in status.values if "black" in key] == []
