"""Signals that recordings offer."""

from __future__ import annotations

from typing import List

import pytest

pytest.importorskip("rosbags")

from robot_health_monitor.recordings.recording import Channel
from robot_health_monitor.recordings.sources import MOST_FIELDS, list_sources


def channel(topic: str, type_name: str) -> Channel:
    return Channel(topic, type_name, "ros1", "", "")


def fields(topic: str, type_name: str) -> List[str]:
    found, problems = list_sources([channel(topic, type_name)])
    assert problems == []
    return [source.settings["field"] for source in found]


def test_numbers_of_the_standard_messages_without_headers_codes_and_arrays() -> None:
    assert fields("/a", "std_msgs/Float32") == ["data"]
    assert fields("/a", "std_msgs/UInt8") == ["data"]
    assert fields("/a", "sensor_msgs/Temperature") == ["temperature", "variance", ""]
    battery = ["voltage", "current", "charge", "capacity", "design_capacity", "percentage"]
    assert [field for field in fields("/a", "sensor_msgs/BatteryState") if field != "temperature"] == [*battery, ""]


@pytest.mark.parametrize(
    "type_name",
    ["std_msgs/String", "std_msgs/Bool", "std_msgs/Float32MultiArray", "sensor_msgs/Joy"],
)
def test_of_other_messages_only_the_arrival_counts(type_name: str) -> None:
    assert fields("/a", type_name) == [""]


def test_units_are_those_of_the_definitions() -> None:
    found, _ = list_sources([channel("/imu", "sensor_msgs/Imu"), channel("/t", "sensor_msgs/Temperature")])
    units = {source.name: source.settings.get("unit") for source in found}
    assert units["imu_linear_acceleration_z"] == "m/s^2"
    assert units["imu_angular_velocity_x"] == "rad/s"
    assert units["imu_orientation_w"] is None
    assert units["t_temperature"] == "degC"


def test_topics_of_the_middleware_and_other_packages_are_left_out() -> None:
    topics = [("/clock", "rosgraph_msgs/Clock"), ("/odom", "nav_msgs/Odometry"), ("/rosout", "std_msgs/Float32")]
    assert list_sources([channel(*topic) for topic in topics]) == ([], [])


def test_names_are_valid_and_unique() -> None:
    topics = ["/a/b", "/a_b", "/link", "/a_b_2", f"/{'q' * 5000}"]
    found, _ = list_sources([channel(topic, "std_msgs/Float32") for topic in topics])
    assert [source.name for source in found] == ["a_b", "a_b_2", "a_b_2_2", "_link", "q" * 200]


def test_a_topic_with_two_types_is_a_problem() -> None:
    found, problems = list_sources([channel("/a", "std_msgs/Float32"), channel("/a", "std_msgs/Float64")])
    assert [source.settings["type"] for source in found] == ["std_msgs/Float32"]
    assert problems == ["/a: std_msgs/Float64 left out, it also has std_msgs/Float32"]


@pytest.mark.parametrize("topic", ["/", "/2d", "//a", "/a//b", "/a b", "/ä", "/\x1b[31m", "/a\n", "/<b>"])
def test_a_topic_with_a_name_that_ros_does_not_allow_is_left_out(topic: str) -> None:
    problem = f"{topic}: left out, its name is not valid in ROS"
    assert list_sources([channel(topic, "std_msgs/Float32")]) == ([], [problem])


def test_numbers_and_signals_are_limited_and_the_rest_is_named() -> None:
    definition = "\n".join(f"float32 x{number}" for number in range(MOST_FIELDS + 1))
    wide = [Channel(f"/{name}", "std_msgs/Wide", "ros1", definition, "msg") for name in "abc"]
    found, problems = list_sources([*wide, channel("/d", "std_msgs/Float32")])
    assert [source.topic for source in found] == ["/a"] * (MOST_FIELDS + 1) + ["/b"] * (MOST_FIELDS + 1) + ["/d"]
    assert [found[at].settings["field"] for at in (0, 99, 100)] == ["x0", "x99", ""]
    assert problems == [
        *(f"/{name}: expected at most 100 numbers, got more: the rest is left out" for name in "abc"),
        "topics left out, because there are more than 300 signals: /c",
    ]
