"""Goals of a real action server, actionlib's, are samples."""

from __future__ import annotations

from typing import Any, Iterator

import pytest

from robot_health_monitor.core.nodes import AlertSystem


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


def test_each_goal_that_ends_after_the_monitor_came_is_a_sample(ros: Any) -> None:
    """The goal says how it ends."""
    import rospy
    from actionlib import ActionServer
    from actionlib.msg import TestAction, TestActionGoal

    ended = []

    def take(goal: Any) -> None:
        order = goal.get_goal().goal
        if order == 5:
            goal.set_rejected()
        else:
            goal.set_accepted()
            (goal.set_succeeded, goal.set_aborted, goal.set_canceled)[order]()
        ended.append(order)

    server = ActionServer("/watched_action", TestAction, take, lambda goal: None, auto_start=False)
    server.start()
    goals = rospy.Publisher("/watched_action/goal", TestActionGoal, queue_size=10)

    def send(order: int) -> None:
        message = TestActionGoal()
        message.goal_id.id, message.goal.goal = f"goal {len(ended)}", order
        number = len(ended)
        goals.publish(message)
        ros.wait_until(lambda: len(ended) > number)

    ros.wait_until(lambda: goals.get_num_connections() == 1)
    send(1)  # before the monitor
    signal = {"action": "/watched_action", "statistic": "mean", "window_min_s": 0.0, "error_above": 0.9}
    system = AlertSystem(ros.node("alert_system", parameters={"signals": {"goals": signal}}))
    ros.wait_until(lambda: server.status_pub.get_num_connections() == 1)

    def judged() -> Any:
        return system.read(
            lambda monitor, _: (len(monitor.window_samples("goals")), monitor.judgements(0.0)["goals"].judged)
        )

    for order, expected in ((0, (1, 0.0)), (2, (1, 0.0)), (5, (2, 0.5)), (1, (3, 2.0 / 3.0)), (0, (4, 0.5))):
        send(order)
        ros.wait_until(lambda: judged() == expected)  # noqa: B023 - it is called at once
    # The master goes on listing what is not unregistered, and tests after this one wait for all that it lists.
    server.status_timer.shutdown()
    publishers = (server.status_pub, server.result_pub, server.feedback_pub)
    for each in (goals, *publishers, server.goal_sub, server.cancel_sub):
        each.unregister()
