"""A node of rospy can be served to rosbridge clients."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
import yaml
from harness.bridged_executable import check_served, look_at, settings
from harness.served_conformance import ServedConformance


class TestRos1Served(ServedConformance):
    @pytest.fixture
    def harness(self, ros_process: Any) -> Any:
        from harness.ros1 import Ros1Harness

        return Ros1Harness()

    @pytest.fixture
    def served(self, ros_process: Any) -> Any:
        from robot_health_monitor.ros1.introspection import Ros1ServedMiddleware

        return Ros1ServedMiddleware("/bridge")


def test_the_executable_serves_when_rosbridge_port_is_set(
    start: Any, parameters: Any, free_port: int, tmp_path: Any
) -> None:
    process = start("health_monitor")
    process.wait_for_text("watching cpu_usage")
    process.signal()
    assert process.wait() == 0
    assert "serving on" not in process.text
    parameters("/alert_system", yaml.safe_load(settings(tmp_path, free_port, "s3cret"))["alert_system"])
    process = start("health_monitor")
    process.wait_for_text(f"serving on ws://127.0.0.1:{free_port}")
    check_served(process, asyncio.run(look_at(free_port, "s3cret")))
