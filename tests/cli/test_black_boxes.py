"""Black boxes in virtual time: `replay` gives the alert line that the monitor gave, in random ones too."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Callable, Dict, List, Tuple

import pytest
from harness.black_boxes import BATTERY, RecordedRobot
from harness.random_black_boxes import check_random_black_box, without_past

pytest.importorskip("mcap")

from robot_health_monitor.__main__ import main

Replay = Callable[..., Tuple[int, List[Dict[str, Any]], str]]


@pytest.fixture
def replayed(robot_health_here: Callable[..., Any]) -> Replay:
    """Returns a function that gives exit code, alerts and the table of `robot-health replay`."""

    def replay(file: Path, *arguments: str) -> tuple[int, list[dict[str, Any]], str]:
        done = robot_health_here("replay", file, "--json", *arguments)
        alerts = [json.loads(line.text) for line in done.lines if line.stream == "out"]
        return done.wait(), alerts, "\n".join(done.errors)

    return replay


ON_THE_NEWEST = [pytest.param(seed, marks=pytest.mark.newest_python) for seed in range(2, 8)]


@pytest.mark.parametrize("seed", [0, 1, *ON_THE_NEWEST])
def test_a_replay_gives_the_same_alert_line(tmp_path: Path, seed: int) -> None:
    check_random_black_box(tmp_path, seed)


@pytest.fixture
def black_box(tmp_path: Path) -> Path:
    """A black box with one WARN: 15 %."""
    robot = RecordedRobot(tmp_path / "box", {"battery": {**BATTERY, "for_s": 3.0}}, name="husky1")
    robot.feed(60.0, 50.0)
    robot.feed(30.0, 15.0)
    (file,) = robot.files()
    robot.close()
    return file


def test_replay_uses_what_is_attached(replayed: Replay, black_box: Path) -> None:
    code, alerts, _ = replayed(black_box)
    assert code == 1
    assert [(alert["robot"], alert["text"]) for alert in alerts] == [
        ("husky1", "battery WARN: 15 % is below 20 % (was OK for 63 s)")
    ]


def test_what_is_attached_needs_no_installed_thresholds(
    black_box: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("robot_health_monitor.cli.commands.replay_command.find_installed", lambda name: None)
    assert main(["replay", str(black_box)]) == 1
    assert capsys.readouterr().out.endswith("1 alert\n")


def test_suggest_leaves_out_what_the_black_box_itself_wrote(black_box: Path, robot_health_here: Any) -> None:
    done = robot_health_here("suggest", black_box)
    assert done.wait() == 0, done.text
    assert "alert_system_tick_rate" not in done.text
    assert "    #   /alert_system/tick: published by this monitor" in done.text


def test_thresholds_replace_what_is_attached(replayed: Replay, black_box: Path, tmp_path: Path) -> None:
    thresholds = tmp_path / "other.yaml"
    thresholds.write_text(
        "alert_system:\n  ros__parameters:\n    signals:\n"
        "      battery: {type: std_msgs/Float32, unit: '%', warn_below: 10.0}\n",
        encoding="utf-8",
    )
    code, alerts, _ = replayed(black_box, "--thresholds", str(thresholds))
    assert (code, alerts) == (0, [])


def test_a_replay_that_begins_later_does_not_use_the_states(replayed: Replay, black_box: Path) -> None:
    code, alerts, _ = replayed(black_box, "--from", "10")
    assert code == 1
    assert [without_past(alert["text"]) for alert in alerts] == ["battery WARN: 15 % is below 20 %"]


def test_an_attachment_that_cannot_be_used_is_one_line(replayed: Replay, tmp_path: Path) -> None:
    from robot_health_monitor.core.messages.raw_messages import RawFormat
    from robot_health_monitor.ops.black_box.recording_file import RecordingFile

    raw_format = RawFormat("json", "std_msgs/Float32", "jsonschema", "{}")
    texts = [("alert_system: {ros__parameters: {signals: {a: {warn_belw: 1.0}}}}\n", "{}"), ("a: [", "{}"), ("", "")]
    lines = []
    for number, (thresholds, state) in enumerate(texts):
        attached = {"thresholds.yaml": thresholds, "state.json": state}
        file = RecordingFile(str(tmp_path / f"{number}.mcap"), "", 0, attached)
        file.write([(float(at), "/a", raw_format, b'{"data": 1.0}') for at in range(9)], 0.0)
        file.finish({})
        code, _, error = replayed(tmp_path / f"{number}.mcap")
        assert code == 2
        (line,) = error.splitlines()
        lines.append(line.replace(f"{tmp_path}/", ""))
    assert "state.json: expected robot, time_s in seconds since 1970, and signals" in lines[0]
    assert lines[1] == "1.mcap/thresholds.yaml:2: is not valid YAML: did not find expected node content"
    assert lines[2] == "2.mcap/thresholds.yaml: expected a mapping of keys to values, got nothing"


@pytest.mark.parametrize("driving", [0.0, 1.0])
def test_a_condition_on_a_latched_topic_holds_in_a_replay_too(replayed: Replay, tmp_path: Path, driving: float) -> None:
    """Published once, long before the recording begins. Not driving: the low battery is no alert."""
    signals = {
        "battery": {**BATTERY, "only_if": {"signal": "driving", "above": 0.5}},
        "driving": {"type": "std_msgs/Float32", "stale_after_s": 0.0},
        "temperature": {"type": "std_msgs/Float32", "warn_above": 80.0},
    }
    robot = RecordedRobot(tmp_path, signals, before_s=10.0, after_s=2.0)
    robot.publish("driving", driving)
    for number in range(300):
        robot.wait(0.1)
        robot.publish("battery", 50.0 if number < 250 else 15.0)
        robot.publish("temperature", 50.0 if number < 280 else 90.0)
    robot.wait(4.0)
    file = robot.files()[-1]
    robot.close()
    _, alerts, _ = replayed(file)
    expected = ["battery WARN: 15 % is below 20 %"] * (driving > 0.5) + ["temperature WARN: 90 is above 80"]
    assert [without_past(alert["text"]) for alert in alerts] == expected
