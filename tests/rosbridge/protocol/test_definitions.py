from __future__ import annotations

import math
import struct
from typing import Any, Dict

import pytest

from robot_health_monitor.core.messages.definitions import SEQUENCE, Field
from robot_health_monitor.core.values.errors import MessageError
from robot_health_monitor.rosbridge.protocol.definitions import null_reader, parse, serializer, service_definition

STATUS: Dict[str, Any] = {
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
        ("std_msgs/msg/Float32", {}, struct.pack("<f", float("nan"))),
        ("std_msgs/Bool", {"data": True}, b"\1"),
        ("std_msgs/String", {"data": "20 %"}, b"\4\0\0\x0020 %"),
        ("rosgraph_msgs/Clock", {"clock": {"secs": 1, "nsecs": 2}}, b"\1\0\0\0\2\0\0\0"),
        ("diagnostic_msgs/DiagnosticStatus", STATUS, STATUS_BYTES),
        (
            "diagnostic_msgs/DiagnosticArray",
            {"header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "base"}, "status": [STATUS, STATUS]},
            bytes(4) + b"\1\0\0\0\2\0\0\0" + text("base") + b"\2\0\0\0" + STATUS_BYTES * 2,
        ),
    ],
)
def test_messages_are_written_as_ros_1_writes_them(type_name: str, message: Dict[str, Any], data: bytes) -> None:
    serialize = serializer(type_name)
    assert serialize is not None
    assert serialize(message) == data


@pytest.mark.parametrize("message", [{"data": "full"}, {"data": 10**400}, {"data": []}])
def test_a_message_that_does_not_fit_is_an_error(message: Dict[str, Any]) -> None:
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
    assert serializer("x/Root", "float32 data\n?\n") is None
    assert null_reader("x/Root", "float32 data\n?\n")({"data": None}) == {"data": None}


def test_services_of_std_srvs_are_known() -> None:
    (request,) = service_definition("std_srvs/SetBool", response=False).values()
    (response,) = service_definition("std_srvs/srv/Trigger", response=True).values()
    assert [field.name for field in request.fields] == ["data"]
    assert [field.name for field in response.fields] == ["success", "message"]
    assert service_definition("some_srvs/Unknown", response=False) == {}


def test_null_is_read_as_nan_in_float_fields_only() -> None:
    definition = (
        "string name\nfloat64 x\nfloat32[] ranges\nInner inner\nInner[] list\n"
        + "=" * 80
        + "\nMSG: some_msgs/Inner\nfloat32 y\nint32 n\n"
    )
    read = null_reader("some_msgs/Outer", definition)
    inner = {"y": None, "n": None}
    message = {"name": None, "x": None, "ranges": [None, 1.0], "inner": inner, "list": [inner, inner]}
    assert repr(read(message)) == repr(
        {
            "name": None,
            "x": math.nan,
            "ranges": [math.nan, 1.0],
            "inner": {"y": math.nan, "n": None},
            "list": [{"y": math.nan, "n": None}, {"y": math.nan, "n": None}],
        }
    )
    assert message["x"] is None
    assert null_reader("unknown_msgs/Type")({"x": None}) == {"x": None}
    assert math.isnan(null_reader("std_msgs/Float32")({"data": None})["data"])


@pytest.mark.parametrize(
    "definition",
    [
        "Node[] children\n" + "=" * 80 + "\nMSG: x/Node\nNode[] children\n",
        "A a\n" + "=" * 80 + "\nMSG: x/A\nB b\n" + "=" * 80 + "\nMSG: x/B\nA[] a\n",
        "wstring text\n",
        "Missing part\n",
        "float32[99999999999999] data\n",
    ],
)
def test_a_type_that_contains_itself_or_is_unknown_is_not_serialized(definition: str) -> None:
    assert serializer("x/Root", definition) is None


def test_byte_arrays_are_serialized_from_base64_text() -> None:
    serialize = serializer("x/Root", "uint8[] data\nuint8[2] pair\nint32[] numbers\n")
    assert serialize is not None
    assert serialize({"data": "AP8B", "pair": "AgM=", "numbers": []}) == b"\x03\0\0\0\x00\xff\x01\x02\x03" + bytes(4)
    for wrong in ({"data": "no base64!"}, {"numbers": "AP8B"}, {"pair": "AP8B"}):
        with pytest.raises(MessageError, match="expected"):
            serialize(wrong)
