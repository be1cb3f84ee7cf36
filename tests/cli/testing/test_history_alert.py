"""What a history has about an alert, for its unit test; the black box that it names has more."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mcap")
pytest.importorskip("numpy")

from harness.black_boxes import BOOT_S, START_S, RecordedRobot

from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.history.history_file import reading_history
from robot_health_monitor.cli.operations import Operations
from robot_health_monitor.cli.testing.past_alert import history_alert
from robot_health_monitor.core import Level
from robot_health_monitor.ops.configuration import BlackBoxSettings, HistorySettings, OpsConfig

SIGNALS = {
    "battery": {
        "type": "std_msgs/Float32", "warn_below": 20.0, "window_s": 2.0, "for_s": 4.0,
        "only_if": {"signal": "driving", "above": 0.5},
    },
    "driving": {"type": "std_msgs/Float32", "stale_after_s": 0.0},
}  # fmt: skip


@pytest.fixture
def robot(tmp_path: Path) -> RecordedRobot:
    """Returns a robot that drives from 6 s on; its battery is below 20 from 10 s on. WARN comes 4 s later."""
    now_s = [START_S]
    config = OpsConfig(
        history=HistorySettings(str(tmp_path / "history.db")), black_box=BlackBoxSettings(str(tmp_path / "box"))
    )
    operations = Operations(config, lambda: BOOT_S + now_s[0], lambda: now_s[0])
    robot = RecordedRobot(tmp_path / "box", SIGNALS, operations=operations)
    for number in range(170):
        now_s[0] = START_S + 0.1 * number
        robot.bus.run_until(now_s[0])
        robot.publish("driving", 0.0 if number < 60 else 1.0)
        robot.publish("battery", 50.0 if number < 100 else 15.0)
    robot.close()
    (tmp_path / "ops.yaml").write_text("history: {file: history.db}\nblack_box: {folder: box}\n")
    return robot


def test_a_history_has_the_window_of_its_signal(robot: RecordedRobot) -> None:
    with reading_history(str(robot.folder.parent / "history.db")) as connection:
        alert = history_alert(connection, 1)
    assert (alert.title, alert.transition.to_level) == ("alert 1 of r1", Level.WARN)
    assert sorted(alert.settings) == ["battery", "driving"]
    assert list(alert.samples) == ["battery"]
    times_s = [time_s for time_s, _ in alert.samples["battery"]]
    assert alert.time_s - times_s[0] == pytest.approx(2.0, abs=0.11)


def test_the_test_is_written_from_the_black_box_if_its_folder_is_known(
    robot: RecordedRobot, capsys: pytest.CaptureFixture[str]
) -> None:
    """The window of 2 s is shorter than the 4 s of the rule."""
    folder = robot.folder.parent
    (file,) = robot.folder.glob("*.mcap")
    assert main(["test", "--from-alert", "1", "--history", str(folder / "history.db")]) == 2
    assert (
        f"its black box {file.name} has them: name its folder by --ops, or the file itself" in capsys.readouterr().err
    )
    assert main(["test", "--from-alert", "1", "--ops", str(folder / "ops.yaml")]) == 0
    printed = capsys.readouterr()
    assert printed.err == "the test of alert 1 of r1 passes\n"
    assert printed.out.splitlines()[-4:] == [
        "  interval_s: 0.1",
        "  input: {battery: 50x99 15x40, driving: 0x59 1x80}",
        "  alerts:",
        "  - {at_s: 14.0, signal: battery, level: WARN}",
    ]
