"""A robot with battery, joints, camera, scanner, IMU and drivers, on any middleware, with faults to inject."""

from __future__ import annotations

import math
import random
from typing import Any, Callable, Container, Mapping

from robot_health_monitor.core.port.middleware import Middleware

DRIVERS = ("motor_driver: left", "motor_driver: right", "laser")


class WholeRobot:
    """Publishes until its node is closed. `fault` is the present fault, empty for none; see `FAULTS`."""

    def __init__(self, node: Middleware, speed: float = 1.0) -> None:
        """Starts; `speed` multiplies all rates."""
        self.fault = ""
        self._node = node
        self._chance = random.Random(7)
        self._calls: dict[str, int] = {}
        self._still_s = 0.0
        for topic, type_name, rate_hz, make in (
            ("battery_state", "sensor_msgs/BatteryState", 1.0, self._battery),
            ("joint_states", "sensor_msgs/JointState", 5.0, self._joints),
            ("camera/image", "sensor_msgs/Image", 5.0, self._image),
            ("scan", "sensor_msgs/LaserScan", 5.0, self._scan),
            ("imu", "sensor_msgs/Imu", 5.0, self._imu),
            ("motor_temperature", "sensor_msgs/Temperature", 1.0, self._temperature),
            ("/diagnostics", "diagnostic_msgs/DiagnosticArray", 1.0, self._drivers),
        ):
            node.advertise(topic, type_name)
            node.create_timer(1.0 / (rate_hz * speed), self._publisher(topic, make))
        node.advertise("event", "std_msgs/String")
        node.create_timer(0.1, self._maybe_event)

    def _publisher(self, topic: str, make: Callable[[float], Mapping[str, Any]]) -> Callable[[float], None]:
        def publish(now_s: float) -> None:
            calls = self._calls[topic] = self._calls.get(topic, 0) + 1
            if self.fault == f"{topic} dies" or (self.fault == f"{topic} halves" and calls % 2):
                return
            for _ in range(2 if self.fault == f"{topic} doubles" else 1):
                self._node.publish(topic, make(now_s))

        return publish

    def _maybe_event(self, now_s: float) -> None:
        if self._chance.random() < 0.03:
            self._node.publish("event", {"data": "bumper"})

    def _header(self, topic: str, age_s: float) -> dict[str, Any]:
        stamp_s = self._node.stamp_s() - age_s
        if self.fault == f"{topic} stands still":
            self._still_s = stamp_s = self._still_s or stamp_s
        else:
            self._still_s = 0.0 if self.fault == "" else self._still_s
        stamp_s -= 5.0 if self.fault == f"{topic} late" else 0.0
        return {"stamp": {"secs": int(stamp_s), "nsecs": int(stamp_s % 1.0 * 1e9)}}

    def _battery(self, now_s: float) -> Mapping[str, Any]:
        charge = {"battery low": 0.15, "battery empty": 0.05}.get(self.fault, 0.83)
        cells = [4.0 + self._chance.uniform(-0.01, 0.01) for _ in range(6)]
        cells[3] -= 0.3 if self.fault == "a cell drops" else 0.0
        return {
            "header": self._header("battery_state", 0.01), "percentage": charge, "voltage": sum(cells),
            "current": self._chance.gauss(-2.0, 0.1), "cell_voltage": cells,
        }  # fmt: skip

    def _joints(self, now_s: float) -> Mapping[str, Any]:
        efforts = [math.sin(now_s), 2.0 + math.cos(now_s / 3.0) + (8.0 if self.fault == "a joint overloads" else 0.0)]
        positions = [math.sin(now_s / 5.0), math.cos(now_s / 7.0)]
        header = self._header("joint_states", 0.002)
        return {"header": header, "name": ["shoulder", "elbow"], "position": positions, "effort": efforts}

    def _image(self, now_s: float) -> Mapping[str, Any]:
        return {"header": self._header("camera/image", 0.05), "height": 1, "width": 4, "step": 4, "data": "AAECAw=="}

    def _scan(self, now_s: float) -> Mapping[str, Any]:
        return {"header": self._header("scan", 0.02), "range_min": 0.1, "range_max": 10.0, "ranges": [1.0, 2.0]}

    def _imu(self, now_s: float) -> Mapping[str, Any]:
        gravity = 9.81 + self._chance.gauss(0.0, 0.05) + (15.0 if self.fault == "imu shakes" else 0.0)
        return {"header": self._header("imu", 0.001), "linear_acceleration": {"x": 0.0, "y": 0.0, "z": gravity}}

    def _temperature(self, now_s: float) -> Mapping[str, Any]:
        celsius = 90.0 if self.fault == "the motor overheats" else self._chance.gauss(45.0, 0.5)
        return {"header": self._header("motor_temperature", 0.01), "temperature": celsius}

    def _drivers(self, now_s: float) -> Mapping[str, Any]:
        level = {"a driver reports ERROR": 2, "a driver reports WARN": 1}.get(self.fault, 0)
        names = DRIVERS[1:] if self.fault == "a driver is silent" else DRIVERS
        statuses: list[Any] = [
            {"name": name, "level": level if name == DRIVERS[0] else 0, "message": "overcurrent" if level else "ok"}
            for name in names
        ]
        return {"status": statuses}


