"""The state of a real rclpy lifecycle node, read without waiting."""

from __future__ import annotations

import gc
from typing import Any

import pytest
from harness.port_conformance import START_S

from robot_health_monitor.core.nodes import AlertSystem


def test_a_lifecycle_node_that_is_configured_and_activated_is_followed(ros: Any, outside: Any) -> None:
    lifecycle = pytest.importorskip("rclpy.lifecycle", reason="rclpy has no lifecycle nodes here")
    signals = {"nav": {"lifecycle": "controller_server", "startup_grace_s": 1.0}}
    monitor = AlertSystem(ros.node("alert_system", parameters={"signals": signals})).monitor
    ros.set_time(START_S + 10.0)

    def reads(text: str) -> bool:
        ros.set_time(START_S + 11.0)
        return monitor.report(0.0).statuses["nav"].message == text

    node = lifecycle.LifecycleNode("controller_server", context=outside.context)
    outside.executor.add_node(node)
    try:
        ros.wait_until(lambda: reads("/controller_server is unconfigured, expected active"))
        node.trigger_configure()
        ros.wait_until(lambda: reads("/controller_server is inactive, expected active"))
        node.trigger_activate()
        ros.wait_until(lambda: reads("/controller_server is active"))
    finally:
        outside.executor.remove_node(node)
        node.destroy_node()
        del node
    # rclpy keeps the node of rcl as long as the object lives, which refers to itself, and the executor to the last one.
    ros.wait_until(lambda: gc.collect() >= 0 and reads("/controller_server is not there"))
