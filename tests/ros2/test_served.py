"""An rclpy node can be served to rosbridge clients, with either executor."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest
from harness.bridged_executable import check_served, look_at, settings
from harness.reserved import free_port
from harness.served_conformance import ServedConformance


class TestRos2Served(ServedConformance):
    @pytest.fixture
    def harness(self, inside: Any, outside: Any) -> Any:
        from harness.ros2 import Ros2Harness

        participant, spinner = inside
        return Ros2Harness(participant, outside, spinner)

    @pytest.fixture
    def served(self, inside: Any) -> Any:
        return served_in(inside)


class TestRos2ServedEvents(ServedConformance):
    @pytest.fixture
    def harness(self, inside_events: Any, outside: Any) -> Any:
        from harness.ros2 import Ros2Harness

        participant, spinner = inside_events
        return Ros2Harness(participant, outside, spinner)

    @pytest.fixture
    def served(self, inside_events: Any) -> Any:
        return served_in(inside_events)


def served_in(inside: Any) -> Any:
    from robot_health_monitor.ros2.middleware import Ros2Middleware

    participant, _ = inside
    served = Ros2Middleware("bridge", participant.context, use_global_arguments=False)
    participant.executor.add_node(served.node)
    return served


def test_the_executable_serves_when_rosbridge_port_is_set(start: Any, tmp_path: Any) -> None:
    port = free_port()
    file = tmp_path / "thresholds.yaml"
    file.write_text(settings(tmp_path, port, "s3cret"))
    process = start("health_monitor", "--ros-args", "--params-file", str(file))
    process.wait_for_text(f"serving on ws://127.0.0.1:{port}")
    check_served(process, asyncio.run(look_at(port, "s3cret")))


def test_a_port_in_use_stops_only_the_server(start: Any, ros: Any, tmp_path: Any) -> None:
    alerts = ros.listen("/alerts", "diagnostic_msgs/DiagnosticStatus")
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")

    def monitor_is_error() -> bool:
        statuses = [status for report in reports for status in report["status"]]
        return any(status["name"] == "alert_system: monitor" and status["level"] == b"\x02" for status in statuses)

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        file = tmp_path / "thresholds.yaml"
        file.write_text(settings(tmp_path, taken.getsockname()[1], "s3cret"))
        process = start("alert_system", "--ros-args", "--params-file", str(file))
        process.wait_for_text("server: web page and rosbridge are off: ")
        ros.connect_to_process("/battery_level", {"data": 50.0}, "battery_level")
        ros.publish_to_process("/battery_level", "std_msgs/Float32", {"data": 15.0})
        ros.wait_until(lambda: any(alert["name"] == "alert_system: battery_level" for alert in alerts))
        ros.wait_until(monitor_is_error)
        process.signal()
        assert process.wait() == 0
