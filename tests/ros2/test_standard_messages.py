"""The definitions that are used without ROS have the fields of ROS 2."""

from __future__ import annotations

import importlib

import pytest

from robot_health_monitor.core.messages.standard_messages import MESSAGES, ROS2_FIELDS

PACKAGES = ("std_msgs", "sensor_msgs", "diagnostic_msgs")


def installed() -> list:
    found = []
    for package in PACKAGES:
        module = pytest.importorskip(f"{package}.msg")
        found += [f"{package}/{name}" for name in vars(module) if name[0].isupper()]
    return found


def test_every_message_is_known_with_all_of_its_fields() -> None:
    types = installed()
    assert "std_msgs/Float32" in types
    for type_name in types:
        package, _, name = type_name.partition("/")
        native = getattr(importlib.import_module(f"{package}.msg"), name)
        lines = (MESSAGES[type_name] + ROS2_FIELDS.get(type_name, "")).splitlines()
        known = {line.split()[1] for line in lines if "=" not in line}
        fields = set(native.get_fields_and_field_types()) - {"structure_needs_at_least_one_member"}
        assert fields <= known, type_name
