"""The signals that topics can have."""

from __future__ import annotations

from typing import Any, Iterable

import pytest

from robot_health_monitor.core.messages.definitions import parse_definition
from robot_health_monitor.core.messages.standard_messages import definition
from robot_health_monitor.core.proposal.candidates import MOST_FIELDS, MOST_SIGNALS, Candidates, Topic
from robot_health_monitor.core.proposal.suggestion import Signal


def topic(name: str, type_name: str, text: str | None = None) -> Topic:
    return Topic(name, type_name, parse_definition(type_name, definition(type_name) if text is None else text, "msg"))


def listed(topics: Iterable[Topic], **options: Any) -> Candidates:
    candidates = Candidates(**options)
    candidates.add(topics)
    return candidates


def signals(candidates: Candidates) -> list[Signal]:
    return list(candidates.signals.values())


def reasons(type_name: str, text: str | None = None) -> dict[str, list[str]]:
    by_reason: dict[str, list[str]] = {}
    for (_, field), reason in listed([topic("/a", type_name, text)]).fields.items():
        by_reason.setdefault(reason, []).append(field)
    return by_reason


def fields(type_name: str, text: str | None = None) -> list[str]:
    return [each.settings["field"] for each in signals(listed([topic("/a", type_name, text)]))]


def test_numbers_of_the_standard_messages_without_headers_codes_and_arrays() -> None:
    assert fields("std_msgs/Float32") == ["", "data"]
    assert fields("std_msgs/UInt8") == ["", "data"]
    assert fields("sensor_msgs/Temperature") == ["", "header.stamp", "temperature", "variance"]
    numbers = ["voltage", "temperature", "current", "charge", "capacity", "design_capacity"]
    cells = ["cell_temperature[*]", "cell_temperature[*]"]
    assert fields("sensor_msgs/BatteryState") == ["", "header.stamp", "percentage", "cell_voltage[*]", *numbers, *cells]
    assert reasons("sensor_msgs/BatteryState") == {
        "8 bits: a state or a code": ["power_supply_status", "power_supply_health", "power_supply_technology"],
        "flags": ["present"],
        "text": ["location", "serial_number"],
    }


def test_an_array_of_numbers_is_watched_by_its_smallest_and_its_largest_one() -> None:
    found = signals(listed([topic("/a", "std_msgs/Float32MultiArray")]))
    lines = [
        (each.name, each.settings["field"], each.settings.get("reduce")) for each in found if each.kind == "number"
    ]
    assert lines == [
        ("a_layout_data_offset", "layout.data_offset", None),
        ("a_min", "data[*]", "min"),
        ("a_max", "data[*]", "max"),
    ]
    assert reasons("std_msgs/Float32MultiArray") == {"times and arrays of messages": ["layout.dim"]}


def test_whatever_is_no_number_is_left_out_with_its_reason() -> None:
    text = "Header header\nstring name\nbool on\ntime since\nMotor[] motors\nuint8[4] code\n" + "=" * 80
    text += "\nMSG: own_msgs/Motor\nfloat32 amps\n"
    assert reasons("own_msgs/Drive", text) == {
        "text": ["name"],
        "flags": ["on"],
        "times and arrays of messages": ["since", "motors"],
        "8 bits: a state or a code": ["code"],
    }
    assert reasons("sensor_msgs/Image")["a block of bytes, or beside one: not read"] == [
        "height", "width", "is_bigendian", "step", "data",
    ]  # fmt: skip
    assert listed([Topic("/a", "own_msgs/Secret", None)]).fields == {
        ("/a", "its fields"): "the definition of its type is not known"
    }


@pytest.mark.parametrize("type_name", ["std_msgs/String", "std_msgs/Bool"])
def test_of_messages_without_numbers_the_arrival_counts(type_name: str) -> None:
    assert fields(type_name) == [""]


def test_numbers_of_any_type_whose_definition_is_there() -> None:
    text = "Header header\nuint8 CODE=1\nint32 state\nfloat64[36] covariance\nMotor left\n" + "=" * 80
    text += "\nMSG: own_msgs/Motor\nfloat32 amps\nstring label\nbool on\nduration since\n"
    assert fields("own_msgs/Drive", text) == ["", "header.stamp", "state", *["covariance[*]"] * 2, "left.amps"]


def test_a_topic_whose_type_is_unknown_is_watched_by_its_arrivals() -> None:
    listing = listed([Topic("/a", "own_msgs/Secret", None)])
    assert [each.settings["field"] for each in signals(listing)] == [""]


@pytest.mark.parametrize("type_name", ["sensor_msgs/Image", "sensor_msgs/PointCloud2", "sensor_msgs/CompressedImage"])
def test_of_images_and_clouds_only_arrivals_and_stamps_count(type_name: str) -> None:
    assert fields(type_name) == ["", "header.stamp"]
    listing = listed([topic("/a", type_name)], ages_of_bulk=False)
    assert [each.settings["field"] for each in signals(listing)] == [""]


