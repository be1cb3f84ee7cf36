"""Goals of a real action server of rclpy, where a package with a type of an action is installed."""

from __future__ import annotations

import importlib
from typing import Any

import pytest

from robot_health_monitor.core.nodes import AlertSystem

TYPES = {
    "tf2_msgs": "LookupTransform",
    "example_interfaces": "Fibonacci",
    "test_msgs": "Fibonacci",
    "nav2_msgs": "NavigateToPose",
}
"""A type of an action by package; the wheels of ROS 2 on PyPI have the Python of none."""


def action_type() -> Any:
    for package, name in TYPES.items():
        try:
            return getattr(importlib.import_module(f"{package}.action"), name)
        except ImportError:
            continue
    return pytest.skip(f"no type of an action is installed: none of {', '.join(TYPES)} is")


def test_goals_that_succeed_abort_or_are_canceled_or_rejected_are_judged(ros: Any, outside: Any) -> None:
    from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
    from rclpy.task import Future

    cls, orders, asked_to_cancel = action_type(), iter(["abort", "succeed", "canceled", "abort"]), Future()
    accepts: list[bool] = [True] * 3 + [False, True]

    async def execute(goal: Any) -> Any:
        order = next(orders)
        if order == "canceled":
            await asked_to_cancel
        getattr(goal, order)()
        return cls.Result()

    def cancel_goal(goal: Any) -> Any:
        asked_to_cancel.set_result(None)
        return CancelResponse.ACCEPT

    node = outside.node("navigator")
    server = ActionServer(
        node,
        cls,
        "/navigate_to_pose",
        execute,
        goal_callback=lambda goal: GoalResponse.ACCEPT if accepts.pop(0) else GoalResponse.REJECT,
        cancel_callback=cancel_goal,
    )
    client = ActionClient(node, cls, "/navigate_to_pose")
    signal = {"action": "/navigate_to_pose", "statistic": "mean", "window_min_s": 0.0, "error_above": 0.9}
    system = AlertSystem(ros.node("alert_system", parameters={"signals": {"nav_goals": signal}}))

    def judged() -> Any:
        return system.read(
            lambda monitor, _: (len(monitor.window_samples("nav_goals")), monitor.judgements(0.0)["nav_goals"].judged)
        )

    def send(*, cancel: bool = False) -> None:
        """Sends a goal and returns when it has ended, or was rejected."""
        sent = client.send_goal_async(cls.Goal())
        ros.wait_until(sent.done)
        if sent.result().accepted:
            if cancel:
                sent.result().cancel_goal_async()
            result = sent.result().get_result_async()
            ros.wait_until(result.done)

    ros.wait_until(client.server_is_ready)
    send()  # aborted, before a message was heard or after: a goal of the first message does not count
    ros.wait_until(lambda: system.samples >= 1)
    before, _ = judged()
    send()
    ros.wait_until(lambda: judged()[0] == before + 1)
    send(cancel=True)
    send()
    send()
    ros.wait_until(lambda: judged()[0] == before + 2)
    assert judged()[1] == pytest.approx((before + 1) / (before + 2))
    client.destroy()
    server.destroy()
