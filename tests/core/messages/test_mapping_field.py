"""Fields of messages that are mappings, as JSON brings them; tests/core/port/test_mapping_node.py: subscriptions."""

from __future__ import annotations

import math
from typing import Any

import pytest

from robot_health_monitor.core.messages.mapping_field import MISSING, MappingField
from robot_health_monitor.core.values.errors import ConfigError


class JsonField(MappingField):
    null_is_nan = True


@pytest.mark.parametrize(
    ("type_name", "field", "message", "expected"),
    [
        ("std_msgs/Float32", "data", {"data": 1.5}, 1.5),
        ("std_msgs/Float32", "data", {"data": True}, "true"),
        ("std_msgs/Bool", "data", {"data": True}, True),
        ("", "data", {"data": True}, True),
        ("std_msgs/Float32", None, {}, 1.0),
        ("std_msgs/Float32", "", {"data": 2.0}, {"data": 2.0}),
        ("sensor_msgs/BatteryState", "cell_voltage[1]", {"cell_voltage": [3.0, None]}, None),
    ],
)
def test_a_field_is_read_as_elsewhere(type_name: str, field: str, message: Any, expected: object) -> None:
    assert JsonField("/a", type_name, field).read(message) == expected


def test_null_is_not_a_number_where_json_has_no_other_word_for_it() -> None:
    assert math.isnan(JsonField("/a", "std_msgs/Float32", "data").read({"data": None}))
    assert MappingField("/a", "std_msgs/Float32", "data").read({"data": None}) is None


def test_a_message_without_the_field_raises() -> None:
    with pytest.raises(MISSING):
        MappingField("/a", "std_msgs/Float32", "data").read({})


def test_a_field_that_the_type_does_not_have_is_refused() -> None:
    with pytest.raises(ConfigError, match="std_msgs/Float32"):
        MappingField("/a", "std_msgs/Float32", "date")


@pytest.mark.parametrize("field", ["data[", "data where level >=", " where "])
def test_a_field_that_is_no_path_or_condition_is_refused_with_the_topic(field: str) -> None:
    with pytest.raises(ConfigError, match=r"^/a: field '"):
        MappingField("/a", "", field)
