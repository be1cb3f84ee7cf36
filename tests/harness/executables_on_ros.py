"""The executables as a user meets them on a real graph of ROS: one suite for ROS 1 and ROS 2.

A test class inherits from `ExecutablesOnRos` and says how a user of that ROS sets parameters and names.
"""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any, Mapping

import pytest

from harness.histories import stored_texts
from harness.line_process import LineProcess
from robot_health_monitor.core.config.monitor_config import DEFAULT_SIGNALS

FLOAT32 = "std_msgs/Float32"
TRIGGER = "std_srvs/Trigger"
ARRAY = "diagnostic_msgs/DiagnosticArray"
STATUS = "diagnostic_msgs/DiagnosticStatus"
READY = {
    "battery_sensor": 'sensor "robot" started at 1 Hz',
    "aggregator": "system_health is the mean of",
    "alert_system": "watching cpu_usage",
    "health_monitor": 'sensor "robot" started at 1 Hz',
}
"""What each executable writes when it is ready."""
NEVER_STALE = {name: {**each, "stale_after_s": 0.0} for name, each in DEFAULT_SIGNALS.items()}
"""The default signals, for a machine that may be busy."""
WRONG_FILE = "alert_system:\n  ros__parameters:\n    signals:\n      battery_level:\n        warn_bellow: 20.0\n"


def file_with(folder: Path, text: str) -> str:
    """Writes a file of thresholds and returns its path."""
    file = folder / "thresholds.yaml"
    file.write_text(text, encoding="utf-8")
    return str(file)


def warnings_of(process: LineProcess, signal_name: str) -> list[str]:
    return [line.text for line in process.lines if f"{signal_name} WARN" in line.text]


def unexpected(process: LineProcess) -> list[str]:
    """Returns the lines of a calm run that say more than that it starts."""
    return [line.text for line in process.lines if "[INFO]" not in line.text and "simulated values: " not in line.text]


def level_of(status: Mapping[str, Any]) -> int:
    """Returns the level of a native status, which is bytes in rclpy."""
    level = status["level"]
    return level[0] if isinstance(level, bytes) else level


def shows(reports: list[Mapping[str, Any]], name: str, level: int) -> bool:
    """Returns whether a report has a status of alert_system at a level."""
    statuses = [status for report in tuple(reports) for status in report["status"]]
    return any(each["name"] == f"alert_system: {name}" and level_of(each) == level for each in statuses)


