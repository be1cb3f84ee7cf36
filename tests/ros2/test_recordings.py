"""The replay of a run gives the alerts of the run: a node records what was published, and rosbags writes it."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any, Iterator

import pytest

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.recordings.decoding import type_of
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

FLOAT32 = "std_msgs/Float32"
TICK_S = 1.0
LATENCY_S = 2.0
"""Largest difference between the arrival of a message at the recorder and at the node on a busy machine."""
PARAMETERS = {
    "signals": {
        "battery_level": {"warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0},
        "temperature": {"warn_above": 80.0, "for_s": 1.0, "stale_after_s": 1.5},
    }
}
TYPES = {
    "/battery_level": "std_msgs/msg/Float32",
    "/temperature": "std_msgs/msg/Float32",
    "/alerts": "diagnostic_msgs/msg/DiagnosticStatus",
}


class Recorder:
    """Records messages as they come over DDS, with the time of their arrival."""

    def __init__(self, ros_environment: dict[str, str]) -> None:
        from diagnostic_msgs.msg import DiagnosticStatus
        from harness.ros2 import Participant, Spinner
        from std_msgs.msg import Float32

        self.messages: list[tuple[int, str, bytes]] = []
        participant = Participant(int(ros_environment["ROS_DOMAIN_ID"]))
        self._node = node = participant.node("recorder")
        for topic, type_name in TYPES.items():
            cls = Float32 if type_name.endswith("Float32") else DiagnosticStatus
            node.create_subscription(cls, topic, self._note(topic), 100, raw=True)
        self._spinner = Spinner(participant)

    def is_connected(self) -> bool:
        """Returns whether the node under test publishes to this recorder."""
        (alerts,) = (each for each in self._node.subscriptions if each.topic_name == "/alerts")
        return bool(alerts.get_publisher_count())

    def has_recorded(self, topic: str) -> bool:
        return any(recorded == topic for _, recorded, _ in list(self.messages))

    def _note(self, topic: str) -> Any:
        messages = self.messages
        return lambda data: messages.append((time.time_ns(), topic, bytes(data)))

    def end(self) -> None:
        """Records nothing more."""
        self.messages = list(self.messages)

    def write(self, folder: Path, storage: str) -> str:
        """Writes a folder of rosbag2, and returns its path."""
        from rosbags import rosbag2
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_JAZZY)
        writer = rosbag2.Writer(folder, version=9, storage_plugin=rosbag2.StoragePlugin[storage])
        with writer:
            connections = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in TYPES.items()}
            for time_ns, topic, data in self.messages:
                writer.write(connections[topic], time_ns, data)
        return str(folder)

    def close(self) -> None:
        self._spinner.close()


@pytest.fixture
def recorder(ros_environment: dict[str, str]) -> Iterator[Recorder]:
    found = Recorder(ros_environment)
    yield found
    found.close()


def test_a_replay_gives_the_alerts_of_the_run(ros: Any, start: Any, recorder: Recorder, tmp_path: Path) -> None:
    file = tmp_path / "thresholds.yaml"
    file.write_text(json.dumps({"alert_system": {"ros__parameters": PARAMETERS}}))  # JSON is YAML
    start("alert_system", "--ros-args", "--params-file", str(file)).wait_for_text("watching temperature")
    ros.wait_until(recorder.is_connected)
    pause = threading.Event()
    for topic, value in (("/battery_level", 50.0), ("/temperature", 60.0)):
        ros.connect_to_process(topic, {"data": value}, topic[1:])
        give_up_s = time.monotonic() + 60.0
        while not recorder.has_recorded(topic):  # it may become ready later than the node
            assert time.monotonic() < give_up_s, f"nothing recorded of {topic}"
            ros.publish_to_process(topic, FLOAT32, {"data": value}, subscribers=2)
            pause.wait(0.1)
    for step in range(95):
        battery = 50.0 if step < 10 or step >= 85 else 15.0 if step < 32 else 5.0
        ros.publish_to_process("/battery_level", FLOAT32, {"data": battery}, subscribers=2)
        if step < 45:
            ros.publish_to_process("/temperature", FLOAT32, {"data": 85.0 if step > 5 else 60.0}, subscribers=2)
        pause.wait(0.1)
    ros.wait_until(lambda: sum(topic == "/alerts" for _, topic, _ in recorder.messages) >= 5)
    recorder.end()  # before the topics are stale

    for storage in ("SQLITE3", "MCAP"):
        with Recordings([recorder.write(tmp_path / storage, storage)]) as recordings:
            (channel,) = [channel for channel in recordings.channels if channel.topic == "/alerts"]
            read = type_of(channel).field_getter("")
            announced = [(time_ns / 1e9, read(data)) for time_ns, _, data in recordings.messages({channel: None})]
            live = [(at_s, alert["name"].partition(": ")[2], alert["level"]) for at_s, alert in announced]
            replayed = replay(recordings)
        assert [alert[1:] for alert in replayed] == [alert[1:] for alert in live]
        assert {alert[1:] for alert in live} >= {
            ("battery_level", 1), ("battery_level", 2), ("battery_level", 0), ("temperature", 1), ("temperature", 3)
        }  # fmt: skip
        # A silence is noticed by a tick: those of the replay are at other times than the live ones.
        assert all(abs(found[0] - expected[0]) <= TICK_S + LATENCY_S for found, expected in zip(replayed, live))


def replay(recordings: Recordings) -> list[tuple[float, str, int]]:
    """Returns time, signal and level of each transition."""
    found: list[tuple[float, str, int]] = []
    player = Player(recordings)

    def note(event: Any) -> None:
        if isinstance(event, Transition):
            found.append((player.wall_s, event.signal, int(event.to_level)))

    AlertSystem(player.node("alert_system", PARAMETERS), {"test": note}, log_alerts=False)
    player.play()
    assert player.problems == []
    return found
