"""Conversions of ROS 1 messages that the conformance suite does not reach. Values are what the .msg files allow."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rospy")

from robot_health_monitor.cli.commands.check_command import check_field, known_definitions
from robot_health_monitor.core.messages.serialized import SerializedType
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.core.values.field_path import ABSENT
from robot_health_monitor.ros1 import messages
from robot_health_monitor.ros1.messages import message_class, raw_format, service_class, to_mapping, to_native


@pytest.mark.parametrize(
    ("type_name", "mapping"),
    [
        ("std_msgs/Int8", {"data": -128}),
        ("std_msgs/UInt8", {"data": 255}),
        ("std_msgs/Byte", {"data": -1}),
        ("std_msgs/Char", {"data": 200}),
        ("std_msgs/UInt64", {"data": 2**64 - 1}),
        ("std_msgs/Float64", {"data": -0.1}),
        ("std_msgs/String", {"data": "21 \N{DEGREE SIGN}C"}),
        ("std_msgs/Time", {"data": {"secs": 4294967295, "nsecs": 999999999}}),
        ("std_msgs/Duration", {"data": {"secs": -1, "nsecs": 500000000}}),
        ("std_msgs/UInt8MultiArray", {"layout": {"dim": [], "data_offset": 0}, "data": "AP8="}),
        ("std_msgs/Int8MultiArray", {"layout": {"dim": [], "data_offset": 0}, "data": [-128, 127]}),
        ("std_msgs/Empty", {}),
    ],
)
def test_what_is_written_can_be_sent_and_reads_the_same(type_name: str, mapping: dict[str, Any]) -> None:
    from io import BytesIO

    cls = message_class(type_name)
    wire = BytesIO()
    to_native(cls, mapping).serialize(wire)
    assert to_mapping(cls().deserialize(wire.getvalue())) == mapping


@pytest.mark.parametrize(
    ("type_name", "mapping", "reason"),
    [
        ("std_msgs/Int8", {"data": 128}, "Int8.data: expected a whole number from -128 to 127, got 128"),
        ("std_msgs/UInt8", {"data": -1}, "UInt8.data: expected a whole number from 0 to 255, got -1"),
        ("std_msgs/Int8", {"data": 1.0}, "Int8.data: expected a whole number from -128 to 127, got 1.0"),
        ("std_msgs/Int8", {"data": True}, "Int8.data: expected a whole number from -128 to 127, got true"),
        ("std_msgs/Bool", {"data": 1}, "Bool.data: expected true or false, got 1"),
        ("std_msgs/String", {"data": 1}, "String.data: expected text, got 1"),
        ("std_msgs/Time", {"data": {"seconds": 1}}, "Time.data: .*no field seconds; available: secs, nsecs"),
        ("std_msgs/Time", {"data": 1}, "Time.data: expected a mapping of fields to values, got 1"),
        ("std_msgs/UInt8MultiArray", {"data": "no base64!"}, "UInt8MultiArray.data: expected base64 text"),
        ("std_msgs/Float32MultiArray", {"data": 1.0}, "Float32MultiArray.data: expected a list, got 1.0"),
        ("sensor_msgs/Imu", {"orientation_covariance": [0.0]}, "expected 9 elements, got 1"),
        ("sensor_msgs/Imu", {"orientation": {"q": 0.0}}, "Imu.orientation: Quaternion has no field q; available: x, y"),
    ],
)
def test_wrong_values_are_refused_with_the_field(type_name: str, mapping: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        to_native(message_class(type_name), mapping)


@pytest.mark.parametrize("number", [1e39, 10**400], ids=["float", "int"])
def test_a_number_too_large_for_32_bits_becomes_infinity(number: Any) -> None:
    cls = message_class("std_msgs/Float32")
    assert to_native(cls, {"data": number}).data == math.inf
    assert to_native(cls, {"data": -number}).data == -math.inf


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
    import io

    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    statuses = [
        DiagnosticStatus(level, f"driver {level}: größe", "x" * level, "hw", [KeyValue("k" * level, "v")] * level)
        for level in range(-1, 9)
    ]
    statuses.append(DiagnosticStatus(2, "renamed: level", "low", "hw", [KeyValue("fingerprint", "00aa")]))
    buffer = io.BytesIO()
    DiagnosticArray(status=statuses).serialize(buffer)
    for field, number in (('status["*"]', 10), ('status["driver ?: *"]', 9), ('status["none*"]', None)):
        found = SerializedType("/d", raw_format("diagnostic_msgs/DiagnosticArray")).field_getter(field)(
            buffer.getvalue()
        )
        assert (None if found is ABSENT else len(found)) == number
        read = [(status.name, (status.level, status.message)) for status in statuses[:10]]
        assert number is None or found == read[-number:]


def test_numbers_are_read_from_serialized_messages() -> None:
    import io

    from sensor_msgs.msg import BatteryState, LaserScan
    from std_msgs.msg import Float32, Header

    for message, field, value in (
        (Float32(data=19.5), "data", 19.5),
        (BatteryState(header=Header(frame_id="base"), percentage=0.5, cell_voltage=[3.5]), "percentage", 0.5),
        (LaserScan(header=Header(frame_id="laser"), range_max=8.0, ranges=[1.0] * 9), "range_max", 8.0),
        (Header(seq=7), "seq", 7),
        (BatteryState(cell_voltage=[3.5, 3.25]), "cell_voltage[1]", 3.25),
        (BatteryState(cell_voltage=[3.5], location="left"), "location", "left"),
    ):
        buffer = io.BytesIO()
        message.serialize(buffer)
        get = SerializedType("/in", raw_format(message._type)).field_getter(field)
        assert get(buffer.getvalue()) == value


def test_check_reads_fields_in_the_types_that_are_installed_here(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_VERSION", "1")
    definitions = known_definitions()
    assert definitions[0] is messages
    assert check_field(definitions, "/in", "diagnostic_msgs/KeyValue", "key")
    with pytest.raises(ConfigError, match="has no field keys") as raised:
        check_field(definitions, "/in", "diagnostic_msgs/KeyValue", "keys")
    assert raised.value.path == ("field",)