def test_elements_with_names_are_measured_one_by_one() -> None:
    listing = listed([topic("/joints", "sensor_msgs/JointState")])
    elements = [each.settings["field"] for each in signals(listing) if each.kind == "elements"]
    assert elements == ['position["*"]', 'velocity["*"]', 'effort["*"]']


def test_all_statuses_are_one_signal() -> None:
    (found,) = signals(listed([topic("/diagnostics", "diagnostic_msgs/DiagnosticArray")], namespace="r1"))
    assert found.settings == {
        "topic": "/diagnostics",
        "type": "diagnostic_msgs/DiagnosticArray",
        "field": 'status["*"]',
    }


def test_units_are_those_of_the_definitions() -> None:
    twist = "Twist twist\n" + "=" * 80 + "\nMSG: geometry_msgs/Twist\nVector3 linear\n" + "=" * 80
    twist += "\nMSG: geometry_msgs/Vector3\nfloat64 x\n"
    topics = [topic("/imu", "sensor_msgs/Imu"), topic("/t", "sensor_msgs/Temperature")]
    found = listed([*topics, topic("/v", "own_msgs/Speed", twist.replace("Twist t", "geometry_msgs/Twist t"))])
    units = {each.name: each.settings.get("unit") for each in signals(found)}
    assert units["imu_linear_acceleration_z"] == "m/s^2"
    assert units["imu_angular_velocity_x"] == "rad/s"
    assert units["imu_orientation_w"] is None
    assert units["t_temperature"] == "degC"
    assert units["v_twist_linear_x"] == "m/s"


def test_topics_of_the_middleware_are_left_out() -> None:
    found = listed([topic("/clock", "std_msgs/Float32"), topic("/rosout_agg", "std_msgs/Float32")])
    assert (signals(found), set(found.not_watched)) == ([], {"/clock", "/rosout_agg"})


def test_names_are_valid_and_unique() -> None:
    topics = ["/a/b", "/a_b", "/link", "/a_b_2", f"/{'q' * 5000}"]
    found = signals(listed([topic(each, "std_msgs/Float32") for each in topics]))
    names = [each.name for each in found if each.kind == "number"]
    assert names == ["a_b", "a_b_2", "a_b_2_2", "_link", f"{'q' * 200}_2"]
    assert len({each.name for each in found}) == len(found)


def test_of_a_topic_with_two_types_the_first_one_is_watched() -> None:
    found = listed([topic("/a", "std_msgs/Float32"), topic("/a", "std_msgs/Float64")])
    assert {each.settings["type"] for each in signals(found)} == {"std_msgs/Float32"}
    assert found.fields == {("/a", "as std_msgs/Float64"): "it also has std_msgs/Float32"}


@pytest.mark.parametrize("name", ["/", "/2d", "//a", "/a//b", "/a b", "/ä", "/\x1b[31m", "/a\n", "/<b>"])
def test_a_topic_with_a_name_that_ros_does_not_allow_is_left_out(name: str) -> None:
    found = listed([topic(name, "std_msgs/Float32")])
    assert (found.signals, found.not_watched) == ({}, {name: "its name is not valid in ROS"})


def test_numbers_of_a_topic_are_limited() -> None:
    text = "\n".join(f"float32 x{number}" for number in range(MOST_FIELDS + 1))
    found = listed([topic("/a", "own_msgs/Wide", text)])
    assert [each.settings["field"] for each in signals(found)][-1] == "x99"
    assert found.fields == {("/a", "x100"): "more than 100 signals"}


@pytest.mark.newest_python
def test_a_robot_with_2000_topics_is_watched_by_the_arrivals_of_the_first_ones() -> None:
    found = listed([topic(f"/t{number:04}", "std_msgs/Float32") for number in range(2000)])
    topics = [each.topic for each in signals(found)]
    assert len(topics) == 2 * MOST_SIGNALS
    assert topics[:MOST_SIGNALS] == topics[MOST_SIGNALS:] == [f"/t{number:04}" for number in range(300)]
    assert [each.kind for each in signals(found)] == ["rate"] * 300 + ["number"] * 300
    assert len(found.not_watched) == 1700
    assert found.not_watched["/t1999"] == "more than 300 signals"


@pytest.mark.newest_python
def test_topics_that_appear_later_count_and_numbers_of_earlier_ones_leave_room_for_their_arrivals() -> None:
    text = "\n".join(f"float64 x{number}" for number in range(6))
    wide = [topic(f"/a{number:03}", "own_msgs/Wide", text) for number in range(100)]
    candidates = listed(wide)
    assert len(candidates.signals) == 400  # 100 arrivals, 300 of 600 numbers
    assert candidates.fields["/a099", "x5"] == "more than 300 signals"
    candidates.add(topic(f"/b{number:03}", "own_msgs/Wide", text) for number in range(250))
    assert [each.kind for each in signals(candidates)[400:]] == ["rate"] * 200
    candidates.add([topic("/c", "std_msgs/Float32")])
    assert len(candidates.signals) == 600
    assert candidates.not_watched["/c"] == "more than 300 signals"
