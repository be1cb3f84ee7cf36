"""JSON of mappings, its schemas, and the formats of ROS."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from robot_health_monitor.core.messages.raw_messages import (
    json_bytes,
    json_format,
    ros1_format,
    ros2_format,
)
from robot_health_monitor.core.messages.standard_messages import definition
from robot_health_monitor.core.values.errors import MessageError


def test_the_formats_of_ros_are_named_as_mcap_names_them() -> None:
    assert ros1_format("std_msgs/Float32", "float32 data\n") == (
        "ros1", "std_msgs/Float32", "ros1msg", "float32 data\n",
    )  # fmt: skip
    assert ros2_format("std_msgs/Float32", "float32 data\n") == (
        "cdr", "std_msgs/msg/Float32", "ros2msg", "float32 data\n",
    )  # fmt: skip
    assert ros1_format("a/B", "").profile == "ros1" and ros2_format("a/B", "").profile == "ros2"
    assert json_format("a/B", "").profile == ""


def schema_of(type_name: str, text: str) -> Any:
    return json.loads(json_format(type_name, text).schema)


def test_a_schema_describes_every_field() -> None:
    text = "time stamp\nfloat32 value\nbool ok\nint64[3] counts\nuint8[] data\nstring[] names\npkg/Inner inner\n"
    assert schema_of("pkg/Outer", text + "=" * 80 + "\nMSG: pkg/Inner\nfloat64[] x\n") == {
        "title": "pkg/Outer",
        "type": "object",
        "properties": {
            "stamp": {"type": "object", "properties": {"secs": {"type": "integer"}, "nsecs": {"type": "integer"}}},
            "value": {"type": "number"},
            "ok": {"type": "boolean"},
            "counts": {"type": "array", "items": {"type": "integer"}},
            "data": {"type": "string", "contentEncoding": "base64"},
            "names": {"type": "array", "items": {"type": "string"}},
            "inner": {
                "type": "object",
                "properties": {"x": {"type": "array", "items": {"type": "number"}}},
            },
        },
    }


@pytest.mark.parametrize("text", ["", "<html>", "[" * 1000])
def test_without_a_usable_definition_any_object_is_allowed(text: str) -> None:
    assert schema_of("pkg/Type", text) == {"title": "pkg/Type", "type": "object", "properties": {}}


def test_a_type_that_contains_itself_has_a_schema_of_bounded_size() -> None:
    for text in ("pkg/A a\npkg/A b\n", "\n".join(f"pkg/A a{number}" for number in range(50))):
        assert len(json_format("pkg/A", text).schema) < 500_000


def test_json_has_null_for_numbers_that_it_does_not_know() -> None:
    assert json_bytes({"a": math.nan, "b": [math.inf, 1.5], "c": {"d": -math.inf}}) == (
        b'{"a":null,"b":[null,1.5],"c":{"d":null}}'
    )


def test_bytes_become_base64_and_other_objects_are_refused() -> None:
    assert json_bytes({"data": b"\x00\xff", "text": "\u00e4"}) == b'{"data":"AP8=","text":"\\u00e4"}'
    with pytest.raises(MessageError, match="set cannot be encoded as JSON"):
        json_bytes({"data": {1, 2}})


def test_standard_types_have_their_schema() -> None:
    found = schema_of("diagnostic_msgs/DiagnosticArray", definition("diagnostic_msgs/DiagnosticArray"))
    status = found["properties"]["status"]["items"]["properties"]
    assert list(status) == ["level", "name", "message", "hardware_id", "values"]
    assert status["level"] == {"type": "integer"}
