"""Listening on a middleware, here the in-process one."""

from __future__ import annotations

from typing import Any, Dict

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.proposal.survey import MOST_ELEMENTS, Survey


def heard(config: Dict[str, Any], type_name: str, *messages: Any) -> Survey:
    bus = LocalBus(start_s=100.0, wall_time_s=lambda: 1.7e9)
    robot, survey = bus.node("robot"), Survey()
    robot.advertise("topic", type_name)
    survey.listen(bus.node("survey"), {"x": read_signal("x", {"topic": "topic", "type": type_name, **config})})
    for number, message in enumerate(messages):
        bus.run_until(100.0 + number)
        robot.publish("topic", message)
    return survey


def test_values_are_in_the_unit_of_the_signal_and_invalid_ones_are_counted() -> None:
    messages = [{"data": value} for value in (0.25, 7.0, 0.75)]
    measured = heard({"scale": 100.0, "valid_max": 100.0}, "std_msgs/Float32", *messages).measured["x"]
    assert (measured.values.count, measured.values.min, measured.values.max) == (2, 25.0, 75.0)
    assert measured.bad_samples == 1


def test_rates_are_those_that_the_monitor_would_judge() -> None:
    config = {"field": "", "statistic": "frequency_hz", "window_s": 10.0}
    measured = heard(config, "std_msgs/Float32", *({"data": 0.0} for _ in range(20))).measured["x"]
    # Defined after window_min_s, 5 s.
    assert (measured.values.count, measured.values.min, measured.values.max) == (15, 1.0, 1.0)


def test_stamps_are_measured_as_ages() -> None:
    stamps = [{"header": {"stamp": {"secs": 1_699_999_999, "nsecs": each}}} for each in (500_000_000, 750_000_000)]
    measured = heard({"field": "header.stamp"}, "sensor_msgs/Temperature", *stamps).measured["x"]
    assert (measured.values.min, measured.values.max) == (0.25, 0.5)


def test_elements_are_measured_one_by_one() -> None:
    message = {"name": ["left", "right"], "effort": [1.0, 3.0]}
    survey = heard({"field": 'effort["*"]'}, "sensor_msgs/JointState", message, {**message, "effort": [2.0, 3.0]})
    assert {name: each.values.max for name, each in survey.elements["x"].items()} == {"left": 2.0, "right": 3.0}
    assert survey.measured["x"].samples == 2


def test_the_number_of_elements_is_bounded() -> None:
    names = [f"j{number}" for number in range(1000)]
    survey = heard({"field": 'effort["*"]'}, "sensor_msgs/JointState", {"name": names, "effort": [1.0] * 1000})
    assert list(survey.elements["x"]) == names[:MOST_ELEMENTS]
    assert survey.cut == {"x"}


def test_the_time_between_two_recordings_is_no_gap() -> None:
    survey = Survey()
    for start_s in (0.0, 1000.0):
        survey.begin_recording()
        bus = LocalBus(start_s=start_s)
        robot = bus.node("robot")
        robot.advertise("topic", "std_msgs/Float32")
        survey.listen(bus.node("survey"), {"x": read_signal("x", {"topic": "topic", "type": "std_msgs/Float32"})})
        for number in range(3):
            bus.run_until(start_s + number)
            robot.publish("topic", {"data": 1.0})
    assert survey.measured["x"].duration_s == 4.0
    assert survey.measured["x"].gaps.max == 1.0
