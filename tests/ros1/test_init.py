"""`robot-health init` on a real ROS 1 graph."""

from __future__ import annotations

from typing import Any, Mapping

import pytest
from harness.init_on_ros import InitOnRos


class TestRos1(InitOnRos):
    ros = "ros1"
    robot = """
import sys
import rospy
sys.path.insert(0, sys.argv[1])
from harness.whole_robot import WholeRobot
from robot_health_monitor.ros1.middleware import Ros1Middleware
rospy.init_node("whole_robot")
robot = WholeRobot(Ros1Middleware(), 3.0)
print("ready", flush=True)
rospy.spin()
"""

    @pytest.fixture
    def variables(self, master: Any) -> Mapping[str, str]:
        variables: Mapping[str, str] = master.environment
        return variables

    def test_without_a_master_there_is_one_line_at_once(
        self, init: Any, master: Any, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setitem(master.environment, "ROS_MASTER_URI", "http://127.0.0.1:9")
        process = init()
        assert process.wait() == 3, process.text
        assert [line.text for line in process.lines] == [
            "robot-health: no ROS master at http://127.0.0.1:9 (ROS_MASTER_URI)"
        ]

    def test_without_a_robot_there_is_one_line(  # type: ignore[override]
        self, init: Any, master: Any, start_master: Any, free_port: int, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """On a new master: the other one lists the types of topics of earlier tests."""
        monkeypatch.setitem(master.environment, "ROS_MASTER_URI", start_master(free_port).uri)
        super().test_without_a_robot_there_is_one_line(init)

    def test_simulated_time_without_a_clock_is_one_line(self, init: Any, parameters: Any) -> None:
        parameters("/use_sim_time", True)
        process = init("--seconds", "1")
        assert process.wait() == 3, process.text
        assert [line.text for line in process.lines] == [
            "robot-health: use_sim_time is set, and there is no message on /clock: no ROS time"
        ]
