"""The replay of a run gives the alerts of the run: recorded by the real `rosbag record`, alerts included."""

from __future__ import annotations

import signal
import subprocess
import threading
from pathlib import Path
from typing import Any, Iterator

import pytest

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.recordings.decoding import type_of
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

FLOAT32 = "std_msgs/Float32"
TOPICS = ("/battery_level", "/temperature", "/alerts")
TICK_S = 1.0
LATENCY_S = 2.0
"""Largest difference between the arrival of a message at the recorder and at the node on a busy machine."""
PARAMETERS = {
    "signals": {
        "battery_level": {"warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0},
        "temperature": {"warn_above": 80.0, "for_s": 1.0, "stale_after_s": 1.5},
    }
}


@pytest.fixture
def ros(ros_process: Any) -> Iterator[Any]:
    """The outside world: publishes natively."""
    from harness.ros1 import Ros1Harness

    harness = Ros1Harness()
    yield harness
    harness.close()


@pytest.fixture
def recorder(master: Any, tmp_path: Path) -> Iterator[subprocess.Popen]:  # type: ignore[type-arg]
    process = subprocess.Popen(["rosbag", "record", "-O", str(tmp_path / "run.bag"), *TOPICS], env=master.environment)
    yield process
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
        process.wait(20)


def wait_until_recording(ros: Any, master: Any) -> None:
    import rosgraph

    server = rosgraph.Master("/tests", master.uri)

    def recorded() -> list[str]:
        _, subscribers, _ = server.getSystemState()
        return [topic for topic, nodes in subscribers if any(node.startswith("/record_") for node in nodes)]

    ros.wait_until(lambda: set(TOPICS) <= set(recorded()))


def test_a_replay_gives_the_alerts_of_the_run(
    ros: Any, start: Any, parameters: Any, master: Any, recorder: Any, tmp_path: Path
) -> None:
    parameters("/alert_system/ros__parameters", PARAMETERS)
    parameters("/use_sim_time", False)
    start("alert_system").wait_for_text("watching temperature")
    wait_until_recording(ros, master)
    heard = ros.listen("/alerts", "diagnostic_msgs/DiagnosticStatus")

    pause = threading.Event()
    for step in range(95):
        battery = 50.0 if step < 10 or step >= 85 else 15.0 if step < 32 else 5.0
        ros.publish("/battery_level", FLOAT32, {"data": battery})
        if step < 45:
            ros.publish("/temperature", FLOAT32, {"data": 85.0 if step > 5 else 60.0})
        pause.wait(0.1)
    ros.wait_until(lambda: len(heard) >= 5)
    recorder.send_signal(signal.SIGINT)
    assert recorder.wait(20) == 0
    # After a SIGINT, `rosbag record` waits at most 0.25 s for its recorder, which names the bag when it is complete.
    bag = tmp_path / "run.bag"
    ros.wait_until(bag.exists)

    with Recordings([str(bag)]) as recordings:
        (channel,) = [channel for channel in recordings.channels if channel.topic == "/alerts"]
        read = type_of(channel).field_getter("")
        announced = [(time_ns / 1e9, read(data)) for time_ns, _, data in recordings.messages({channel: None})]
        live = [(at_s, message["name"].partition(": ")[2], message["level"]) for at_s, message in announced]
        replayed: list[Any] = []
        player = Player(recordings)

        def note(event: Any) -> None:
            if isinstance(event, Transition):
                replayed.append((player.wall_s, event.signal, int(event.to_level)))

        AlertSystem(player.node("alert_system", PARAMETERS), {"test": note}, log_alerts=False)
        player.play()
        assert player.problems == []

    assert [alert[1:] for alert in replayed] == [alert[1:] for alert in live]
    assert {alert[1:] for alert in live} >= {
        ("battery_level", 1), ("battery_level", 2), ("battery_level", 0), ("temperature", 1), ("temperature", 3)
    }  # fmt: skip
    # A silence is noticed by a tick: those of the replay are at other times than the live ones.
    assert all(abs(found[0] - expected[0]) <= TICK_S + LATENCY_S for found, expected in zip(replayed, live))
