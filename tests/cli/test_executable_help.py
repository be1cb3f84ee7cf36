"""`--help` of the ROS executables: without ROS, and without a master that could end a running node."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from robot_health_monitor.cli.executable_help import help_text
from robot_health_monitor.cli.executables import EXECUTABLES

ROOT = Path(__file__).resolve().parents[2]
OPTIONS = {"1": ("--help", "-h") * 2, "2": ("-h", "--help") * 2}
"""What each of the four executables is given."""
BLOCKED = "import sys; sys.modules.update(rospy=None, rclpy=None, rosgraph=None); "


@pytest.mark.parametrize(
    ("ros", "executable", "option"),
    [(ros, name, option) for ros, options in OPTIONS.items() for name, option in zip(EXECUTABLES, options)],
)
def test_it_prints_and_ends_without_importing_ros(executable: str, ros: str, option: str) -> None:
    code = f"{BLOCKED}from robot_health_monitor.cli.ros{ros}_executables import {executable}; sys.exit({executable}())"
    arguments = ["--ros-args", "-p", "publish_rate:=fast", option]
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("usage: ")
    assert f" robot_health_monitor {executable} " in done.stdout


def test_a_value_that_looks_like_the_option_is_none() -> None:
    code = f"{BLOCKED}from robot_health_monitor.cli.ros2_executables import aggregator; sys.exit(aggregator())"
    arguments = ["--ros-args", "-p", "robot_name:=--help"]
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == ""


def test_it_says_how_parameters_are_given() -> None:
    text = help_text("aggregator", "ROS 1")
    assert "usage: rosrun robot_health_monitor aggregator [_PARAMETER:=VALUE ...]" in text
    assert "docs/reference/parameters.md describes the parameters." in text
    text = help_text("alert_system", "ROS 2")
    assert "usage: ros2 run robot_health_monitor alert_system [--ros-args [-p PARAMETER:=VALUE ...]" in text


@pytest.mark.parametrize("ros", ["ROS 1", "ROS 2"])
@pytest.mark.parametrize("executable", list(EXECUTABLES))
def test_it_fits_a_terminal_of_100_columns(executable: str, ros: str) -> None:
    assert max(len(line) for line in help_text(executable, ros).splitlines()) <= 100
