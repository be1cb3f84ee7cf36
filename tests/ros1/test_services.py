"""A node of rospy can be served to rosbridge clients."""

from __future__ import annotations

import asyncio
import os
import socket
from pathlib import Path
from typing import Any, Iterator

import pytest
import yaml
from harness.bridged_executable import check_served, look_at, settings
from harness.served_conformance import ServedConformance

from robot_health_monitor.core.values.errors import MessageError, ServiceError

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


class TestRos1Served(ServedConformance):
    @pytest.fixture
    def harness(self, ros_process: Any) -> Any:
        from harness.ros1 import Ros1Harness

        return Ros1Harness()

    @pytest.fixture
    def served(self, ros_process: Any) -> Any:
        from robot_health_monitor.ros1.middleware import Ros1Middleware

        return Ros1Middleware("/bridge")


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


def test_a_port_in_use_stops_only_the_server(start: Any, ros: Any, parameters: Any, tmp_path: Path) -> None:
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")

    def monitor_is_error() -> bool:
        statuses = [status for report in reports for status in report["status"]]
        return any(status["name"] == "alert_system: monitor" and status["level"] == 2 for status in statuses)

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        text = settings(tmp_path, taken.getsockname()[1], "s3cret")
        parameters("/alert_system", yaml.safe_load(text)["alert_system"])
        process = start("alert_system")
        process.wait_for_text("server: web page and rosbridge are off: ")
        alerts = ros.listen("/alerts", "diagnostic_msgs/DiagnosticStatus")
        ros.publish("/battery_level", "std_msgs/Float32", {"data": 15.0})
        ros.wait_until(lambda: any(alert["name"] == "alert_system: battery_level" for alert in alerts))
        ros.wait_until(monitor_is_error)
        process.signal()
        assert process.wait() == 0


def test_without_the_library_only_the_server_is_missing(start: Any, ros: Any, parameters: Any, tmp_path: Path) -> None:
    (tmp_path / "aiohttp.py").write_text("raise ModuleNotFoundError(\"No module named 'aiohttp'\", name='aiohttp')")
    parameters("/alert_system", yaml.safe_load(settings(tmp_path, 9, "s3cret"))["alert_system"])
    process = start("alert_system", environment={"PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"})
    process.wait_for_text("server: web page and rosbridge are off: aiohttp is not installed: ")
    ros.publish("/battery_level", "std_msgs/Float32", {"data": 15.0})
    process.wait_for_text("battery_level WARN")


@pytest.fixture
def served(ros_process: Any) -> Iterator[Any]:
    from robot_health_monitor.ros1.middleware import Ros1Middleware

    served = Ros1Middleware("/bridge")
    yield served
    served.close()


@pytest.mark.parametrize("type_name", ["", "std_srvs/Trigger"])
def test_a_service_that_fails_is_a_service_error(ros: Any, served: Any, type_name: str) -> None:
    def fail(request: Any) -> Any:
        raise RuntimeError("no power")

    ros.node("robot").advertise_service("~start", "std_srvs/Trigger", fail)
    with pytest.raises(ServiceError, match=r"/robot/start: .*no power"):
        served.call_service("/robot/start", type_name, {}, 10.0)


def test_a_service_that_hangs_is_a_service_error_in_time(served: Any) -> None:
    """It accepts the connection and never answers, as a stopped process does."""
    import rosgraph

    with socket.socket() as hanging:
        hanging.bind(("127.0.0.1", 0))
        hanging.listen()
        master = rosgraph.Master("/robot")
        address = f"rosrpc://127.0.0.1:{hanging.getsockname()[1]}"
        master.registerService("/robot/hang", address, "http://127.0.0.1:9/")
        try:
            with pytest.raises(ServiceError, match=r"/robot/hang: no response within 0\.3 s"):
                served.call_service("/robot/hang", "std_srvs/Trigger", {}, 0.3)
        finally:
            master.unregisterService("/robot/hang", address)


def test_a_request_that_does_not_match_is_a_message_error(ros: Any, served: Any) -> None:
    ros.node("robot").advertise_service("~enable", "std_srvs/SetBool", lambda request: {})
    with pytest.raises(MessageError, match="data"):
        served.call_service("/robot/enable", "std_srvs/SetBool", {"data": "yes"}, 10.0)


def test_a_service_of_another_type_is_a_service_error(ros: Any, served: Any) -> None:
    ros.node("robot").advertise_service("~enable", "std_srvs/SetBool", lambda request: {})
    with pytest.raises(ServiceError, match="/robot/enable"):
        served.call_service("/robot/enable", "std_srvs/Trigger", {}, 10.0)


def test_a_master_that_is_down_is_a_service_error(ros_process: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from robot_health_monitor.ros1.middleware import Ros1Middleware

    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:9")
    served = Ros1Middleware("/bridge")
    with pytest.raises(ServiceError, match=r"http://127\.0\.0\.1:9 does not answer"):
        served.graph()
    with pytest.raises(ServiceError, match="does not answer"):
        served.call_service("/robot/start", "", {}, 1.0)
