"""Faults around the process: a broken log, no /clock, an EventsExecutor that does not work. Real processes and DDS."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

import pytest
from harness.unread import fill

ROOT = Path(__file__).resolve().parents[2]
FLOAT32 = "std_msgs/Float32"
STATUS = "diagnostic_msgs/DiagnosticStatus"
ARRAY = "diagnostic_msgs/DiagnosticArray"
THRESHOLDS = (
    "alert_system: {ros__parameters: {signals: "
    "{battery_level: {warn_below: 20.0, error_below: 10.0, stale_after_s: 2.0}}}}\n"
)


@pytest.fixture
def start_with(ros_environment: dict[str, str], tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen]]:
    """Starts alert_system with given stdout and stderr."""
    file = tmp_path / "thresholds.yaml"
    file.write_text(THRESHOLDS, encoding="utf-8")
    processes: list[subprocess.Popen] = []
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
    environment = {**ros_environment, "PYTHONPATH": path}
    code = "import sys; from robot_health_monitor.cli.ros2_executables import alert_system; sys.exit(alert_system())"

    def start(**streams: Any) -> subprocess.Popen:
        command = [sys.executable, "-c", code, "--ros-args", "--params-file", str(file)]
        processes.append(subprocess.Popen(command, env=environment, **streams))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait()


def alerts_of(ros: Any) -> list[bytes]:
    """Publishes 50, 15, 5, 50 % and returns the levels of the alerts of the signal."""
    ros.wait_until(lambda: ros.services() >= {"/alert_system/reset"})
    alerts = ros.listen("/alerts", STATUS)
    ros.connect_to_process("/battery_level", {"data": 50.0}, "battery_level")
    for percent in (15.0, 5.0, 50.0):
        ros.publish_to_process("/battery_level", FLOAT32, {"data": percent})

    def of_battery() -> list[bytes]:
        """Without those of a pause on a busy machine, and of the time until the connections are there."""
        levels = [alert["level"] for alert in alerts if alert["name"] == "alert_system: battery_level"]
        return [level for level in levels if level != b"\x03"]

    ros.wait_until(lambda: len(of_battery()) >= 3)
    return of_battery()


def shown(reports: list[Any]) -> list[Any]:
    return [(status["name"], status["level"]) for report in reports for status in report["status"]]


def test_a_reader_of_the_log_that_is_gone_costs_no_alert(ros: Any, start_with: Any) -> None:
    read_end, write_end = os.pipe()
    process = start_with(stdout=write_end, stderr=write_end)
    os.close(write_end)
    os.close(read_end)
    reports = ros.listen("/diagnostics", ARRAY)
    assert alerts_of(ros) == [b"\x01", b"\x02", b"\x00"]
    # The tick still works: it finds the signal stale, and the fault of the log.
    ros.wait_until(lambda: ("alert_system: battery_level", b"\x03") in shown(reports))
    ros.wait_until(lambda: ("alert_system: monitor", b"\x02") in shown(reports))
    process.send_signal(signal.SIGTERM)
    assert process.wait(30.0) == 0


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_disk_costs_no_alert(ros: Any, start_with: Any) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        process = start_with(stdout=full, stderr=full)
    assert alerts_of(ros) == [b"\x01", b"\x02", b"\x00"]
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 0


def test_a_reader_of_the_log_that_hangs_costs_no_alert(ros: Any, start_with: Any) -> None:
    """rclpy writes to stderr in C while it holds the GIL: a write that blocks would stop every thread."""
    read_end, write_end = os.pipe()
    fill(write_end)
    process = start_with(stdout=write_end, stderr=write_end)
    assert alerts_of(ros) == [b"\x01", b"\x02", b"\x00"]
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 0
    os.close(read_end)
    os.close(write_end)


def test_without_clock_it_warns(start: Any, ros: Any) -> None:
    process = start("alert_system", "--ros-args", "-p", "use_sim_time:=true")
    reports = ros.listen("/diagnostics", ARRAY)
    line = process.wait_for_text("/clock has been silent")
    assert "[WARN]" in line
    ros.wait_until(lambda: ("alert_system: monitor", b"\x01") in shown(reports))


def test_it_starts_without_a_writable_folder(start: Any, tmp_path: Path) -> None:
    """Parameter files are rewritten in memory."""
    file = tmp_path / "thresholds.yaml"
    file.write_text(THRESHOLDS, encoding="utf-8")
    nowhere = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), "/proc/none")
    process = start("alert_system", "--ros-args", "--params-file", str(file), environment=nowhere)
    process.wait_for_text("watching battery_level on /battery_level: WARN below 20")
    process.signal()
    assert process.wait(30.0) == 0


def test_composed_without_sensors_there_is_only_alert_system(start: Any, ros: Any) -> None:
    process = start("health_monitor", "--ros-args", "-p", "sensors:=none")
    process.wait_for_text("aggregator is not started")
    ros.wait_until(lambda: ros.services() >= {"/alert_system/reset"})
    # Nodes of the test before may be in the graph for some seconds more.
    ros.wait_until(lambda: ros.services().isdisjoint({"/battery_sensor/set_parameters", "/aggregator/set_parameters"}))
    process.signal()
    assert process.wait(30.0) == 0


def test_a_domain_without_ports_is_one_line(start: Any) -> None:
    process = start("alert_system", environment={"ROS_DOMAIN_ID": "233"})
    assert process.wait() == 2
    assert process.errors == ["alert_system: ROS_DOMAIN_ID: expected at most 232, got 233"]


def test_a_node_that_dds_refuses_is_one_line_after_those_of_dds(start: Any, tmp_path: Path) -> None:
    profile = tmp_path / "fastdds.xml"
    profile.write_text(
        '<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>'
        '<participant profile_name="without_transport" is_default_profile="true">'
        "<rtps><useBuiltinTransports>false</useBuiltinTransports></rtps></participant></profiles></dds>"
    )
    interface = '<General><Interfaces><NetworkInterface name="none"/></Interfaces></General>'
    variables = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",  # with others, Fast DDS does not follow the profile
        "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile),
        "CYCLONEDDS_URI": f"<CycloneDDS><Domain>{interface}</Domain></CycloneDDS>",
    }
    process = start("alert_system", environment=variables)
    assert process.wait() == 3
    assert re.match(r"alert_system: rmw_\w+ cannot create a node; it may have printed", process.errors[-1])
    assert not any("Warning" in line or "Traceback" in line for line in process.errors)


@pytest.mark.parametrize("arguments", [(), ("-p", "start_type_description_service:=true")])
def test_the_nodes_describe_their_types_only_on_request(start: Any, ros: Any, arguments: Sequence[str]) -> None:
    namespace = f"/described{len(arguments)}"  # not that of an earlier node, which discovery may still list
    start("alert_system", "--ros-args", "-r", f"__ns:={namespace}", *arguments)
    ros.wait_until(lambda: f"{namespace}/alert_system/reset" in ros.services())  # created last
    assert (f"{namespace}/alert_system/get_type_description" in ros.services()) is bool(arguments)


class TestExecutor:
    """Which executor `executor: auto` chooses."""

    @pytest.fixture
    def node(self, ros_environment: dict[str, str]) -> Iterator[Any]:
        import rclpy
        from rclpy.context import Context
        from rclpy.node import Node

        context = Context()
        rclpy.init(context=context, domain_id=int(ros_environment["ROS_DOMAIN_ID"]))
        yield Node("alert_system", context=context)
        rclpy.shutdown(context=context)

    @pytest.fixture
    def lines(self) -> list[str]:
        return []

    def choose(self, wanted: str, node: Any, lines: list[str]) -> str:
        from robot_health_monitor.ros2.process import choose_executor

        executor, _ = choose_executor(wanted, [node], lambda severity, text: lines.append(text))
        assert node in executor.get_nodes()
        executor.shutdown()
        return type(executor).__name__

    def test_the_events_executor_is_chosen_where_it_works(self, node: Any, lines: list[str]) -> None:
        pytest.importorskip("rclpy.experimental", reason="this rclpy has no EventsExecutor")
        assert self.choose("auto", node, lines) == "EventsExecutor"
        assert lines == []

    def test_single_is_single(self, node: Any, lines: list[str]) -> None:
        assert self.choose("single", node, lines) == "SingleThreadedExecutor"

    @pytest.mark.parametrize(("wanted", "warnings"), [("auto", 0), ("events", 1)])
    def test_one_that_delivers_nothing_is_not_chosen(
        self, node: Any, lines: list[str], monkeypatch: pytest.MonkeyPatch, wanted: str, warnings: int
    ) -> None:
        self.break_with(monkeypatch, threading.Event().wait)
        assert self.choose(wanted, node, lines) == "SingleThreadedExecutor"
        assert ["delivers no message" in line for line in lines] == [True] * warnings

    def test_one_that_is_busy_while_idle_is_not_chosen(
        self, node: Any, lines: list[str], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        import time

        def burn(limit_s: float) -> None:
            end_s = time.thread_time() + limit_s
            while time.thread_time() < end_s:
                pass

        self.break_with(monkeypatch, burn)
        assert self.choose("events", node, lines) == "SingleThreadedExecutor"
        assert "is busy while idle" in lines[0]

    @staticmethod
    def break_with(monkeypatch: pytest.MonkeyPatch, spin: Callable[[float], object]) -> None:
        experimental = pytest.importorskip("rclpy.experimental", reason="this rclpy has no EventsExecutor")
        from rclpy.executors import SingleThreadedExecutor

        class Broken(SingleThreadedExecutor):
            def spin_until_future_complete(self, future: Any, timeout_sec: Any = None) -> None:
                spin(timeout_sec)

        monkeypatch.setattr(experimental, "EventsExecutor", Broken)
