"""`robot-health init` on a real ROS 2 graph, with the robot that the proofs use."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any, Iterator

import pytest
from harness.line_process import LineProcess

from robot_health_monitor.core.config import load_config

ROOT = Path(__file__).resolve().parents[2]

ROBOT = """
import sys
import rclpy
sys.path.insert(0, sys.argv[1])
from harness.whole_robot import WholeRobot
from robot_health_monitor.ros2.middleware import Ros2Middleware
rclpy.init()
node = Ros2Middleware("whole_robot")
robot = WholeRobot(node)
print("ready", flush=True)
rclpy.spin(node.node)
"""


@pytest.fixture
def start(ros_environment: Any) -> Iterator[Any]:
    """Starts Python with arguments on the graph."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    started = []

    def start_python(*arguments: str) -> LineProcess:
        started.append(LineProcess([sys.executable, *arguments], {**ros_environment, "PYTHONPATH": path}))
        return started[-1]

    yield start_python
    for process in started:
        process.end()


def test_a_robot_gets_a_file_with_its_rates_ages_battery_and_drivers(start: Any, tmp_path: Path) -> None:
    start("-c", ROBOT, str(ROOT / "tests")).wait_for_text("ready")
    process = start("-m", "robot_health_monitor", "init", "--ros2", "--seconds", "25")
    assert process.wait(90.0) == 0, process.text
    file = tmp_path / "thresholds.yaml"
    file.write_text("\n".join(line.text for line in process.lines if line.stream == "out"))
    signals = load_config(file).signals
    assert {
        "battery_state_rate", "battery_state_age", "battery_state_percentage", "battery_state_cell_spread",
        "camera_image_rate", "camera_image_age", "scan_rate", "scan_age", "imu_rate", "imu_age", "joint_states_rate",
        "joint_states_age", "motor_temperature_temperature", "diagnostics",
    } <= set(signals)  # fmt: skip
    assert signals["diagnostics"].field == 'status["*"]'
    assert not any(signal.topic in ("rosout", "event") for signal in signals.values())
    assert re.search(r'^      # /joint_states, .*effort\["', file.read_text(), re.MULTILINE)
    assert "robot_health_init" not in file.read_text()


def test_without_a_robot_there_is_one_line(start: Any) -> None:
    process = start("-m", "robot_health_monitor", "init", "--ros2", "--seconds", "1")
    assert process.wait() == 3, process.text
    assert [line.stream for line in process.lines] == ["err"]
    assert process.lines[0].text.startswith("robot-health: nothing to watch on ROS 2: ")
