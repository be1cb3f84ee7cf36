"""The executables as a user meets them: processes with a master, topics, parameters, signals and exit codes."""

from __future__ import annotations

import itertools
import re
import signal
import subprocess
from pathlib import Path
from typing import Any, Iterator, List, Set

import pytest

from robot_health_monitor.core.config.monitor_config import DEFAULT_SIGNALS

FLOAT32 = "std_msgs/Float32"
TRIGGER = "std_srvs/Trigger"
EXECUTABLES = ("battery_sensor", "aggregator", "alert_system", "health_monitor")
READY = {
    "battery_sensor": 'sensor "robot" started at 1 Hz',
    "aggregator": "system_health is the mean of",
    "alert_system": "watching cpu_usage",
    "health_monitor": 'sensor "robot" started at 1 Hz',
}


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    """The outside world: publishes, listens and calls natively."""
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


def thresholds_file(folder: Path, text: str) -> str:
    file = folder / "thresholds.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


def warnings_of(process: Any, signal_name: str) -> List[str]:
    return [line.text for line in process.lines if f"{signal_name} WARN" in line.text]


def test_battery_sensor_publishes_its_three_metrics(ros: Any, start: Any) -> None:
    process = start("battery_sensor", "_publish_rate:=20")
    process.wait_for_text("started at 20 Hz")
    heard = {name: ros.listen(f"/{name}", FLOAT32) for name in ("battery_level", "temperature", "cpu_usage")}
    ros.wait_until(lambda: all(len(messages) >= 3 for messages in heard.values()))
    levels = [message["data"] for message in heard["battery_level"]]
    assert all(0.0 <= level <= 100.0 for level in levels)
    assert levels == sorted(levels, reverse=True)


def test_battery_sensor_publishes_this_computer_and_its_processes(ros: Any, start: Any, parameters: Any) -> None:
    parameters("/battery_sensor/host_preset", "standard")
    parameters("/battery_sensor/host/own/source", "process_memory")
    parameters("/battery_sensor/host/own/command", "*battery_sensor*")
    parameters("/battery_sensor/host/own/reduce", "max")
    process = start("battery_sensor", "_publish_rate:=20")
    process.wait_for_text("systemd_failed, own")
    heard = {name: ros.listen(f"/{name}", FLOAT32) for name in ("disk_percent", "memory_percent", "own")}
    ros.wait_until(lambda: all(len(messages) >= 3 for messages in heard.values()))
    assert 0.0 < heard["disk_percent"][-1]["data"] < 100.0
    assert 10.0 < heard["own"][-1]["data"] < 1000.0  # MB


def test_system_health_is_the_average_of_the_three(ros: Any, start: Any) -> None:
    process = start("aggregator", "_publish_rate:=20")
    process.wait_for_text(READY["aggregator"])
    heard = ros.listen("/system_health", FLOAT32)

    def is_heard() -> bool:  # an input is fresh for 5 s
        for name, value in (("battery_level", 90.0), ("temperature", 45.0), ("cpu_usage", 30.0)):
            ros.publish(f"/{name}", FLOAT32, {"data": value})
        return bool(heard)

    ros.wait_until(is_heard)
    assert heard[0]["data"] == 55.0


def test_each_crossing_is_one_warning(ros: Any, start: Any, parameters: Any) -> None:
    never_stale = {name: {**signal, "stale_after_s": 0.0} for name, signal in DEFAULT_SIGNALS.items()}
    parameters("/alert_system/signals", never_stale)  # however busy the machine is
    process = start("alert_system")
    process.wait_for_text(READY["alert_system"])
    alerts = ros.listen("/alerts", "diagnostic_msgs/DiagnosticStatus")
    for percent in (25.0, 20.0, 19.5, 19.0, 18.0, 23.0, 19.0, 19.0):
        ros.publish("/battery_level", FLOAT32, {"data": percent})
    ros.wait_until(lambda: len(alerts) == 3)  # not by the lines: WARN and OK go to two streams, in no common order
    for degrees in (80.0, 80.5, 81.0):
        ros.publish("/temperature", FLOAT32, {"data": degrees})
    process.wait_for_text("temperature WARN: 80.5 °C is above 80 °C")
    ros.wait_until(lambda: len(alerts) == 4)
    process.signal()
    assert process.wait() == 0
    assert len(warnings_of(process, "battery_level")) == 2
    assert len(warnings_of(process, "temperature")) == 1
    assert "battery_level WARN: 19.5 % is below 20 %" in warnings_of(process, "battery_level")[0]
    assert [(alert["name"], alert["level"]) for alert in alerts] == [
        ("alert_system: battery_level", 1),
        ("alert_system: battery_level", 0),
        ("alert_system: battery_level", 1),
        ("alert_system: temperature", 1),
    ]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("executable", EXECUTABLES)
def test_a_signal_ends_it_cleanly(master: Any, start: Any, executable: str, number: int) -> None:
    process = start(executable)
    process.wait_for_text(READY[executable])
    process.signal(number)
    assert process.wait(30.0) == 0
    assert [line for line in process.errors if "simulated values: " not in line] == []
    assert f"/{executable}" not in registered_nodes(master)


def test_a_signal_during_the_start_ends_it_cleanly(master: Any, start: Any) -> None:
    """At any moment: rospy's own handlers may wait forever for a lock that the interrupted call holds."""
    process = start("health_monitor")
    process.wait_for_text("watching battery_level")
    process.signal()
    process.signal(signal.SIGTERM)
    assert process.wait(30.0) == 0
    assert [line for line in process.errors if "simulated values: " not in line] == []
    assert "/health_monitor" not in registered_nodes(master)


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
    file = thresholds_file(
        tmp_path,
        "alert_system:\n  ros__parameters:\n    signals:\n      battery_level:\n        warn_bellow: 20.0\n",
    )
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


