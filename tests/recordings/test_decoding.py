"""Values of fields and whole messages: compared with what rosbags deserializes, for every standard message."""

from __future__ import annotations

import random
from typing import Any, Iterator

import numpy as np
import pytest
from harness.recorded import ROS1, ROS2, definition, fields_of, random_message, serialized

from robot_health_monitor.core.messages.definitions import parse_definition
from robot_health_monitor.core.messages.raw_messages import RawFormat
from robot_health_monitor.core.messages.serialized import Deserializer
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.recordings.decoding import type_of
from robot_health_monitor.recordings.recording import Channel

TYPES = [
    "std_msgs/Float32",
    "std_msgs/Bool",
    "std_msgs/Int64",
    "std_msgs/String",
    "std_msgs/Header",
    "sensor_msgs/BatteryState",
    "sensor_msgs/CameraInfo",
    "sensor_msgs/FluidPressure",
    "sensor_msgs/Imu",
    "sensor_msgs/JointState",
    "sensor_msgs/LaserScan",
    "sensor_msgs/MagneticField",
    "sensor_msgs/NavSatFix",
    "sensor_msgs/Range",
    "sensor_msgs/Temperature",
    "diagnostic_msgs/DiagnosticStatus",
    "geometry_msgs/PoseWithCovarianceStamped",
    "nav_msgs/Odometry",
]
BASE, NAME = 1, 2


def channel(encoding: str, type_name: str, text: str = "", form: str = "msg") -> Channel:
    return Channel("/topic", RawFormat(encoding, type_name, f"ros2{form}" if text else "", text))


def numbers_in(message: Any, store: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the path and the value of every number and string that is not in an array."""
    for field, (kind, _) in fields_of(store, message.__msgtype__):
        value = getattr(message, field)
        if kind == NAME:
            yield from numbers_in(value, store, f"{prefix}{field}.")
        elif kind == BASE:
            yield prefix + field, value


@pytest.mark.parametrize("type_name", TYPES)
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_every_number_is_the_one_that_was_serialized(encoding: str, type_name: str) -> None:
    store = ROS1 if encoding == "ros1" else ROS2
    name = type_name.replace("/", "/msg/")
    types = type_of(channel(encoding, type_name, definition(store, name)))
    chance = random.Random(1)
    for _ in range(20):
        message = random_message(chance, store, name)
        data = serialized(message, encoding)
        for path, value in numbers_in(message, store):
            assert types.field_getter(path)(data) == value, path


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_the_stamp_of_an_image_is_read_without_the_image(encoding: str) -> None:
    store = ROS1 if encoding == "ros1" else ROS2
    get = type_of(channel(encoding, "sensor_msgs/Image")).field_getter("header.stamp")
    message = random_message(random.Random(3), store, "sensor_msgs/msg/Image")
    message.header.stamp.sec, message.header.stamp.nanosec = 1_700_000_000, 250_000_000
    message.header.frame_id = "map"
    # The bytes end behind the header: nothing else is read.
    assert get(bytes(serialized(message, encoding))[:20]) == 1_700_000_000.25


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_a_recording_without_definitions_has_the_standard_types(encoding: str) -> None:
    store = ROS1 if encoding == "ros1" else ROS2
    data = serialized(random_message(random.Random(2), store, "sensor_msgs/msg/Temperature"), encoding)
    assert type_of(channel(encoding, "sensor_msgs/Temperature")).field_getter("temperature")(data) != 0.0


@pytest.mark.parametrize(
    ("text", "form", "field", "problem"),
    [
        ("", "", "y", "no definition of it"),
        (f"float32 x\n{'=' * 80}\nMSG: a\0b/T\nint8 x\n", "msg", "y", "has no field y"),
        ("float32", "msg", "y", "cannot use the definition of my_robot/Odd"),
        ("Cell cell", "msg", "cell", "cannot use the definition of my_robot/Odd"),
        ("module x {", "idl", "y", "cannot use the definition of my_robot/Odd"),
    ],
)
def test_a_definition_that_is_missing_or_wrong_is_one_line(text: str, form: str, field: str, problem: str) -> None:
    with pytest.raises(ConfigError) as raised:
        type_of(channel("cdr", "my_robot/Odd", text, form)).field_getter(field)
    assert problem in str(raised.value)
    assert "\n" not in str(raised.value)


def same(found: Any, expected: Any, store: Any) -> bool:
    """Returns whether a message has the values of one of rosbags."""
    if hasattr(expected, "__msgtype__"):
        names = [name for name, _ in fields_of(store, expected.__msgtype__)]
        names = [name for name in names if name != "structure_needs_at_least_one_member"]
        spelt = {name: name if name in found else {"sec": "secs", "nanosec": "nsecs"}[name] for name in names}
        return all(same(found[spelt[name]], getattr(expected, name), store) for name in names)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(same(*pair, store) for pair in zip(found, expected))
    if isinstance(expected, np.ndarray):
        return bool(np.array_equal(np.asarray(found).view(expected.dtype), expected))
    return bool(found == expected)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_every_standard_message_is_read_as_it_was_serialized(encoding: str) -> None:
    store = ROS1 if encoding == "ros1" else ROS2
    chance = random.Random(3)
    names = sorted(getattr(store, "fielddefs", None) or store.FIELDDEFS)
    for name in names:
        own = name.replace("/msg/", "/")
        types = parse_definition(own, definition(store, name), "msg", is_ros1=encoding == "ros1")
        get = Deserializer(types, encoding == "cdr").bind(own)
        for _ in range(3):
            message = random_message(chance, store, name)
            assert same(get(serialized(message, encoding)), message, store), name
