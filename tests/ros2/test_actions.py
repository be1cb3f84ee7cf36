"""Goals of an action as rclpy publishes their states: with action_msgs, and with the QoS of its action servers.

test_action_server.py has a whole action server, which needs a type of an action: the wheels of ROS 2 have none.
"""

from __future__ import annotations

from typing import Any

from action_msgs.msg import GoalStatus, GoalStatusArray
from rclpy.qos import qos_profile_action_status_default

from robot_health_monitor.core.nodes import AlertSystem


def test_the_latest_message_says_which_goals_had_ended_before(ros: Any) -> None:
    topic = "/navigate_to_pose/_action/status"
    publisher = ros._me.create_publisher(GoalStatusArray, topic, qos_profile_action_status_default)

    def publish(*codes: int) -> None:
        message = GoalStatusArray()
        for number, code in enumerate(codes):
            status = GoalStatus(status=code)
            status.goal_info.goal_id.uuid[0] = number
            message.status_list.append(status)
        publisher.publish(message)

    publish(GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_EXECUTING)
    signal = {"action": "/navigate_to_pose", "statistic": "mean", "window_min_s": 0.0, "error_above": 0.9}
    system = AlertSystem(ros.node("alert_system", parameters={"signals": {"nav_goals": signal}}))

    def judged() -> Any:
        return system.read(
            lambda monitor, _: (len(monitor.window_samples("nav_goals")), monitor.judgements(0.0)["nav_goals"].judged)
        )

    ros.wait_until(lambda: system.samples >= 1)
    assert judged() == (0, None)
    publish(GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_ABORTED)
    ros.wait_until(lambda: judged() == (1, 1.0))
    publish(GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_ABORTED, GoalStatus.STATUS_SUCCEEDED)
    ros.wait_until(lambda: judged() == (2, 0.5))
