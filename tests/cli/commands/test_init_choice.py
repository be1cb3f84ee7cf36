"""Which ROS `init` listens over. Real robots: test_init_command.py, tests/ros1/test_init.py and ros2/."""

from __future__ import annotations

import importlib.util
from typing import Any, Sequence

import pytest

from robot_health_monitor.cli.commands.init_command import choose_ros
from robot_health_monitor.core.values.errors import ConfigError


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Any:
    def set_up(modules: Sequence[str], version: str = "") -> None:
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: name if name in modules else None)
        monkeypatch.setenv("ROS_VERSION", version)

    return set_up


def test_the_one_ros_that_is_here_is_used(here: Any) -> None:
    here(["rospy"])
    assert choose_ros("") == "ros1"
    here(["rclpy"])
    assert choose_ros("") == "ros2"


def test_of_two_the_one_that_is_sourced_or_requested_is_used(here: Any) -> None:
    here(["rospy", "rclpy"], "2")
    assert choose_ros("") == "ros2"
    assert choose_ros("ros1") == "ros1"
    here(["rospy", "rclpy"])
    with pytest.raises(ConfigError, match="got ros1, ros2; choose one of two with --ros1 or --ros2"):
        choose_ros("")


def test_without_ros_the_error_names_the_way_by_url(here: Any) -> None:
    here([])
    with pytest.raises(
        ConfigError, match=r"expected one ROS that is sourced here, got none; .*robot-health init ws://robot:9090"
    ):
        choose_ros("")
    here(["rospy"])
    with pytest.raises(
        ConfigError, match=r"expected ros2 that is sourced here, got ros1; .*robot-health init ws://robot:9090"
    ):
        choose_ros("ros2")