def send_frames(node: Middleware, ages_s: Mapping[str, float], stopped: Container[str]) -> None:
    """Publishes transforms at 10 Hz, each frame with the age of its stamps; those that are `stopped` are left out."""

    def send(now_s: float) -> None:
        transforms = []
        for frame, age_s in ages_s.items():
            stamp_s = node.stamp_s() - age_s
            stamp = {"secs": int(stamp_s), "nsecs": int(stamp_s % 1.0 * 1e9)}
            if frame not in stopped:
                transforms.append({"header": {"stamp": stamp, "frame_id": "map"}, "child_frame_id": frame})
        node.publish("/tf", {"transforms": transforms})

    node.advertise("/tf", "tf2_msgs/TFMessage")
    node.create_timer(0.1, send)


def send_log(node: Middleware, error_every_s: float = 20.0) -> None:
    """Publishes a line of the log each second, some of them errors, as healthy robots do."""

    def sender(level: int, text: str) -> Callable[[float], None]:
        line = {"level": level, "name": "/base", "msg": text, "file": "", "function": "", "line": 1, "topics": []}
        header = {"seq": 0, "stamp": {"secs": 1, "nsecs": 0}, "frame_id": ""}
        return lambda now_s: node.publish("/rosout", {"header": header, **line})

    node.advertise("/rosout", "rosgraph_msgs/Log")
    node.create_timer(1.0, sender(4, "slips"))
    node.create_timer(error_every_s, sender(8, "lost"))


FAULTS: Mapping[str, str] = {
    "camera/image dies": "/camera/image STALE",
    "camera/image halves": "camera_image_rate WARN",
    "camera/image stands still": "camera_image_age WARN",
    "scan dies": "/scan STALE",
    "scan halves": "scan_rate WARN",
    "scan late": "scan_age WARN",
    "imu dies": "/imu STALE",
    "imu doubles": "imu_rate WARN",
    "imu shakes": "imu_linear_acceleration_z WARN",
    "joint_states dies": "/joint_states STALE",
    "joint_states halves": "joint_states_rate WARN",
    "a joint overloads": "joint_states_effort_elbow WARN",
    "battery_state dies": "/battery_state STALE",
    "battery low": "battery_state_percentage WARN",
    "battery empty": "battery_state_percentage ERROR",
    "a cell drops": "battery_state_cell_spread ERROR",
    "the motor overheats": "motor_temperature_temperature WARN",
    "a driver reports ERROR": "diagnostics[motor_driver: left] ERROR",
    "a driver reports WARN": "diagnostics[motor_driver: left] WARN",
    "a driver is silent": "diagnostics[motor_driver: left] STALE",
}
"""Faults, each with the alert that names its cause."""
