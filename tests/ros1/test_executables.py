"""The executables as a user meets them: processes with a master, topics, parameters, signals and exit codes."""

from __future__ import annotations

import itertools
import re
import signal
import subprocess
from pathlib import Path
from typing import Any, Iterator, Mapping

import pytest
from harness.executables_on_ros import FLOAT32, READY, TRIGGER, WRONG_FILE, ExecutablesOnRos, file_with, warnings_of


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    """The outside world: publishes, listens and calls natively."""
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


class TestExecutables(ExecutablesOnRos):
    parameter_service = "reload"

    @pytest.fixture
    def run(self, start: Any, parameters: Any) -> Any:
        def run_executable(
            executable: str,
            given: Mapping[str, Mapping[str, Any]] = {},
            *,
            name: str = "",
            namespace: str = "",
            remap: Mapping[str, str] = {},
        ) -> Any:
            for node, values in given.items():
                parameters(f"{namespace}/{node}/ros__parameters", values)
            names = {**remap, **({"__name": name} if name else {})}
            environment = {"ROS_NAMESPACE": namespace} if namespace else {}
            return start(executable, *(f"{old}:={new}" for old, new in names.items()), environment=environment)

        return run_executable

    def send(self, ros: Any, topic: str, value: float) -> None:
        ros.publish(topic, FLOAT32, {"data": value})

    def connect(self, ros: Any, topic: str, value: float, signal_name: str, diagnostics: str = "/diagnostics") -> None:
        self.send(ros, topic, value)

    def registered(self, ros: Any, node: str) -> bool:
        return any(node in nodes for kind in ros._master.getSystemState() for _, nodes in kind)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_without_a_master_it_says_which_one_it_waits_for(start: Any, number: int) -> None:
    process = start("alert_system", environment={"ROS_MASTER_URI": "http://127.0.0.1:9"})
    assert "http://127.0.0.1:9" in process.wait_for_text("waiting for the ROS master")
    process.signal(number)
    assert process.wait(30.0) == 0
    assert len(process.lines) == 1


def test_it_starts_when_its_master_does(start: Any, free_port: int, start_master: Any) -> None:
    process = start("battery_sensor", environment={"ROS_MASTER_URI": f"http://127.0.0.1:{free_port}"})
    process.wait_for_text("waiting for the ROS master")
    start_master(free_port)
    process.wait_for_text(READY["battery_sensor"])
    process.signal()
    assert process.wait(30.0) == 0


def test_nodes_live_on_when_their_master_dies(start: Any, free_port: int, start_master: Any) -> None:
    master = start_master(free_port)
    environment = {"ROS_MASTER_URI": master.uri}
    monitor = start("alert_system", environment=environment)
    monitor.wait_for_text(READY["alert_system"])
    fast = ("_publish_rate:=10", "_battery_level/discharge_rate:=50", "_battery_level/charge_rate:=50")
    sensor = start("battery_sensor", *fast, environment=environment)
    monitor.wait_for_text("battery_level WARN")
    master.end()
    for _ in range(2):
        monitor.wait_for_text("battery_level OK")
        monitor.wait_for_text("battery_level WARN")
    for process in (sensor, monitor):
        process.signal()
        assert process.wait(30.0) == 0
        assert "Traceback" not in process.text


@pytest.mark.parametrize("executable", ["alert_system", "health_monitor"])
def test_a_wrong_file_ends_it_with_file_line_and_key(
    start: Any, parameters: Any, tmp_path: Path, executable: str
) -> None:
    file = file_with(tmp_path, WRONG_FILE)
    parameters("/alert_system/ros__parameters/signals/battery_level/warn_bellow", 20.0)
    parameters("/alert_system/thresholds", file)
    process = start(executable)
    assert process.wait() == 2
    (line,) = process.errors
    assert line.startswith(f"{executable}: {file}:5: alert_system.ros__parameters.signals.battery_level.warn_bellow: ")
    assert "warn_below" in line


