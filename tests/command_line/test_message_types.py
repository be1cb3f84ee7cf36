"""Types and fields of messages are checked against the definitions that are known."""

from __future__ import annotations

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.message_types import check_field, known_definitions


@pytest.fixture(autouse=True)
def _without_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_VERSION", raising=False)


@pytest.mark.parametrize(
    ("type_name", "field"),
    [
        ("std_msgs/Float32", "data"),
        ("std_msgs/msg/Float32", "data"),
        ("sensor_msgs/BatteryState", "cell_voltage[0]"),
        ("diagnostic_msgs/DiagnosticArray", 'status["motor: left"].values["Temperature (C)"]'),
        ("sensor_msgs/Imu", ""),
    ],
)
def test_types_of_the_standard_packages_are_known(type_name: str, field: str) -> None:
    assert check_field(known_definitions(), "/topic", type_name, field)


def test_a_type_of_another_package_is_unknown_but_no_error() -> None:
    assert not check_field(known_definitions(), "/topic", "my_robot_msgs/Wheel", "speed")


def test_a_misspelt_type_of_a_standard_package_names_the_close_one() -> None:
    with pytest.raises(ConfigError, match=r"std_msgs/Flaot32.*did you mean std_msgs/Float32\?") as problem:
        check_field(known_definitions(), "/topic", "std_msgs/Flaot32", "data")
    assert problem.value.path == ("type",)


def test_a_field_that_the_type_lacks_lists_those_that_it_has() -> None:
    with pytest.raises(ConfigError, match="percentage") as problem:
        check_field(known_definitions(), "/topic", "sensor_msgs/BatteryState", "percent")
    assert problem.value.path == ("field",)


@pytest.mark.parametrize("version", ["1", "2", "nonsense"])
def test_a_sourced_ros_without_its_modules_leaves_the_standard_packages(
    version: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_VERSION", version)
    assert check_field(known_definitions(), "/topic", "std_msgs/Float32", "data")
