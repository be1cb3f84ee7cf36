"""Faults around the process: a broken log, a lost master, no /clock. Real processes and a real roscore."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from harness.unread import fill

ROOT = Path(__file__).resolve().parents[2]
FLOAT32 = "std_msgs/Float32"
STATUS = "diagnostic_msgs/DiagnosticStatus"
ARRAY = "diagnostic_msgs/DiagnosticArray"


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


@pytest.fixture
def start_with(master: Any) -> Iterator[Callable[..., subprocess.Popen]]:
    """Starts alert_system with given stdout and stderr."""
    processes: list[subprocess.Popen] = []
    environment: dict[str, str] = {**master.environment, "PYTHONPATH": str(ROOT)}
    code = "import sys; from robot_health_monitor.cli.ros1_executables import alert_system; sys.exit(alert_system())"

    def start(**streams: Any) -> subprocess.Popen:
        processes.append(subprocess.Popen([sys.executable, "-c", code], env=environment, **streams))
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait()


def alerts_of(ros: Any) -> list[Any]:
    """Publishes 50, 15, 5, 50 % and returns the alerts of the signal."""
    alerts = ros.listen("/alerts", STATUS)
    for percent in (50.0, 15.0, 5.0, 50.0):
        ros.publish("/battery_level", FLOAT32, {"data": percent})

    def of_battery() -> list[Any]:
        """Without those of a pause on a busy machine."""
        return [alert for alert in alerts if alert["name"] == "alert_system: battery_level" and alert["level"] != 3]

    ros.wait_until(lambda: len(of_battery()) >= 3)
    return of_battery()


def wait_until_running(ros: Any) -> None:
    ros.wait_until(lambda: "/alert_system/reset" in {name for name, _ in ros._master.getSystemState()[2]})


def test_a_reader_of_the_log_that_is_gone_costs_no_alert(ros: Any, start_with: Any, parameters: Any) -> None:
    parameters("/alert_system/signals/battery_level", {"warn_below": 20.0, "error_below": 10.0, "stale_after_s": 2.0})
    read_end, write_end = os.pipe()
    process = start_with(stdout=write_end, stderr=write_end)
    os.close(write_end)
    wait_until_running(ros)
    os.close(read_end)
    reports = ros.listen("/diagnostics", ARRAY)
    assert [alert["level"] for alert in alerts_of(ros)] == [1, 2, 0]
    # The tick still works: it finds the signal stale, and the fault of the log.
    ros.wait_until(lambda: ("alert_system: battery_level", 3) in shown(reports))
    ros.wait_until(lambda: ("alert_system: monitor", 2) in shown(reports))
    process.send_signal(signal.SIGTERM)
    assert process.wait(30.0) == 0


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_disk_costs_no_alert(ros: Any, start_with: Any, parameters: Any) -> None:
    parameters("/alert_system/signals/battery_level", {"warn_below": 20.0, "error_below": 10.0})
    with open("/dev/full", "w", encoding="utf-8") as full:
        process = start_with(stdout=full, stderr=full)
    wait_until_running(ros)
    assert [alert["level"] for alert in alerts_of(ros)] == [1, 2, 0]
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 0


def test_a_reader_of_the_log_that_hangs_costs_no_alert(ros: Any, start_with: Any, parameters: Any) -> None:
    parameters("/alert_system/signals/battery_level", {"warn_below": 20.0, "error_below": 10.0})
    read_end, write_end = os.pipe()
    fill(write_end)
    process = start_with(stdout=write_end, stderr=write_end)
    wait_until_running(ros)
    assert [alert["level"] for alert in alerts_of(ros)] == [1, 2, 0]
    process.send_signal(signal.SIGINT)
    assert process.wait(30.0) == 0
    os.close(read_end)
    os.close(write_end)


def test_without_clock_it_warns(start: Any, ros: Any, parameters: Any) -> None:
    parameters("/use_sim_time", True)
    process = start("alert_system")
    reports = ros.listen("/diagnostics", ARRAY)
    unpublished = ros._master.getSystemState()[0]
    assert [nodes for topic, nodes in unpublished if topic == "/clock"] in ([], [["/tests"]])
    line = process.wait_for_text("/clock has been silent")
    assert "[WARN]" in line
    ros.wait_until(lambda: ("alert_system: monitor", 1) in shown(reports))


def test_a_restarted_master_ends_it_with_code_3(start: Any, free_port: int, start_master: Any) -> None:
    master = start_master(free_port)
    process = start("alert_system", environment={"ROS_MASTER_URI": master.uri})
    process.wait_for_text("watching cpu_usage")
    master.end()
    start_master(free_port)
    line = process.wait_for_text("was restarted and does not know this node")
    assert "[ERROR]" in line
    assert process.wait(30.0) == 3
    assert process.errors[-1] == (
        "alert_system: the ROS master was restarted; start this node again to register with it"
    )
    assert "Traceback" not in process.text


def test_a_master_that_hangs_delays_no_alert(start: Any, free_port: int, start_master: Any) -> None:
    """The sensor is connected directly; the fault is reported while the master is stopped, and ends when it runs."""
    master = start_master(free_port)
    monitor = start("alert_system", environment={"ROS_MASTER_URI": master.uri})
    monitor.wait_for_text("watching cpu_usage")
    fast = ("_publish_rate:=10", "_battery_level/discharge_rate:=30", "_battery_level/charge_rate:=60")
    sensor = start("battery_sensor", *fast, environment={"ROS_MASTER_URI": master.uri})
    monitor.wait_for_text("battery_level WARN")
    pid = pid_of(master)
    os.kill(pid, signal.SIGSTOP)
    try:
        monitor.wait_for_text("ROS master: ")
        for _ in range(2):
            monitor.wait_for_text("battery_level OK")
            monitor.wait_for_text("battery_level WARN")
    finally:
        os.kill(pid, signal.SIGCONT)
    monitor.wait_for_text("ROS master works again")
    for process in (sensor, monitor):
        process.signal()
        assert process.wait(30.0) == 0


def test_it_ends_while_the_master_hangs(start: Any, free_port: int, start_master: Any) -> None:
    master = start_master(free_port)
    process = start("aggregator", environment={"ROS_MASTER_URI": master.uri})
    process.wait_for_text("system_health is the mean of")
    pid = pid_of(master)
    os.kill(pid, signal.SIGSTOP)
    try:
        process.signal()
        assert process.wait(30.0) == 0
    finally:
        os.kill(pid, signal.SIGCONT)
    assert "Traceback" not in process.text


def shown(reports: list[Any]) -> list[Any]:
    return [(status["name"], status["level"]) for report in reports for status in report["status"]]


def pid_of(master: Any) -> int:
    """Returns the process of the master itself, which roscore starts in a separate process group."""
    import rosgraph

    return int(rosgraph.Master("/tests", master.uri).getPid())
