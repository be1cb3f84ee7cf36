"""`robot-health init` on a real ROS 2 graph."""

from __future__ import annotations

import pytest
from harness.init_on_ros import InitOnRos


class TestRos2(InitOnRos):
    ros = "ros2"
    robot = """
import sys
import rclpy
sys.path.insert(0, sys.argv[1])
from harness.whole_robot import WholeRobot
from robot_health_monitor.ros2.middleware import Ros2Middleware
rclpy.init()
node = Ros2Middleware("whole_robot")
robot = WholeRobot(node, 3.0)
print("ready", flush=True)
rclpy.spin(node.node)
"""

    @pytest.fixture
    def variables(self, ros_environment: dict[str, str]) -> dict[str, str]:
        return ros_environment