class ExecutablesOnRos:
    """What the executables do on either.

    `ros` is the rest of the robot. `run(executable, parameters, name=, namespace=, remap=)` starts one with parameters
    by node.
    """

    parameter_service: str
    """The service with which the parameters of a node change."""

    def send(self, ros: Any, topic: str, value: float) -> None:
        """Publishes a Float32 to an executable."""
        raise NotImplementedError

    def connect(self, ros: Any, topic: str, value: float, signal_name: str, diagnostics: str = "/diagnostics") -> None:
        """Publishes a Float32 to alert_system, which has received it when this returns."""
        raise NotImplementedError

    @pytest.fixture
    def run(self) -> Any:
        raise NotImplementedError

    def registered(self, ros: Any, node: str) -> bool:
        """Returns whether a node that has ended is still known to a master."""
        return False

    def test_battery_sensor_publishes_its_three_metrics(self, ros: Any, run: Any) -> None:
        process = run("battery_sensor", {"battery_sensor": {"publish_rate": 20.0, "battery_level": {"charge_at": 0.0}}})
        process.wait_for_text("started at 20 Hz")
        heard = {name: ros.listen(f"/{name}", FLOAT32) for name in DEFAULT_SIGNALS}
        ros.wait_until(lambda: all(len(messages) >= 3 for messages in heard.values()))
        levels = [message["data"] for message in heard["battery_level"]]
        assert all(0.0 <= level <= 100.0 for level in levels)
        assert levels == sorted(levels, reverse=True)

    def test_battery_sensor_publishes_this_computer_and_its_processes(self, ros: Any, run: Any) -> None:
        own = {"source": "process_memory", "command": "*battery_sensor*", "reduce": "max"}
        given = {"publish_rate": 20.0, "host_preset": "standard", "host": {"own": own}}
        process = run("battery_sensor", {"battery_sensor": given})
        process.wait_for_text("systemd_failed, own")
        heard = {name: ros.listen(f"/{name}", FLOAT32) for name in ("disk_percent", "memory_percent", "own")}
        ros.wait_until(lambda: all(len(messages) >= 3 for messages in heard.values()))
        assert 0.0 < heard["disk_percent"][-1]["data"] < 100.0
        assert 10.0 < heard["own"][-1]["data"] < 1000.0  # MB

    def test_system_health_is_the_average_of_the_three(self, ros: Any, run: Any) -> None:
        process = run("aggregator", {"aggregator": {"publish_rate": 20.0}})
        process.wait_for_text(READY["aggregator"])
        heard = ros.listen("/system_health", FLOAT32)

        def is_heard() -> bool:  # an input is fresh for 5 s; what is sent before both ends are connected may be lost
            for name, value in (("battery_level", 90.0), ("temperature", 45.0), ("cpu_usage", 30.0)):
                self.send(ros, f"/{name}", value)
            return bool(heard)

        ros.wait_until(is_heard)
        assert heard[0]["data"] == 55.0

    def test_each_crossing_is_one_warning(self, ros: Any, run: Any) -> None:
        self.check_crossings(ros, run, {})

    def check_crossings(self, ros: Any, run: Any, given: Mapping[str, Any]) -> None:
        process = run("alert_system", {"alert_system": {"signals": NEVER_STALE, **given}})
        process.wait_for_text(READY["alert_system"])
        alerts = ros.listen("/alerts", STATUS)
        self.connect(ros, "/battery_level", 25.0, "battery_level")
        self.connect(ros, "/temperature", 80.0, "temperature")
        for percent in (20.0, 19.5, 19.0, 18.0, 23.0, 19.0, 19.0):
            self.send(ros, "/battery_level", percent)
        ros.wait_until(lambda: len(alerts) == 3)  # not by the lines, which go to two streams, in no common order
        for degrees in (80.5, 81.0):
            self.send(ros, "/temperature", degrees)
        ros.wait_until(lambda: len(alerts) == 4)
        process.signal()
        assert process.wait(30.0) == 0
        assert [line for line in process.lines if "[ERROR]" in line.text] == []
        assert len(warnings_of(process, "battery_level")) == 2
        assert "battery_level WARN: 19.5 % is below 20 %" in warnings_of(process, "battery_level")[0]
        (line,) = warnings_of(process, "temperature")
        assert "temperature WARN: 80.5 °C is above 80 °C" in line
        assert [(alert["name"], level_of(alert)) for alert in alerts] == [
            ("alert_system: battery_level", 1),
            ("alert_system: battery_level", 0),
            ("alert_system: battery_level", 1),
            ("alert_system: temperature", 1),
        ]

    @pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
    @pytest.mark.parametrize("executable", list(READY))
    def test_a_signal_ends_it_cleanly(self, ros: Any, run: Any, executable: str, number: int) -> None:
        process = run(executable)
        process.wait_for_text(READY[executable])
        process.signal(number)
        assert process.wait(30.0) == 0
        assert unexpected(process) == []
        assert not self.registered(ros, f"/{executable}")

    @pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
    def test_two_signals_during_the_start_end_it_cleanly(self, ros: Any, run: Any, second: int) -> None:
        """At Ctrl-C a terminal and launch each send one. rospy's handlers may wait forever for an interrupted lock."""
        process = run("health_monitor")
        process.wait_for_text("watching battery_level")
        process.signal()
        process.signal(second)
        assert process.wait(30.0) == 0
        assert unexpected(process) == []
        assert not self.registered(ros, "/health_monitor")

    def test_a_wrong_field_ends_it_before_it_listens(self, run: Any) -> None:
        signals = {"battery_level": {"field": "percentage", "type": FLOAT32}}
        process = run("alert_system", {"alert_system": {"signals": signals}})
        assert process.wait() == 2
        (line,) = process.errors
        assert "/battery_level" in line and "std_msgs/Float32" in line and "data" in line

    def test_the_log_level_is_honoured(self, ros: Any, run: Any) -> None:
        self.check_log_level(ros, run("alert_system", {"alert_system": {"log_level": "WARN"}}))

    def check_log_level(self, ros: Any, process: LineProcess) -> None:
        ros.wait_until(lambda: ros.services() >= {"/alert_system/reset"})
        self.connect(ros, "/battery_level", 15.0, "battery_level")
        process.wait_for_text("battery_level WARN")
        process.signal()
        assert process.wait() == 0
        assert [line.text for line in process.lines if "[INFO]" in line.text] == []

    def test_names_namespaces_and_topics_can_be_changed_from_outside(self, ros: Any, run: Any) -> None:
        remap = {"battery_level": "power/level", "/diagnostics": "diagnostics"}
        process = run("alert_system", {}, name="watchdog", namespace="/robot1", remap=remap)
        process.wait_for_text(READY["alert_system"])
        alerts = ros.listen("/robot1/alerts", STATUS)
        reports = ros.listen("/robot1/diagnostics", ARRAY)
        self.connect(ros, "/robot1/power/level", 50.0, "battery_level", "/robot1/diagnostics")
        self.send(ros, "/robot1/power/level", 15.0)
        ros.wait_until(lambda: "watchdog: battery_level" in [alert["name"] for alert in alerts] and bool(reports))
        assert ros.call("/robot1/watchdog/reset", TRIGGER)["success"] is True

    def test_the_three_in_one_process_have_the_names_and_parameters_they_have_alone(self, ros: Any, run: Any) -> None:
        sensor = {"publish_rate": 10.0, "battery_level": {"discharge_rate": 20.0}}
        process = run("health_monitor", {"battery_sensor": sensor, "aggregator": {"publish_rate": 5.0}})
        process.wait_for_text('sensor "robot" started at 10 Hz')
        heard = ros.listen("/system_health", FLOAT32)
        process.wait_for_text("battery_level WARN")
        ros.wait_until(lambda: bool(heard))
        service = self.parameter_service
        expected = {"/alert_system/reset", *(f"/{node}/{service}" for node in list(READY)[:3])}
        ros.wait_until(lambda: ros.services() >= expected)
        assert ros.call("/alert_system/reset", TRIGGER)["success"] is True

    def test_after_kill_9_an_open_alert_continues_and_is_not_announced_again(
        self, ros: Any, run: Any, tmp_path: Path
    ) -> None:
        """In a namespace: ROS 2 keeps a killed process in its graph until a timeout, and later tests would meet it."""
        (tmp_path / "ops.yaml").write_text("history: {file: history.db}\n", encoding="utf-8")
        reports = ros.listen("/killed/diagnostics", ARRAY)
        signals = {"battery_level": {"warn_below": 20.0, "stale_after_s": 0.0}}  # however long the start takes
        given = {"alert_system": {"ops": str(tmp_path / "ops.yaml"), "signals": signals}}

        def start() -> LineProcess:
            process: LineProcess = run(
                "alert_system", given, namespace="/killed", remap={"/diagnostics": "/killed/diagnostics"}
            )
            process.wait_for_text("watching battery_level")
            return process

        def publish_until_shown(value: float, level: int) -> None:
            def is_shown() -> bool:
                self.send(ros, "/killed/battery_level", value)
                return shows(reports, "battery_level", level)

            reports.clear()
            ros.wait_until(is_shown)

        first = start()
        publish_until_shown(15.0, 1)
        ros.wait_until(lambda: any("WARN" in text for text in stored_texts(tmp_path / "history.db")))
        first.signal(signal.SIGKILL)
        first.wait()
        second = start()
        publish_until_shown(15.0, 1)
        publish_until_shown(50.0, 0)
        assert "(was WARN for " in second.wait_for_text("battery_level OK")
        assert warnings_of(second, "battery_level") == []

    def test_a_wrong_ops_yaml_ends_it_before_it_listens(self, run: Any, tmp_path: Path) -> None:
        (tmp_path / "ops.yaml").write_text("history: {fil: history.db}\n")
        process = run("alert_system", {"alert_system": {"ops": f"{tmp_path}/ops.yaml"}})
        assert process.wait() == 2
        errors = [line.text for line in process.lines if "ops.yaml" in line.text]
        assert errors == [
            f"alert_system: {tmp_path}/ops.yaml:1: history.fil: unknown key; did you mean file?",
            f"alert_system: {tmp_path}/ops.yaml:1: history.file: is missing; expected the path of the SQLite file, "
            "which is created",
        ]
        assert "watching" not in process.text
