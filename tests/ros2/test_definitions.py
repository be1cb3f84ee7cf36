"""Definitions of installed types, as recordings have them."""

from __future__ import annotations

import pytest


def test_the_definition_of_a_bounded_string_can_be_parsed() -> None:
    pytest.importorskip("type_description_interfaces.msg")
    from robot_health_monitor.core.definitions import Field, parse_msg
    from robot_health_monitor.ros2.definitions import raw_format

    name = "type_description_interfaces/IndividualTypeDescription"
    text = raw_format(name).schema
    assert "string<=255 type_name\n" in text
    assert parse_msg(name, text)[name].fields[0] == Field("type_name", "string", None)
