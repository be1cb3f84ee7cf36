"""Records the bags of docs/recordings.md: two healthy drives, and a night on which a battery and a fan failed."""

from __future__ import annotations

import math
import random
from pathlib import Path

from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS1_NOETIC)
START_S = 1_790_000_000


def record(file: Path, seed: int, hours: float, broken: bool = False) -> None:
    """Writes a drive at 2 Hz: battery_level in % and motor_temperature in degrees Celsius."""
    chance = random.Random(seed)
    with Writer(file) as writer:
        float32 = "std_msgs/msg/Float32"
        topics = [
            writer.add_connection(topic, float32, typestore=STORE) for topic in ("/battery_level", "/motor_temperature")
        ]
        for step in range(int(hours * 7200)):
            time_s = step / 2
            drained = 50.0 * time_s / 3600.0 / hours
            sag = 6.0 if step % 1800 in (0, 1, 2, 3) else 0.0
            battery = 97.0 - drained * (1.7 if broken else 1.0) - sag + chance.gauss(0.0, 0.15)
            hot = 25.0 * max(0.0, time_s / 3600.0 / hours - 0.6) if broken else 0.0
            temperature = 52.0 + 6.0 * math.sin(time_s / 700.0) + hot * 2.5 + chance.gauss(0.0, 0.3)
            for connection, value in zip(topics, (battery, temperature)):
                data = STORE.serialize_ros1(STORE.types[float32](value), float32)
                writer.write(connection, round((START_S + seed * 86400 + time_s) * 1e9), bytes(data))
