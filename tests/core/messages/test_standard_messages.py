"""Messages of the standard packages are known without ROS; tests/ros1 and tests/ros2 compare them with ROS's."""

from __future__ import annotations

import base64
import sys
from typing import Any

import pytest

from robot_health_monitor.core.messages.standard_messages import (
    MESSAGES,
    PACKAGES,
    SERVICES,
    check_field,
    check_type,
    complete,
    definition,
    field_getter,
    is_stamped,
)
from robot_health_monitor.core.values.errors import ConfigError, MessageError


def test_definitions_are_one_field_or_constant_per_line() -> None:
    assert MESSAGES["std_msgs/Float32"] == "float32 data\n"
    assert MESSAGES["std_msgs/Empty"] == ""
    assert MESSAGES["diagnostic_msgs/DiagnosticStatus"] == (
        "byte OK=0\nbyte WARN=1\nbyte ERROR=2\nbyte STALE=3\n"
        "byte level\nstring name\nstring message\nstring hardware_id\ndiagnostic_msgs/KeyValue[] values\n"
    )
    assert SERVICES["std_srvs/SetBool"] == ("bool data\n", "bool success\nstring message\n")
    assert SERVICES["std_srvs/Empty"] == ("", "")


def test_every_type_inside_a_message_is_known() -> None:
    for type_name, text in MESSAGES.items():
        for line in text.splitlines():
            kind = line.split()[0].partition("[")[0]
            assert "/" not in kind or kind in MESSAGES, f"{type_name}: {line}"


def test_the_packages_are_those_that_are_always_checked() -> None:
    packages = {name.partition("/")[0] for name in (*MESSAGES, *SERVICES)}
    assert packages == {*PACKAGES, "geometry_msgs"}


@pytest.mark.parametrize(
    ("type_name", "field"),
    [
        ("std_msgs/Float32", "value"),
        ("std_msgs/Float32", "data.x"),
        ("std_msgs/Float32", "data[0]"),
        ("sensor_msgs/Imu", "orientation_covariance[9]"),
        ("sensor_msgs/Imu", "header.stamp.minutes"),
        ("sensor_msgs/BatteryState", 'cell_voltage["left"]'),
        ("nav_msgs/Odometry", "pose"),
    ],
)
def test_a_field_that_does_not_exist_is_refused(type_name: str, field: str) -> None:
    with pytest.raises(ConfigError):
        field_getter("/topic", type_name, field)


def test_a_message_is_completed_with_defaults_and_its_floats_are_rounded_to_32_bits() -> None:
    completed = complete("sensor_msgs/msg/BatteryState", {"percentage": 0.1, "cell_voltage": [3], "present": True})
    assert completed["percentage"] == 0.10000000149011612
    assert completed["cell_voltage"] == [3.0]
    assert completed["header"] == {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""}
    assert (completed["location"], completed["cell_temperature"], completed["power_supply_status"]) == ("", [], 0)
    assert complete("sensor_msgs/Imu", {})["orientation_covariance"] == [0.0] * 9
    assert complete("std_msgs/UInt8MultiArray", {"data": [1, 2]})["data"] == "AQI="


def test_only_ros_2_has_fields_without_a_default() -> None:
    assert "variance" not in complete("sensor_msgs/Range", {})
    assert complete("sensor_msgs/Range", {"variance": 0.5})["variance"] == 0.5


def test_a_message_of_an_unknown_package_is_passed_on_unchanged() -> None:
    assert complete("nav_msgs/Odometry", {"anything": [1]}) == {"anything": [1]}
    assert check_type("nav_msgs/Odometry") == ""
    assert not is_stamped("nav_msgs/Odometry")


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ({"data": "full"}, "Float32.data: expected a number, got 'full'"),
        ({"value": 1.0}, "Float32 has no field value; available: data"),
        ([], "expected a mapping"),
    ],
)
def test_a_message_that_does_not_match_its_type_is_a_message_error(message: Any, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        complete("std_msgs/Float32", message)


def test_a_type_that_a_known_package_lacks_is_a_configuration_error() -> None:
    with pytest.raises(ConfigError, match="unknown type std_msgs/Flota32"):
        check_type("std_msgs/Flota32")
    with pytest.raises(ConfigError, match="expected a type such as std_msgs/Float32, got 'Float32'"):
        check_type("Float32")
    assert check_type("std_msgs/msg/Float32") == "std_msgs/Float32"


def test_a_field_is_checked_where_the_definition_is_known() -> None:
    check_field("/in", "sensor_msgs/BatteryState", "cell_voltage[1]")
    check_field("/in", "nav_msgs/Odometry", "anything")
    with pytest.raises(ConfigError, match="/in: std_msgs/Float32 has no field level"):
        check_field("/in", "std_msgs/Float32", "level")


def test_a_definition_contains_each_type_once() -> None:
    text = definition("diagnostic_msgs/msg/DiagnosticArray")
    heads = [line for line in text.splitlines() if line.startswith("MSG: ")]
    assert heads == ["MSG: std_msgs/Header", "MSG: diagnostic_msgs/DiagnosticStatus", "MSG: diagnostic_msgs/KeyValue"]
    twist = definition("sensor_msgs/MultiDOFJointState")
    assert twist.count("MSG: geometry_msgs/Vector3\n") == 1
    assert definition("rosgraph_msgs/Log").endswith("MSG: std_msgs/Header\n" + MESSAGES["std_msgs/Header"])
    assert definition("nav_msgs/Odometry") == definition("nonsense") == ""


@pytest.mark.parametrize(
    ("type_name", "message"),
    [
        ("sensor_msgs/Image", {"data": base64.b64encode(bytes(range(256)) * 10).decode("ascii")}),
        ("std_msgs/Int16MultiArray", {"data": list(range(-1000, 1000))}),
        ("std_msgs/UInt8MultiArray", {"data": base64.b64encode(bytes(1000)).decode("ascii")}),
        ("sensor_msgs/LaserScan", {"ranges": [0.5 * number for number in range(1000)]}),
        ("std_msgs/Float64MultiArray", {"data": [0.1 * number for number in range(1000)]}),
    ],
)
def test_a_large_array_is_checked_without_a_call_per_element(type_name: str, message: Any) -> None:
    complete(type_name, message)  # caches
    calls: list[str] = []
    sys.setprofile(lambda frame, event, argument: calls.append(event))
    try:
        completed = complete(type_name, message)
    finally:
        sys.setprofile(None)
    assert len(calls) < 500
    assert {name: completed[name] for name in message} == message


@pytest.mark.parametrize(
    ("type_name", "field", "values"),
    [
        ("std_msgs/Int16MultiArray", "data", [1, 40_000]),
        ("std_msgs/Int16MultiArray", "data", [1, True]),
        ("std_msgs/Float64MultiArray", "data", [1.0, "2.0"]),
        ("std_msgs/Float32MultiArray", "data", [1.0, True]),
        ("sensor_msgs/Imu", "orientation_covariance", [1.0] * 8),
    ],
)
def test_one_wrong_element_of_an_array_is_refused(type_name: str, field: str, values: Any) -> None:
    with pytest.raises(MessageError):
        complete(type_name, {field: values})


def test_numbers_of_an_array_are_rounded_to_32_bits() -> None:
    completed = complete("std_msgs/Float32MultiArray", {"data": [0.1, 1e39, -1e39]})
    assert completed["data"] == [0.10000000149011612, float("inf"), float("-inf")]
