"""Definitions of installed types, as recordings have them."""

from __future__ import annotations

from typing import Any

import pytest


def test_the_definition_of_a_bounded_string_can_be_parsed() -> None:
    pytest.importorskip("type_description_interfaces.msg")
    from robot_health_monitor.core.messages.definitions import Field, parse_msg
    from robot_health_monitor.ros2.messages import raw_format

    name = "type_description_interfaces/IndividualTypeDescription"
    text = raw_format(name).schema
    assert "string<=255 type_name\n" in text
    assert parse_msg(name, text)[name].fields[0] == Field("type_name", "string", None)


def test_constants_and_comments_are_those_of_the_installed_file() -> None:
    from robot_health_monitor.ros2.messages import raw_format

    battery = raw_format("sensor_msgs/BatteryState")
    assert battery[:3] == ("cdr", "sensor_msgs/msg/BatteryState", "ros2msg")
    assert battery.profile == "ros2"
    assert "uint8 POWER_SUPPLY_STATUS_CHARGING = 1\n" in battery.schema
    assert "# Constants are chosen to match the enums" in battery.schema
    heads = [line for line in battery.schema.splitlines() if line.startswith("MSG: ")]
    assert heads == ["MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]


@pytest.mark.parametrize("name", ["std_msgs/Empty", "std_msgs/Float32", "diagnostic_msgs/DiagnosticArray"])
def test_what_is_installed_without_its_file_is_described_by_its_class(name: str, monkeypatch: Any) -> None:
    from robot_health_monitor.core.messages.definitions import parse_definition
    from robot_health_monitor.ros2 import messages

    from_file = parse_definition(name, messages.raw_format(name).schema, "msg")
    monkeypatch.setattr(messages, "_installed_text", lambda native_class: "")
    messages._format_of.cache_clear()
    generated = parse_definition(name, messages.raw_format(name).schema, "msg")
    messages._format_of.cache_clear()
    if name != "std_msgs/Empty":
        assert {kind: found.fields for kind, found in generated.items()} == {
            kind: found.fields for kind, found in from_file.items()
        }
    assert "structure_needs_at_least_one_member" not in str(from_file)
