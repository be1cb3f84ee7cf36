"""The definitions that are used without ROS are those of ROS 1."""

from __future__ import annotations

import pytest
import roslib.message

from robot_health_monitor.core.messages.serialized import SerializedType
from robot_health_monitor.core.messages.standard_messages import MESSAGES, SERVICES, field_getter
from robot_health_monitor.ros1 import messages as ros1_messages


def fields_of(definition: str) -> list:
    return [tuple(line.split()) for line in definition.splitlines() if "=" not in line]


@pytest.mark.parametrize("type_name", MESSAGES)
def test_a_message_has_the_fields_of_the_installed_one(type_name: str) -> None:
    native = roslib.message.get_message_class(type_name)
    assert fields_of(MESSAGES[type_name]) == list(zip(native._slot_types, native.__slots__))


@pytest.mark.parametrize("type_name", MESSAGES)
def test_a_message_has_the_constants_of_the_installed_one(type_name: str) -> None:
    native = roslib.message.get_message_class(type_name)
    for line in MESSAGES[type_name].splitlines():
        if "=" in line:
            name, _, value = line.partition(" ")[2].partition("=")
            assert str(getattr(native, name)) == value, line


@pytest.mark.parametrize("type_name", SERVICES)
def test_a_service_has_the_fields_of_the_installed_one(type_name: str) -> None:
    native = roslib.message.get_service_class(type_name)
    for definition, part in zip(SERVICES[type_name], (native._request_class, native._response_class)):
        assert fields_of(definition) == list(zip(part._slot_types, part.__slots__))


@pytest.mark.parametrize("package", ["std_msgs", "sensor_msgs", "diagnostic_msgs"])
def test_every_message_of_the_package_is_known(package: str) -> None:
    module = __import__(f"{package}.msg").msg
    installed = {name for name in vars(module) if name[0].isupper()}
    assert installed == {name.partition("/")[2] for name in MESSAGES if name.startswith(f"{package}/")}


@pytest.mark.parametrize(
    ("type_name", "field"),
    [
        ("std_msgs/Float32", "data"),
        ("sensor_msgs/BatteryState", "cell_voltage[2]"),
        ("sensor_msgs/Imu", "orientation_covariance[8]"),
        ("sensor_msgs/Imu", "header.stamp.sec"),
        ("diagnostic_msgs/DiagnosticArray", 'status["a"].values["b"]'),
    ],
)
def test_a_field_that_ros_1_binds_is_bound_without_ros_too(type_name: str, field: str) -> None:
    assert SerializedType("/topic", ros1_messages.raw_format(type_name)).field_getter(field)
    assert field_getter("/topic", type_name, field)
