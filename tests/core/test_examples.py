"""The ready examples in config/: each is loaded unchanged and run with a robot of its kind."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import pytest

from robot_health_monitor.core.config.monitor_config import load_config, sections
from robot_health_monitor.core.config.yaml_file import read_yaml
from robot_health_monitor.core.nodes import AlertSystem, BatterySensor
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.sensors.configuration import PRESETS
from robot_health_monitor.core.values.model import Level, Sample, Transition

CONFIG = Path(__file__).resolve().parents[2] / "config"
BATTERY_TYPE = "sensor_msgs/BatteryState"
CHARGING, DISCHARGING = 1, 2

pytest.importorskip("yaml")


class Robot:
    """An alert_system with one of the examples, and a robot that publishes once a second."""

    def __init__(self, example: str) -> None:
        self.bus = LocalBus()
        self.alerts: list[tuple[float, str, str]] = []
        self.tree = {section.node: section.tree for section in sections(read_yaml(CONFIG / example).tree)}
        self.alert_system = AlertSystem(
            self.bus.node("alert_system", parameters=self.tree["alert_system"]),
            {"test": self._record},
        )
        self._robot = self.bus.node("robot")

    def _record(self, event: Event) -> None:
        assert isinstance(event, Transition)
        self.alerts.append((event.now_s, event.signal, event.to_level.name))

    def publish(self, topic: str, type_name: str, message: Mapping[str, Any]) -> None:
        self._robot.advertise(topic, type_name)
        self._robot.publish(topic, message)

    def drive(self, seconds: int, **values: float) -> None:
        """Publishes what a healthy robot publishes, except for `values`."""
        for _ in range(seconds):
            battery: dict[str, Any] = {
                "percentage": 0.8,
                "voltage": 25.2,
                "power_supply_status": DISCHARGING,
                "cell_voltage": [3.6, 3.6],
            }
            battery.update((name, value) for name, value in values.items() if name in battery)
            self.publish("/battery_state", BATTERY_TYPE, battery)
            temperature = values.get("imu", 35.0)
            self.publish("/imu/temperature", "sensor_msgs/Temperature", {"temperature": temperature})
            status = {
                "name": "motor_driver: left",
                "level": int(values.get("motor", 0)),
                "values": [{"key": "Temperature (C)", "value": str(values.get("motor_temperature", 50.0))}],
            }
            others = {"name": "camera", "level": 2, "values": []}
            self.publish("/diagnostics", "diagnostic_msgs/DiagnosticArray", {"status": [others, status]})
            self.publish("/diagnostics", "diagnostic_msgs/DiagnosticArray", {"status": [others]})
            for number in range(int(values.get("hz", 100.0))):
                self.bus.run_until(self.bus.now_s + 1.0 / values.get("hz", 100.0))
                self.publish("/imu/data", "sensor_msgs/Imu", {})
                self.publish("/odom", "nav_msgs/Odometry", {})
                if number % 10 == 0:
                    self.publish("/scan", "sensor_msgs/LaserScan", {})

    @property
    def levels(self) -> dict[str, str]:
        report = self.alert_system.monitor.report(self.bus.now_s)
        return {name: status.level.name for name, status in report.statuses.items()}

    @property
    def changes(self) -> list[tuple[str, str]]:
        """Returns (signal, level) of every transition so far, and forgets them."""
        seen = [(signal, level) for _, signal, level in self.alerts]
        self.alerts.clear()
        return seen


@pytest.mark.parametrize("example", sorted(path.name for path in CONFIG.glob("*.yaml")))
def test_every_file_in_config_is_a_configuration_that_ros_2_can_read_too(example: str) -> None:
    assert load_config(CONFIG / example).signals
    text = (CONFIG / example).read_text(encoding="utf-8")
    lines = [line.partition("  #")[0] for line in text.splitlines() if not line.startswith("#")]
    assert not any(mark in line for line in lines for mark in (": &", ": *", "<<:")), "rcl reads no anchors"

    def lists(tree: Any) -> list[Any]:
        if isinstance(tree, dict):
            return [found for value in tree.values() for found in lists(value)]
        return [tree] if isinstance(tree, list) else []

    for found in lists(dict(read_yaml(CONFIG / example).tree)):
        assert len({type(item) for item in found}) == 1, "rcl reads no list of several types"


def test_a_healthy_differential_drive_robot_is_ok() -> None:
    robot = Robot("differential_drive.yaml")
    robot.drive(30)
    assert set(robot.levels.values()) == {"OK"}
    assert robot.alerts == []
    values = robot.alert_system.monitor.report(robot.bus.now_s).statuses
    assert values["battery"].message == "80 %"
    assert values["imu_frequency"].values["frequency_hz"] == "100"
    assert values["motor_left_temperature"].values["value"] == "50"


@pytest.mark.newest_python
@pytest.mark.parametrize(
    ("seconds", "values", "expected"),
    [
        (4, {"percentage": 0.15}, []),
        (8, {"percentage": 0.15}, [("battery", "WARN")]),
        (8, {"percentage": 0.05}, [("battery", "ERROR")]),
        (8, {"percentage": 0.15, "power_supply_status": CHARGING}, []),
        (8, {"percentage": -0.01}, [("battery", "ERROR")]),
        (8, {"percentage": float("nan")}, [("battery", "ERROR")]),
        (8, {"percentage": 80.0}, [("battery", "ERROR")]),
        (8, {"voltage": 22.0}, [("battery_voltage", "WARN")]),
        (3, {"voltage": 22.0}, []),
        (2, {"cell_voltage": []}, [("battery_cell", "ERROR")]),
        (8, {"imu": 71.0}, [("imu_temperature", "WARN")]),
        (12, {"hz": 60.0}, [("imu_frequency", "WARN")]),
        (2, {"motor": 1}, [("motor_left", "WARN")]),
        (2, {"motor": 3}, [("motor_left", "ERROR")]),
        (2, {"motor_temperature": 91.5}, [("motor_left_temperature", "WARN")]),
    ],
)
def test_problems_of_a_differential_drive_robot_are_announced(
    seconds: int, values: dict[str, Any], expected: list[tuple[str, str]]
) -> None:
    robot = Robot("differential_drive.yaml")
    robot.drive(15)
    robot.drive(seconds, **values)
    assert robot.changes == expected


@pytest.mark.newest_python
def test_a_discharge_of_a_differential_drive_robot_is_one_alert_of_its_voltage() -> None:
    robot = Robot("differential_drive.yaml")
    robot.drive(15)
    for _ in range(3):
        robot.drive(7, voltage=22.0)
        robot.drive(7, voltage=24.0)
    assert robot.changes == [("battery_voltage", "WARN")]
    robot.drive(2, power_supply_status=CHARGING)
    assert robot.changes == [("battery_voltage", "OK")]
    robot.drive(7, voltage=22.0)
    assert robot.changes == [("battery_voltage", "WARN")]


def test_a_differential_drive_robot_that_falls_silent_is_stale() -> None:
    robot = Robot("differential_drive.yaml")
    robot.drive(15)
    robot.bus.run_until(robot.bus.now_s + 10.0)
    assert set(robot.levels.values()) == {"STALE"}


def test_a_raspberry_pi_watches_itself() -> None:
    pytest.importorskip("psutil")
    robot = Robot("raspberry_pi.yaml")
    BatterySensor(robot.bus.node("battery_sensor", parameters=robot.tree["battery_sensor"]))
    robot.bus.run_until(20.0)
    levels = robot.levels
    for signal in ("memory", "sd_card", "load_5min"):
        assert levels[signal] != "STALE"
    assert "swap" not in {signal for signal, _ in robot.changes}  # a computer without swap is no alert
    assert "battery_level" not in levels
    sensed = {signal.topic for signal in load_config(CONFIG / "raspberry_pi.yaml").signals.values()}
    assert sensed == {"temperature", "cpu_usage", *robot.tree["battery_sensor"]["host"]}


def test_a_computer_watches_itself_by_the_standard_preset(tmp_path: Path) -> None:
    pytest.importorskip("psutil")
    robot = Robot("host.yaml")
    BatterySensor(robot.bus.node("battery_sensor", parameters=robot.tree["battery_sensor"]))
    robot.bus.run_until(20.0)
    levels = robot.levels
    for signal in ("memory_percent", "disk_percent", "disk_read_only", "load_5min"):
        assert levels[signal] == "OK" or (signal == "load_5min" and levels[signal] == "WARN")
    # What a computer lacks is no alert. (Its CPU load may be: virtual time is faster than the kernel counts.)
    assert {signal for signal, level in robot.changes if level == "STALE"} <= {"cpu_usage"}
    sensed = {signal.topic for signal in load_config(CONFIG / "host.yaml").signals.values()}
    assert sensed == {"battery_level", "temperature", "cpu_usage", *PRESETS["standard"]}


def test_a_mixed_fleet_is_judged_robot_by_robot_and_a_lost_link_is_one_alert() -> None:
    carter, husky = Robot("mixed_fleet.yaml"), Robot("mixed_fleet.yaml")
    for robot in (carter, husky):
        robot.drive(15, hz=10.0)
    report = {"status": [{"name": "alert_system: cpu_usage", "level": 0, "values": []}]}
    for robot in (carter, husky):
        robot.publish("/diagnostics", "diagnostic_msgs/DiagnosticArray", report)
        assert robot.changes in ([], [("mission_computer", "STALE"), ("mission_computer", "OK")])
    carter.drive(12, hz=10.0, percentage=0.2)
    assert ("battery", "WARN") in carter.changes
    assert husky.changes == []

    husky.alert_system.observe(Sample("link", 1.0, husky.bus.now_s))
    husky.alert_system.observe(Sample("link", 0.0, husky.bus.now_s))
    husky.bus.run_until(husky.bus.now_s + 60.0)
    assert husky.changes == [("link", "ERROR")]
    battery = husky.alert_system.monitor.report(husky.bus.now_s).statuses["battery"]
    assert (battery.level, battery.values["state"]) == (Level.STALE, "unreachable")