def test_a_wrong_field_ends_it_before_it_listens(master: Any, start: Any, parameters: Any) -> None:
    parameters("/alert_system/ros__parameters/signals/battery_level", {"field": "percentage", "type": FLOAT32})
    process = start("alert_system")
    assert process.wait() == 2
    (line,) = process.errors
    assert "/battery_level" in line and "std_msgs/Float32" in line and "data" in line


def test_the_log_level_is_honoured(master: Any, start: Any, ros: Any) -> None:
    process = start("alert_system", "_log_level:=WARN")
    ros.wait_until(lambda: "/alert_system/reset" in services(ros))
    ros.publish("/battery_level", FLOAT32, {"data": 15.0})
    process.wait_for_text("battery_level WARN")
    process.signal()
    assert process.wait() == 0
    assert [line.text for line in process.lines if "[INFO]" in line.text] == []


def test_a_wrong_log_level_is_refused(master: Any, start: Any) -> None:
    process = start("aggregator", "_log_level:=LOUD")
    assert process.wait() == 2
    assert process.errors == ["aggregator: log_level: expected one of DEBUG, INFO, WARN, ERROR, FATAL, got 'LOUD'"]


def test_names_namespaces_and_topics_can_be_changed_from_outside(master: Any, start: Any, ros: Any) -> None:
    process = start(
        "alert_system",
        "__name:=watchdog",
        "battery_level:=power/level",
        "/diagnostics:=diagnostics",
        environment={"ROS_NAMESPACE": "robot1"},
    )
    process.wait_for_text(READY["alert_system"])
    alerts = ros.listen("/robot1/alerts", "diagnostic_msgs/DiagnosticStatus")
    reports = ros.listen("/robot1/diagnostics", "diagnostic_msgs/DiagnosticArray")
    ros.publish("/robot1/power/level", FLOAT32, {"data": 15.0})
    ros.wait_until(lambda: "watchdog: battery_level" in [alert["name"] for alert in alerts] and bool(reports))
    assert ros.call("/robot1/watchdog/reset", TRIGGER)["success"] is True


def test_the_three_in_one_process_have_the_names_they_have_alone(start: Any, ros: Any, parameters: Any) -> None:
    parameters("/battery_sensor/ros__parameters/battery_level/discharge_rate", 20.0)
    parameters("/battery_sensor/publish_rate", 10.0)
    process = start("health_monitor")
    process.wait_for_text('sensor "robot" started at 10 Hz')
    heard = ros.listen("/system_health", FLOAT32)
    process.wait_for_text("battery_level WARN")
    ros.wait_until(lambda: bool(heard))
    names = services(ros)
    assert {"/alert_system/reset", "/alert_system/reload", "/aggregator/reload", "/battery_sensor/reload"} <= names
    assert ros.call("/alert_system/reset", TRIGGER)["success"] is True


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

    def own_levels() -> List[int]:
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


def registered_nodes(master: Any) -> Set[str]:
    """The nodes that the master knows."""
    import rosgraph

    state = rosgraph.Master("/tests", master.uri).getSystemState()
    return {node for kind in state for _, nodes in kind for node in nodes}


def services(ros: Any) -> Set[str]:
    return {name for name, _ in ros._master.getSystemState()[2]}


def test_lines_name_time_and_severity_as_ros_has_them(master: Any, start: Any) -> None:
    process = start("aggregator")
    line = process.wait_for_text(READY["aggregator"])
    assert re.match(r"\[INFO\] \[\d+\.\d+\]: system_health", line)


def test_after_kill_9_an_open_alert_continues_and_is_not_announced_again(
    start: Any, ros: Any, parameters: Any, tmp_path: Path
) -> None:
    (tmp_path / "ops.yaml").write_text("history: {file: history.db}\n", encoding="utf-8")
    parameters("/alert_system/ops", str(tmp_path / "ops.yaml"))
    parameters("/alert_system/signals/battery_level/warn_below", 20.0)
    parameters("/alert_system/signals/battery_level/stale_after_s", 0.0)  # however long the start takes
    reports = ros.listen("/diagnostics", "diagnostic_msgs/DiagnosticArray")

    def publish_until_shown(value: float, level: int) -> None:
        def is_shown() -> bool:
            ros.publish("/battery_level", FLOAT32, {"data": value})
            shown = [(status["name"], status["level"]) for report in tuple(reports) for status in report["status"]]
            return ("alert_system: battery_level", level) in shown

        reports.clear()
        ros.wait_until(is_shown)

    first = start("alert_system")
    first.wait_for_text("watching battery_level")
    publish_until_shown(15.0, 1)
    first.signal(signal.SIGKILL)
    first.wait()
    second = start("alert_system")
    second.wait_for_text("watching battery_level")
    publish_until_shown(15.0, 1)
    publish_until_shown(50.0, 0)
    assert "(was WARN for " in second.wait_for_text("battery_level OK")
    assert warnings_of(second, "battery_level") == []


def test_a_wrong_ops_yaml_ends_it_before_it_listens(master: Any, start: Any, tmp_path: Path) -> None:
    (tmp_path / "ops.yaml").write_text("history: {fil: history.db}\n")
    process = start("alert_system", f"_ops:={tmp_path}/ops.yaml")
    assert process.wait() == 2
    errors = [line.text for line in process.lines if "ops.yaml" in line.text]
    assert errors == [
        f"alert_system: {tmp_path}/ops.yaml:1: history.fil: unknown key; did you mean file?",
        f"alert_system: {tmp_path}/ops.yaml:1: history.file: is missing; expected the path of the SQLite file, which "
        "is created",
    ]
    assert "watching" not in process.text
