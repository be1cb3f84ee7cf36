from __future__ import annotations

import math
import struct
from typing import Any

import pytest

from robot_health_monitor.core.messages.definitions import SEQUENCE, Field
from robot_health_monitor.core.values.errors import MessageError
from robot_health_monitor.rosbridge.protocol.definitions import parse, serializer, service_definition

STATUS: dict[str, Any] = {
    "level": 2,
    "name": "alert_system: link",
    "message": "down",
    "hardware_id": "husky",
    "values": [{"key": "unit", "value": "\N{DEGREE SIGN}C"}],
}


def text(value: str) -> bytes:
    """ROS 1 writes a string as the number of its bytes in 32 bits, little-endian, and the bytes."""
    data = value.encode()
    return struct.pack("<I", len(data)) + data


STATUS_BYTES = b"\x02" + text("alert_system: link") + text("down") + text("husky")
STATUS_BYTES += b"\1\0\0\0" + text("unit") + b"\3\0\0\0\xc2\xb0C"


@pytest.mark.parametrize(
    ("type_name", "message", "data"),
    [
        ("std_msgs/Float32", {"data": 19.5}, b"\0\0\x9c\x41"),
        ("std_msgs/msg/Float32", {"data": math.nan}, struct.pack("<f", math.nan)),
        ("std_msgs/Bool", {"data": True}, b"\1"),
        ("std_msgs/String", {"data": "20 %"}, b"\4\0\0\x0020 %"),
        ("rosgraph_msgs/Clock", {"clock": {"secs": 1, "nsecs": 2}}, b"\1\0\0\0\2\0\0\0"),
        ("diagnostic_msgs/DiagnosticStatus", STATUS, STATUS_BYTES),
        (
            "diagnostic_msgs/DiagnosticArray",
            {"header": {"seq": 0, "stamp": {"secs": 1, "nsecs": 2}, "frame_id": "base"}, "status": [STATUS, STATUS]},
            bytes(4) + b"\1\0\0\0\2\0\0\0" + text("base") + b"\2\0\0\0" + STATUS_BYTES * 2,
        ),
    ],
)
def test_messages_are_written_as_ros_1_writes_them(type_name: str, message: dict[str, Any], data: bytes) -> None:
    serialize = serializer(type_name)
    assert serialize is not None
    assert serialize(message) == data


@pytest.mark.parametrize("message", [{"data": "full"}, {"data": 10**400}, {"data": []}, {}, {"data": None}, None])
def test_a_message_that_does_not_fit_is_an_error(message: Any) -> None:
    serialize = serializer("std_msgs/Float32")
    assert serialize is not None
    with pytest.raises(MessageError, match="message does not match std_msgs/Float32"):
        serialize(message)


def test_what_is_not_known_cannot_be_written() -> None:
    assert serializer("nav_msgs/Odometry") is None
    assert serializer("") is None


def test_a_definition_is_read_as_gendeps_prints_it() -> None:
    definition = (
        "# a comment\nuint8 LEVEL=3  # a constant\nstring NAME=a # b\nHeader header\nfloat64[9] covariance\n"
        "Inner[] parts\nuint8[<=5] few\nother_msgs/Thing thing\n"
        + "=" * 80
        + "\nMSG: std_msgs/Header\nuint32 seq\n"
        + "=" * 80
        + "\nMSG: some_msgs/Inner\nint8 x\n"
    )
    found = parse("some_msgs/Outer", definition)
    assert list(found) == ["some_msgs/Outer", "std_msgs/Header", "some_msgs/Inner"]
    assert list(found["some_msgs/Outer"].fields) == [
        Field("header", "std_msgs/Header", None),
        Field("covariance", "float64", 9),
        Field("parts", "some_msgs/Inner", SEQUENCE),
        Field("few", "uint8", SEQUENCE),
        Field("thing", "other_msgs/Thing", None),
    ]
    # A comment belongs to the value of a string constant (wiki.ros.org/msg), and to no other.
    assert list(found["some_msgs/Outer"].constants) == [("LEVEL", "3"), ("NAME", "a # b")]


def test_a_definition_that_cannot_be_parsed_is_none() -> None:
    assert parse("x/Root", "float32 data\n?\n") == {}


def test_services_of_std_srvs_are_known() -> None:
    (request,) = service_definition("std_srvs/SetBool", response=False).values()
    (response,) = service_definition("std_srvs/srv/Trigger", response=True).values()
    assert [field.name for field in request.fields] == ["data"]
    assert [field.name for field in response.fields] == ["success", "message"]
    assert service_definition("some_srvs/Unknown", response=False) == {}


def test_arrays_have_their_length_unless_it_is_fixed_and_bytes_are_base64_text() -> None:
    serialize = serializer("std_msgs/UInt8MultiArray")
    assert serialize is not None
    layout = {"dim": [{"label": "", "size": 3, "stride": 1}], "data_offset": 5}
    data = b"\1\0\0\0" + bytes(4) + b"\3\0\0\0\1\0\0\0\5\0\0\0" + b"\3\0\0\0\x00\xff\x01"
    assert serialize({"layout": layout, "data": "AP8B"}) == data
    with pytest.raises(MessageError, match="does not match"):
        serialize({"layout": layout, "data": "no base64!"})
    serialize = serializer("sensor_msgs/MagneticField")
    assert serialize is not None
    header = {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""}
    field = {"x": 1.0, "y": 2.0, "z": 3.0}
    covariance = [float(number) for number in range(9)]
    message = {"header": header, "magnetic_field": field, "magnetic_field_covariance": covariance}
    assert serialize(message) == bytes(16) + struct.pack("<12d", 1.0, 2.0, 3.0, *covariance)
