"""`robot-health test --from-alert FILE.mcap`: what it writes passes, for black boxes of the real alert_system."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap")
pytest.importorskip("numpy")

from harness.black_boxes import RecordedRobot
from harness.random_black_boxes import random_signal

from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.testing.past_alert import black_box_alerts
from robot_health_monitor.core import Level
from robot_health_monitor.core.values.errors import ConfigError

pytestmark = pytest.mark.usefixtures("utc")


def box_of_battery(folder: Path) -> Path:
    """Returns a file with WARN and ERROR: 50 for 5 s, 15 for 3 s, 5 for 2 s, ten samples a second."""
    robot = RecordedRobot(folder, before_s=10.0, after_s=5.0)
    for seconds, value in ((20.0, 50.0), (3.0, 15.0), (2.0, 5.0)):
        robot.feed(seconds, value)
    robot.wait(20.0)
    (file,) = robot.files()
    robot.close()
    return file


def test_one_of_its_alerts_becomes_a_test(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = box_of_battery(tmp_path / "box")
    assert main(["test", "--from-alert", str(file), "--number", "2"]) == 0
    captured = capsys.readouterr()
    assert captured.err == f"the test of alert 2 of {file.name} passes\n"
    lines = captured.out.splitlines()
    assert lines[0].startswith(f"# Alert 2 of {file.name}, 2023-11-14 22:30:23 +0000: battery ERROR: 5 % is below 10 %")
    assert "    battery: {topic: /battery, " in captured.out
    assert lines[-2].endswith("signal: battery, level: WARN}")
    assert lines[-1].endswith("signal: battery, level: ERROR}")
    path = tmp_path / "alert.test.yaml"
    path.write_text(captured.out, encoding="utf-8")
    assert main(["test", str(path)]) == 0
    assert capsys.readouterr().out == f"{path}: OK: 1 test\n"


def test_with_several_alerts_they_are_listed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = box_of_battery(tmp_path / "box")
    assert main(["test", "--from-alert", str(file)]) == 2
    captured = capsys.readouterr()
    first, *listed = captured.err.splitlines()
    assert captured.out == ""
    assert first == f"{file}: has 2 alerts; choose one with --number N:"
    assert listed == [
        "    1  battery WARN: 15 % is below 20 % (was OK for 20 s)",
        "    2  battery ERROR: 5 % is below 10 % (was WARN for 3 s)",
    ]
    assert main(["test", "--from-alert", str(file), "--number", "9"]) == 2
    assert capsys.readouterr().err == f"{file}: --number 9: expected 1 to 2\n"


@pytest.mark.newest_python
@pytest.mark.parametrize("statistic", ["last", "mean", "min", "max", "stddev", "frequency_hz"])
def test_alerts_of_random_black_boxes_occur_again(
    statistic: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A window that is longer than the recording before the alert is the only reason why one may not."""
    choices = random.Random(statistic)
    signal = random_signal(choices)
    while signal["statistic"] != statistic or signal.get("flap_detection"):
        signal = random_signal(choices)
    robot = RecordedRobot(tmp_path, {"s": {**signal, "topic": "s"}}, before_s=30.0, after_s=10.0)
    value = 50.0
    while robot.bus.now_s < 1150.0:
        robot.bus.run_until(robot.bus.now_s + choices.uniform(0.05, 0.15))
        value += choices.gauss((50.0 - value) * 0.01, 2.0)
        robot.publish("s", value)
        if choices.random() < 0.004:
            robot.wait(choices.uniform(0.5, 9.0))
    robot.wait(40.0)
    passed = total = 0
    for file in robot.files():
        for number in range(1, len(black_box_alerts(str(file))) + 1):
            total += 1
            code = main(["test", "--from-alert", str(file), "--number", str(number)])
            captured = capsys.readouterr()
            passed += code == 0
            assert code == 0 or "does not occur again: " in captured.err
    robot.close()
    assert total >= 2
    assert passed >= 0.9 * total, (passed, total)


def test_the_series_of_a_condition_is_recorded_too(tmp_path: Path) -> None:
    signals: dict[str, dict[str, Any]] = {
        "battery": {"type": "std_msgs/Float32", "warn_below": 20.0, "only_if": {"signal": "driving", "above": 0.5}},
        "driving": {"type": "std_msgs/Float32"},
    }
    robot = RecordedRobot(tmp_path, signals, before_s=10.0, after_s=2.0)
    for number in range(40):
        robot.wait(0.5)
        robot.publish("driving", 0.0 if number < 35 else 1.0)
        robot.publish("battery", 50.0 if number < 30 else 15.0)
    robot.wait(10.0)
    (alert, *_) = black_box_alerts(str(robot.files()[0]))
    robot.close()
    assert (alert.signal, alert.transition.to_level) == ("battery", Level.WARN)
    driving: list[float] = [value for at_s, value in alert.samples["driving"] if at_s <= alert.time_s]
    assert driving[-1] == 1.0
    assert driving[:-1] == [0.0] * (len(driving) - 1)
    assert sorted(alert.settings) == ["battery", "driving"]


def test_bad_samples_are_in_the_series(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    robot = RecordedRobot(tmp_path, before_s=10.0, after_s=2.0)
    robot.feed(15.0, 50.0)
    robot.feed(0.5, float("nan"))
    robot.wait(10.0)
    (file,) = robot.files()
    robot.close()
    assert main(["test", "--from-alert", str(file), "--number", "1"]) == 0
    assert " nan}" in capsys.readouterr().out


def test_what_is_no_black_box_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mcap.writer import Writer

    file = tmp_path / "plain.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "x")
        schema = writer.register_schema("std_msgs/msg/Empty", "ros2msg", b"")
        writer.add_message(writer.register_channel("/x", "cdr", schema), 1, b"\x00\x01\x00\x00\x00", 1)
        writer.finish()
    with pytest.raises(ConfigError):
        black_box_alerts(str(file))
    assert main(["test", "--from-alert", str(file)]) == 2
    assert capsys.readouterr().err == f"{file}: --from-alert: has no thresholds.yaml; expected a black box\n"
    assert main(["test", "--from-alert", str(tmp_path / "none.mcap")]) == 2
    assert capsys.readouterr().err == f"{tmp_path / 'none.mcap'}: no such file\n"