@pytest.mark.parametrize("option", ["--help", "-h"])
def test_help_does_not_end_the_node_that_runs(start: Any, ros: Any, option: str) -> None:
    running = start("alert_system")
    running.wait_for_text(READY["alert_system"])
    process = start("alert_system", option)
    assert process.wait() == 0
    assert process.lines[0].text.startswith("usage: rosrun robot_health_monitor alert_system")
    assert ros.call("/alert_system/reset", TRIGGER)["success"] is True
    assert running.is_running
    assert "shutdown" not in running.text


def test_a_wrong_private_parameter_ends_it_with_the_key(master: Any, start: Any) -> None:
    process = start("battery_sensor", "_publish_rate:=fast")
    assert process.wait() == 2
    (line,) = process.errors
    assert line.startswith("battery_sensor: publish_rate: expected a number from 0.01 to 1000, got 'fast'")


def test_a_wrong_log_level_is_refused(master: Any, start: Any) -> None:
    process = start("aggregator", "_log_level:=LOUD")
    assert process.wait() == 2
    assert process.errors == ["aggregator: log_level: expected one of DEBUG, INFO, WARN, ERROR, FATAL, got 'LOUD'"]


def test_without_a_file_a_reload_changes_one_bound_of_the_default_signals(
    start: Any, ros: Any, parameters: Any
) -> None:
    process = start("alert_system")
    process.wait_for_text("watching cpu_usage")
    parameters("/alert_system/ros__parameters/signals/battery_level/warn_below", 30.0)
    response = ros.call("/alert_system/reload", TRIGGER)
    assert response == {"success": True, "message": "battery_level.warn_below: 20 -> 30"}
    ros.publish("/battery_level", FLOAT32, {"data": 25.0})
    process.wait_for_text("battery_level WARN: 25 % is below 30 %")


def test_reload_takes_a_good_change_and_refuses_a_bad_one(start: Any, ros: Any, parameters: Any) -> None:
    bound = "/alert_system/ros__parameters/signals/battery_level/warn_below"
    parameters(bound, 20.0)
    process = start("alert_system")
    process.wait_for_text("watching battery_level")
    ros.publish("/battery_level", FLOAT32, {"data": 25.0})

    parameters(bound, 30.0)
    changes = [ros.call("/alert_system/reload", TRIGGER) for _ in range(2)]
    assert changes[0] == {"success": True, "message": "battery_level.warn_below: 20 -> 30"}
    assert changes[1] == {"success": True, "message": "nothing changed"}
    ros.publish("/battery_level", FLOAT32, {"data": 25.0})
    process.wait_for_text("battery_level WARN: 25 is below 30")

    parameters(bound, "low")
    refused = ros.call("/alert_system/reload", TRIGGER)
    assert refused["success"] is False
    assert refused["message"] == "signals.battery_level.warn_below: expected a number, got 'low'"
    process.wait_for_text("the old parameters stay in force")
    ros.publish("/battery_level", FLOAT32, {"data": 31.0})
    process.wait_for_text("battery_level OK")


