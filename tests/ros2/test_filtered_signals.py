"""Errors that rclpy logs are counted, and static transforms that were published before the monitor came."""

from __future__ import annotations

from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile

from robot_health_monitor.core.nodes import AlertSystem


def test_errors_in_the_log_are_counted(ros: Any) -> None:
    signal = {
        "topic": "/rosout", "where": 'level >= ERROR and name == "*planner"', "field": "", "statistic": "count",
        "warn_above": 5.0,
    }  # fmt: skip
    said: list[Any] = []
    system = AlertSystem(
        ros.node("alert_system", parameters={"signals": {"errors": signal}}), {"test": said.append}, log_alerts=False
    )
    nodes = {name: rclpy.create_node(name, context=ros._me.context) for name in ("planner", "controller")}
    try:
        ros.wait_until(lambda: all(node.count_subscribers("/rosout") for node in nodes.values()))

        def count() -> Any:
            return system.read(lambda monitor, _: monitor.judgements(0.0)["errors"].judged)

        for number in range(6):
            nodes["planner"].get_logger().warning(f"slow {number}")
            nodes["controller"].get_logger().error(f"failed {number}")
            if number % 2:
                nodes["planner"].get_logger().error(f"failed {number}")
            else:
                nodes["planner"].get_logger().fatal(f"failed {number}")
            ros.wait_until(lambda: count() == number + 1.0)  # noqa: B023 - it is called at once
        assert [event.text.partition(" (")[0] for event in said] == ["errors WARN: 6 in 60 s is above 5"]
    finally:
        for node in nodes.values():
            node.destroy_node()


def test_static_frames_that_were_published_before_are_received(ros: Any) -> None:
    """tf2_msgs is not among the wheels of ROS 2: a DiagnosticArray is published as static transforms are."""
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for name in ("base_link", "camera"):
        publisher = ros._me.create_publisher(DiagnosticArray, "/tf_static", latched)
        publisher.publish(DiagnosticArray(status=[DiagnosticStatus(name=name, level=b"\1")]))
    signal = {"topic": "/tf_static", "field": 'status["*"].level', "stale_after_s": 0.0}
    system = AlertSystem(ros.node("alert_system", parameters={"signals": {"frames": signal}}))
    names = {"frames", "frames[base_link]", "frames[camera]"}
    ros.wait_until(lambda: system.read(lambda monitor, _: set(monitor.signals())) == names)
