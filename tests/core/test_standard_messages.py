"""Messages of the standard packages are known without ROS; tests/ros1 and tests/ros2 compare them with ROS's."""

from __future__ import annotations

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.standard_messages import MESSAGES, PACKAGES, SERVICES, messages


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
    for type_name, definition in MESSAGES.items():
        for line in definition.splitlines():
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
        messages.field_getter("/topic", type_name, field)
