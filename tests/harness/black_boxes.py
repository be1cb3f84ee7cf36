"""A robot on the in-process middleware whose alerts are recorded, in virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

from harness.waiting import wait_for
from robot_health_monitor.cli.operations import Operations
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.ops.configuration import BlackBoxSettings, OpsConfig

START_S = 1000.0
BOOT_S = 1.7e9
"""Wall time of the virtual time 0, in s since 1970: START_S is 2023-11-14 22:30:00 UTC."""

BATTERY = {"type": "std_msgs/Float32", "unit": "%", "warn_below": 20.0, "error_below": 10.0}


class RecordedRobot:
    """Publishes values for its signals, which alert_system judges and the black box records."""

    def __init__(
        self,
        folder: Path,
        signals: Mapping[str, Mapping[str, Any]] | None = None,
        *,
        name: str = "r1",
        operations: Operations | None = None,
        namespace: str = "",
        **settings: Any,
    ) -> None:
        """Starts alert_system; `settings` are further ones of the section `black_box`."""
        self.folder = folder
        self.lines: list[Any] = []
        self.bus = LocalBus(START_S, on_log=self.lines.append, wall_time_s=self.wall_s)
        config = OpsConfig(black_box=BlackBoxSettings(str(folder), **settings))
        self.operations = operations or Operations(config, self.wall_s, lambda: self.bus.now_s)
        self.events: list[Event] = []
        parameters = {"robot_name": name, "signals": {"battery": BATTERY} if signals is None else signals}
        self.node = self.bus.node("alert_system", namespace=namespace, parameters=parameters)
        self.alert_system = self.operations.start(self.node, {"test": self.events.append})
        self.sensor = self.bus.node("sensor", namespace=namespace)

    def wall_s(self) -> float:
        """Returns the time in s since 1970."""
        return BOOT_S + self.bus.now_s

    def publish(self, topic: str, value: object, type_name: str = "std_msgs/Float32") -> None:
        """Publishes a message, or one with this number as `data`."""
        self.sensor.advertise(topic, type_name)
        self.sensor.publish(topic, value if isinstance(value, dict) else {"data": value})

    def feed(self, seconds: float, value: float, topic: str = "battery", rate_hz: float = 10.0) -> None:
        """Publishes a value for some time."""
        begin_s = self.bus.now_s
        for number in range(1, round(seconds * rate_hz) + 1):
            self.bus.run_until(begin_s + number / rate_hz)
            self.publish(topic, value)

    def wait(self, seconds: float) -> None:
        """Lets time pass without messages."""
        self.bus.run_until(self.bus.now_s + seconds)

    @property
    def transitions(self) -> list[Transition]:
        """What was announced."""
        return [event for event in self.events if isinstance(event, Transition)]

    def files(self) -> list[Path]:
        """Waits until all recordings that have ended are written; returns the files, by name."""
        box = self.operations.black_box
        assert box is not None
        wait_for(lambda: not box._recordings)
        return sorted(self.folder.glob("*.mcap"))

    def close(self) -> None:
        """Ends everything."""
        self.alert_system.close()
        self.operations.close()


def recorded(file: Path) -> dict[str, list[tuple[float, bytes]]]:
    """Returns the messages of a file by topic: virtual time in s, and bytes."""
    from mcap.reader import make_reader

    found: dict[str, list[tuple[float, bytes]]] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time / 1e9 - BOOT_S, message.data))
    return found


def attachments(file: Path) -> dict[str, str]:
    """Returns the attachments of a file by name."""
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        return {each.name: each.data.decode("utf-8") for each in make_reader(stream).iter_attachments()}


KILLED = (
    f"ROOT = {str(Path(__file__).resolve().parents[2])!r}"
    + """
import sys
sys.path[:0] = [ROOT, ROOT + "/tests"]
from pathlib import Path
from harness.black_boxes import RecordedRobot
robot = RecordedRobot(Path({folder!r}), after_s=3600.0, topics=("/noise",))
robot.feed(2.0, 50.0)
robot.feed(2.0, 15.0)
print("alert", flush=True)
number = 0
while True:
    number += 1
    robot.wait(0.01)
    robot.publish("/noise", {{"data": str(number) * 200}}, "std_msgs/String")
"""
)
"""A program that records into `folder` until it is killed; it prints a line when the alert has come."""
