"""A replay of what a robot published gives the alerts of the run: every kind of field, and bad input."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable, Mapping

import pytest
from harness.bad_input import BAD_INPUT
from harness.equivalence import Equivalence
from harness.field_timeline import FIELDS, Scene
from harness.local import LocalHarness
from harness.port_conformance import START_S
from harness.recorded import ROS1, ROS2, START_NS, Recorded, message_of, write_bag, write_folder, write_mcap
from harness.silence import SILENCE

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

SHIFT_S = START_NS // 10**9 - round(START_S)
"""From the times of the timeline to those of the recordings."""


def recorded(scene: Scene, store: Any) -> list[Recorded]:
    """Returns the messages of the timeline."""
    return [
        Recorded(each.time_s - START_S, each.topic, message_of(store, native_type(each.type_name), later(each.message)))
        for each in scene.messages
    ]


def native_type(type_name: str) -> str:
    return type_name.replace("/", "/msg/")


def later(message: Mapping[str, Any]) -> Mapping[str, Any]:
    """Returns a message whose stamp is of the time of the recordings."""
    stamp = message.get("header", {}).get("stamp")
    if not stamp or not any(stamp.values()):
        return message
    return {**message, "header": {"stamp": {**stamp, "sec": stamp["sec"] + SHIFT_S}}}


@pytest.mark.parametrize("scene", [FIELDS, BAD_INPUT, SILENCE], ids=["fields", "bad input", "silence"])
@pytest.mark.parametrize(
    "write",
    [
        lambda path, scene: write_bag(path.with_suffix(".bag"), recorded(scene, ROS1)),
        lambda path, scene: write_mcap(path.with_suffix(".mcap"), recorded(scene, ROS1), encoding="ros1"),
        lambda path, scene: write_mcap(path.with_suffix(".mcap"), recorded(scene, ROS2)),
        lambda path, scene: write_folder(path, recorded(scene, ROS2)),
    ],
    ids=["bag", "ros1 mcap", "mcap", "sqlite"],
)
def test_a_replay_gives_the_alerts_of_the_run(
    write: Callable[[Path, Scene], str], scene: Scene, tmp_path: Path
) -> None:
    reference = Equivalence().publish(LocalHarness(), scene).transitions
    player = Player(Recordings([write(tmp_path / "run", scene)]))
    found: list[Transition] = []
    node = player.node("alert_system", {"robot_name": "robot1", "signals": scene.signals})
    AlertSystem(node, {"test": lambda event: found.append(event) if isinstance(event, Transition) else None})
    player.play()
    assert [(f"{each.now_s - SHIFT_S:.3f}", each.text) for each in found] == [
        (f"{each.now_s:.3f}", each.text) for each in reference
    ]
