"""Conversions of ROS 2 messages that the conformance suite does not reach. Values are what the .msg files allow."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from robot_health_monitor.cli.commands.check_command import check_field, known_definitions
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.field_path import ABSENT
from robot_health_monitor.ros2 import messages
from robot_health_monitor.ros2.messages import (
    field_getter,
    message_class,
    service_class,
    to_mapping,
    to_native,
    type_name,
)


@pytest.mark.parametrize(
    ("type_name", "mapping"),
    [
        ("std_msgs/Int8", {"data": -128}),
        ("std_msgs/UInt8", {"data": 255}),
        ("std_msgs/Byte", {"data": 255}),
        ("std_msgs/Char", {"data": 200}),
        ("std_msgs/UInt64", {"data": 2**64 - 1}),
        ("std_msgs/Float64", {"data": -0.1}),
        ("std_msgs/String", {"data": "21 \N{DEGREE SIGN}C"}),
        ("std_msgs/UInt8MultiArray", {"layout": {"dim": [], "data_offset": 0}, "data": "AP8="}),
        ("std_msgs/ByteMultiArray", {"layout": {"dim": [], "data_offset": 0}, "data": "AP8="}),
        ("std_msgs/Int8MultiArray", {"layout": {"dim": [], "data_offset": 0}, "data": [-128, 127]}),
        ("std_msgs/Empty", {}),
    ],
)
def test_what_is_written_can_be_sent_and_reads_the_same(type_name: str, mapping: dict[str, Any]) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    cls = message_class(type_name)
    wire = serialize_message(to_native(cls, mapping))
    read = to_mapping(deserialize_message(wire, cls))
    read.pop("structure_needs_at_least_one_member", None)
    assert read == mapping


@pytest.mark.parametrize(
    ("type_name", "mapping", "reason"),
    [
        ("std_msgs/Int8", {"data": 128}, "Int8.data: expected a whole number from -128 to 127, got 128"),
        ("std_msgs/UInt8", {"data": -1}, "UInt8.data: expected a whole number from 0 to 255, got -1"),
        ("std_msgs/Byte", {"data": 256}, "Byte.data: expected a whole number from 0 to 255, got 256"),
        ("std_msgs/Int8", {"data": 1.0}, "Int8.data: expected a whole number from -128 to 127, got 1.0"),
        ("std_msgs/Int8", {"data": True}, "Int8.data: expected a whole number from -128 to 127, got true"),
        ("std_msgs/Bool", {"data": 1}, "Bool.data: expected true or false, got 1"),
        ("std_msgs/String", {"data": 1}, "String.data: expected text, got 1"),
        (
            "std_msgs/Header",
            {"stamp": {"seconds": 1}},
            "Header.stamp: Time has no field seconds; available: sec, nanosec",
        ),
        ("std_msgs/Header", {"stamp": 1}, "Header.stamp: expected a mapping of fields to values, got 1"),
        ("std_msgs/UInt8MultiArray", {"data": "no base64!"}, "UInt8MultiArray.data: expected base64 text"),
        ("std_msgs/Float32MultiArray", {"data": 1.0}, "Float32MultiArray.data: expected a list, got 1.0"),
        ("sensor_msgs/Imu", {"orientation_covariance": [0.0]}, "expected 9 elements, got 1"),
        ("sensor_msgs/Imu", {"orientation": {"q": 0.0}}, "Imu.orientation: Quaternion has no field q; available: x, y"),
        (
            "rcl_interfaces/ParameterDescriptor",
            {"integer_range": [{}, {}]},
            "integer_range: expected at most 1 elements, got 2",
        ),
    ],
)
def test_wrong_values_are_refused_with_the_field(type_name: str, mapping: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        to_native(message_class(type_name), mapping)


def test_numbers_too_large_for_32_bits_become_infinity() -> None:
    cls = message_class("std_msgs/Float32")
    assert to_native(cls, {"data": 1e39}).data == math.inf
    assert to_native(cls, {"data": -(10**400)}).data == -math.inf
    assert to_native(cls, {"data": 3.4028234663852886e38}).data == 3.4028234663852886e38


def test_a_number_in_an_array_of_fixed_size_is_a_number_of_python() -> None:
    from rclpy.serialization import serialize_message

    cls = message_class("sensor_msgs/CameraInfo")
    get = field_getter("/in", "sensor_msgs/CameraInfo", "k[4]")
    assert type(get(serialize_message(to_native(cls, {"k": [float(i) for i in range(9)]})))) is float


def test_stamps_are_read_in_either_spelling() -> None:
    from rclpy.serialization import serialize_message

    message = serialize_message(to_native(message_class("std_msgs/Header"), {"stamp": {"sec": 7, "nanosec": 8}}))
    assert field_getter("/in", "std_msgs/Header", "stamp.secs")(message) == 7
    assert field_getter("/in", "std_msgs/Header", "stamp.nanosec")(message) == 8


@pytest.mark.parametrize("kind", ["msg", "srv", ""])
def test_a_type_name_imports_nothing_but_messages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    """Clients choose type names; importing `<package>.msg` would run the code of any module."""
    trap = tmp_path / "trap"
    for folder in (trap, trap / "msg", trap / "srv"):
        folder.mkdir()
        (folder / "__init__.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w').close()\nclass Zen: pass\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    name = f"trap/{kind}/Zen" if kind else "trap/Zen"
    for find in (message_class, service_class):
        with pytest.raises(ConfigError):
            find(name)
    assert not (tmp_path / "imported").exists()


@pytest.mark.parametrize(
    "type_name", ["this/Zen", "std_msgs/__init__", "std_msgs/_Float32", "os/path", "std_msgs/float32"]
)
def test_a_class_that_is_not_a_message_is_an_unknown_type(type_name: str) -> None:
    with pytest.raises(ConfigError):
        message_class(type_name)


def test_statuses_are_read_from_serialized_messages_as_from_others() -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from rclpy.serialization import serialize_message

    statuses = [
        DiagnosticStatus(
            level=bytes([level]),
            name=f"driver {level}: größe",
            message="x" * level,
            hardware_id="hw",
            values=[KeyValue(key="k" * level, value="v")] * level,
        )
        for level in range(10)
    ]
    own = KeyValue(key="fingerprint", value="00aa")
    statuses.append(DiagnosticStatus(level=b"\2", name="renamed: level", message="low", values=[own]))
    data = serialize_message(DiagnosticArray(status=statuses))
    for field, number in (('status["*"]', 10), ('status["driver ?: *"]', 10), ('status["none*"]', None)):
        found = field_getter("/d", "diagnostic_msgs/DiagnosticArray", field)(data)
        assert (None if found is ABSENT else len(found)) == number
        read = [(status.name, (status.level[0], status.message)) for status in statuses[:10]]
        assert number is None or found == read


def test_a_number_is_read_from_serialized_messages() -> None:
    from geometry_msgs.msg import Vector3
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import BatteryState, Imu, JointState, Temperature
    from std_msgs.msg import Bool, Float32, Header

    for message, field, value in (
        (Float32(data=19.5), "data", 19.5),
        (Bool(data=True), "data", True),
        (Vector3(x=1.0, y=2.0, z=3.0), "z", 3.0),
        (BatteryState(header=Header(frame_id="base"), percentage=0.5), "percentage", 0.5),
        (Temperature(header=Header(frame_id="motor_1"), temperature=40.5, variance=2.0), "variance", 2.0),
        (Imu(angular_velocity=Vector3(x=1.0, y=2.0, z=3.0)), "angular_velocity.y", 2.0),
        (JointState(name=["a", "b"], position=[1.5, 2.5]), 'position["b"]', 2.5),
        (JointState(name=["a", "b"], position=[1.5, 2.5]), "name[0]", "a"),
    ):
        get = field_getter("/in", type_name(type(message)), field)
        assert get(serialize_message(message)) == value


def test_check_reads_fields_in_the_types_that_are_installed_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_VERSION", "2")
    definitions = known_definitions()
    assert definitions[0] is messages
    assert check_field(definitions, "/in", "diagnostic_msgs/KeyValue", "key")
    with pytest.raises(ConfigError, match="has no field keys") as raised:
        check_field(definitions, "/in", "diagnostic_msgs/KeyValue", "keys")
    assert raised.value.path == ("field",)