def test_the_command_in_the_readme_changes_a_bound(start: Any, ros: Any, parameters: Any, master: Any) -> None:
    readme = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
    (command,) = re.findall(r"^rosparam set .*$", readme, re.MULTILINE)
    process = start("alert_system")
    process.wait_for_text("watching cpu_usage")
    done = subprocess.run(["bash", "-c", command], env=master.environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "success: True" in done.stdout
    assert "battery_level.warn_below: 20 -> 25" in done.stdout
    line = process.wait_for_text("parameters changed")
    assert line.endswith("parameters changed: battery_level.warn_below: 20 -> 25")


def test_a_parameter_that_is_set_in_both_places_ends_it(start: Any, parameters: Any) -> None:
    parameters("/alert_system/ros__parameters/signals/fan/warn_below", 900.0)
    parameters("/alert_system/signals/fan/warn_below", 800.0)
    process = start("alert_system")
    assert process.wait() == 2
    assert process.errors == [
        "alert_system: signals.fan.warn_below: is set twice: /alert_system/signals/fan/warn_below and "
        "/alert_system/ros__parameters/signals/fan/warn_below; delete one of them"
    ]


@pytest.mark.parametrize("executable", ["alert_system", "health_monitor"])
def test_after_kill_9_it_starts_with_the_last_good_parameters_and_says_so(
    start: Any, ros: Any, parameters: Any, executable: str
) -> None:
    bound = "/alert_system/ros__parameters/signals/fan/warn_below"
    parameters(bound, 900.0)
    first = start(executable)
    first.wait_for_text("watching fan on /fan: WARN below 900")
    ros.wait_until(lambda: has_parameter(ros, "/alert_system/last_accepted"))
    parameters(bound, "low")
    first.signal(signal.SIGKILL)
    first.wait()
    second = start(executable)
    second.wait_for_text("watching fan on /fan: WARN below 900")
    line = second.wait_for_text("started with the last good ones")
    assert "parameters: started with the last good ones: signals.fan.warn_below: expected a number, got 'low'" in line
    states = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")

    def own_levels() -> list[int]:
        statuses = [status for array in tuple(states) for status in array["status"]]
        return [status["level"] for status in statuses if status["name"] == "alert_system: monitor"]

    ros.wait_until(lambda: 2 in own_levels())
    assert ros.call("/alert_system/reload", TRIGGER) == {"success": True, "message": "nothing changed"}
    second.wait_for_text("parameters works again")


@pytest.mark.parametrize("executable", ["aggregator", "health_monitor"])
def test_after_kill_9_a_wrong_log_level_ends_nothing(start: Any, ros: Any, parameters: Any, executable: str) -> None:
    first = start(executable)
    first.wait_for_text("system_health is the mean of")
    ros.wait_until(lambda: has_parameter(ros, f"/{executable}/last_accepted"))
    parameters(f"/{executable}/log_level", "LOUD")
    first.signal(signal.SIGKILL)
    first.wait()
    second = start(executable)
    second.wait_for_texts("parameters: started with the last good ones: log_level: expected one of", "system_health is")


def test_reload_changes_the_log_level(start: Any, ros: Any, parameters: Any) -> None:
    process = start("alert_system")
    process.wait_for_text("watching cpu_usage")
    parameters("/alert_system/log_level", "ERROR")
    response = ros.call("/alert_system/reload", TRIGGER)
    assert response == {"success": True, "message": "log_level: INFO -> ERROR"}
    parameters("/alert_system/signals/battery_level/error_below", 40.0)
    parameters("/alert_system/signals/battery_level/warn_below", 50.0)
    assert ros.call("/alert_system/reload", TRIGGER)["success"] is True
    ros.publish("/battery_level", FLOAT32, {"data": 45.0})
    ros.publish("/battery_level", FLOAT32, {"data": 35.0})
    process.wait_for_text("battery_level ERROR")
    assert warnings_of(process, "battery_level") == []


def has_parameter(ros: Any, name: str) -> bool:
    return bool(ros._master.hasParam(name))


def test_simulated_time_is_followed(start: Any, ros: Any, parameters: Any) -> None:
    """With a clock that stands still nothing becomes stale; when it jumps, everything does."""
    parameters("/use_sim_time", True)
    process = start("alert_system")
    process.wait_for_text(READY["alert_system"])
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    steps = itertools.count(200)

    def step() -> bool:
        ros.set_time(next(steps) + 0.5)
        return bool(reports)

    ros.wait_until(step)
    stamp = reports[0]["header"]["stamp"]
    assert stamp["secs"] >= 200 and stamp["nsecs"] == 500_000_000

    def is_ok() -> bool:  # the sample and the clock come over different connections
        ros.publish("/battery_level", FLOAT32, {"data": 50.0})
        step()
        shown = [(status["name"], status["level"]) for report in tuple(reports) for status in report["status"]]
        return ("alert_system: battery_level", 0) in shown

    ros.wait_until(is_ok)
    ros.set_time(100_000.0)
    process.wait_for_line(lambda line: "battery_level STALE: no " in line)


def test_lines_name_time_and_severity_as_ros_has_them(master: Any, start: Any) -> None:
    process = start("aggregator")
    line = process.wait_for_text(READY["aggregator"])
    assert re.match(r"\[INFO\] \[\d+\.\d+\]: system_health", line)
