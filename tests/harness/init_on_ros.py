"""`robot-health init` on a real graph of ROS, with the robot that the proofs use: one suite for ROS 1 and ROS 2.

A test class inherits from `InitOnRos`, says which ROS it is, and defines the fixture `variables`.
"""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any, Iterator, Mapping

import pytest

from harness.line_process import LineProcess
from robot_health_monitor.core.config.monitor_config import load_config

ROOT = Path(__file__).resolve().parents[2]


class InitOnRos:
    """What `init` finds on either."""

    ros: str
    """`ros1` or `ros2`, as the option of `init`."""
    robot: str
    """A program that runs the robot and prints `ready`; its argument is the folder of the tests."""

    @pytest.fixture
    def start(self, variables: Mapping[str, str]) -> Iterator[Any]:
        """Starts Python with arguments on the graph."""
        path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
        started = []

        def start_python(*arguments: str) -> LineProcess:
            started.append(LineProcess([sys.executable, *arguments], {**variables, "PYTHONPATH": path}))
            return started[-1]

        yield start_python
        for process in started:
            process.end()

    @pytest.fixture
    def init(self, start: Any) -> Any:
        """Starts `init` with options."""
        return lambda *options: start("-m", "robot_health_monitor", "init", f"--{self.ros}", *options)

    def test_a_robot_gets_a_file_with_its_rates_ages_battery_and_drivers(
        self, start: Any, init: Any, tmp_path: Path
    ) -> None:
        start("-c", self.robot, str(ROOT / "tests")).wait_for_text("ready")
        process = init("--seconds", "15")  # a rate needs 20 messages, and the slowest come three times a second
        assert process.wait(90.0) == 0, process.text
        file = tmp_path / "thresholds.yaml"
        file.write_text("\n".join(line.text for line in process.lines if line.stream == "out"))
        signals = load_config(file).signals
        wanted = {
            "battery_state_rate", "battery_state_percentage", "battery_state_cell_spread", "camera_image_rate",
            "scan_rate", "imu_rate", "joint_states_rate", "motor_temperature_temperature", "diagnostics",
        }  # fmt: skip
        assert not wanted - set(signals), file.read_text()
        for topic in ("battery_state", "camera/image", "scan", "imu", "joint_states"):
            # On a busy machine a message may be more than a second late: the age has no bound then, but a reason.
            late = re.search(rf"# /{topic}, header\.stamp: stamps are \S+ s to [1-9]\S* s old", file.read_text())
            assert f"{topic.replace('/', '_')}_age" in signals or late, file.read_text()
        assert signals["diagnostics"].field == 'status["*"]'
        assert signals["whole_robot_node"].graph == ("node", "whole_robot")
        assert "/scan" in signals["whole_robot_node"].depends_on
        assert signals["rosout_errors"].where == 'level >= ERROR and name != "*alert_system"'
        assert not any(signal.topic == "event" for signal in signals.values())
        assert re.search(r'^      # /joint_states, .*effort\["', file.read_text(), re.MULTILINE)
        assert "robot_health_init" not in file.read_text()

    def test_without_a_robot_there_is_one_line(self, init: Any) -> None:
        process = init("--seconds", "1")
        assert process.wait() == 3, process.text
        assert [line.stream for line in process.lines] == ["err"]
        title = self.ros.replace("ros", "ROS ")
        assert process.lines[0].text.startswith(f"robot-health: nothing to watch on {title}: ")
