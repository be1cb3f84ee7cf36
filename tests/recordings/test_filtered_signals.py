"""Frames and errors in the log, replayed from recordings of both kinds of ROS that rosbags wrote."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Callable

import pytest
from harness.recorded import ROS1, ROS2, Recorded, write_bag, write_folder, write_mcap
from rosbags.typesys import get_types_from_msg

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.values.model import Transition
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

if "tf2_msgs/msg/TFMessage" not in ROS1.types:
    ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))

SIGNALS = {
    "frames": {"topic": "/tf", "field": 'transforms["*"].header.stamp', "warn_above": 1.0, "stale_after_s": 2.0},
    "base_link": {"topic": "/tf", "field": 'transforms["base_link"].header.stamp', "unit": "s", "stale_after_s": 0.0},
    "mounts": {"topic": "/tf_static", "field": 'transforms["*"].transform.translation.z', "warn_below": 0.0,
               "stale_after_s": 0.0},
    "errors": {"topic": "/rosout", "where": 'level >= ERROR and name == "*planner"', "field": "",
               "statistic": "count", "window_s": 4.0, "warn_above": 2.0},
}  # fmt: skip


def header(store: Any, stamp_s: float) -> Any:
    seconds = 1_700_000_000 + int(stamp_s)
    stamp = store.types["builtin_interfaces/msg/Time"](seconds, round(stamp_s % 1.0 * 1e9))
    extra = (0,) if store is ROS1 else ()
    return store.types["std_msgs/msg/Header"](*extra, stamp, "odom")


def tree(store: Any, *frames: Any, z: float = 0.5) -> Any:
    types = store.types
    vector, rotation = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    stamped, transform = types["geometry_msgs/msg/TransformStamped"], types["geometry_msgs/msg/Transform"]
    placed = transform(vector(0.0, 0.0, z), rotation(0.0, 0.0, 0.0, 1.0))
    return types["tf2_msgs/msg/TFMessage"]([stamped(header(store, stamp_s), name, placed) for name, stamp_s in frames])


def log(store: Any, level: int, name: str) -> Any:
    if store is ROS1:
        return store.types["rosgraph_msgs/msg/Log"](header(store, 0.0), level, name, "failed", "", "", 0, [])
    stamp = store.types["builtin_interfaces/msg/Time"](0, 0)
    return store.types["rcl_interfaces/msg/Log"](stamp, level, name, "failed", "", "", 0)


def messages(store: Any) -> list[Recorded]:
    error, info = (8, 2) if store is ROS1 else (40, 20)
    recorded = [Recorded(0.0, "/tf_static", tree(store, ("lidar", 0.0), ("camera", 0.0), z=-0.25))]
    for second in range(8):
        # The camera stops after 3 s; the stamps of the wheel stand still from 5 s on.
        frames = [("base_link", float(second)), ("wheel", min(float(second), 5.0))]
        frames += [("camera", float(second))] if second < 4 else []
        recorded.append(Recorded(second + 0.25, "/tf", tree(store, *frames)))
        recorded.append(Recorded(second + 0.5, "/rosout", log(store, error if second < 3 else info, "/planner")))
        recorded.append(Recorded(second + 0.75, "/rosout", log(store, error, "/controller")))
    return recorded


@pytest.mark.parametrize(
    "write",
    [
        lambda path: write_bag(path.with_suffix(".bag"), messages(ROS1)),
        lambda path: write_mcap(path.with_suffix(".mcap"), messages(ROS1), encoding="ros1"),
        lambda path: write_mcap(path.with_suffix(".mcap"), messages(ROS2)),
        lambda path: write_folder(path, messages(ROS2)),
    ],
    ids=["bag", "ros1 mcap", "mcap", "sqlite"],
)
def test_frames_and_the_log_give_the_same_alerts_from_every_recording(
    write: Callable[[Path], str], tmp_path: Path
) -> None:
    player = Player(Recordings([write(tmp_path / "run")]))
    said: list[str] = []
    system = AlertSystem(
        player.node("alert_system", {"signals": SIGNALS}),
        {"test": lambda event: said.append(event.text) if isinstance(event, Transition) else None},
    )
    player.play()
    assert said == [
        "mounts[lidar] WARN: -0.25 is below 0 (was unknown for 0 s)",
        "mounts[camera] WARN: -0.25 is below 0 (was unknown for 0 s)",
        "errors WARN: 3 in 4 s is above 2 (was OK for 2.5 s)",
        "errors OK: 2 in 4 s is no longer above 2 (was WARN for 2.5 s)",
        "frames[camera] STALE: no sample for 2.75 s (limit 2 s) (was OK for 5.75 s)",
        "frames[wheel] WARN: 1.25 s is above 1 s (was OK for 6 s)",
    ]
    assert system.monitor.fresh_value("base_link") == pytest.approx(0.25, abs=1e-6)
