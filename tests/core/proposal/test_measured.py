"""What is measured of one signal."""

from __future__ import annotations

import math
import random
from typing import Any, Iterable

import pytest

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.proposal.measured import MOST_ELEMENTS, Measured
from robot_health_monitor.core.proposal.suggestion import MOST_IRREGULAR


def arrivals(times_s: Iterable[float]) -> Measured:
    measured = Measured(read_signal("a", {"field": "", "statistic": "frequency_hz"}))
    for time_s in times_s:
        measured.add(time_s, None)
    return measured


def test_samples_gaps_and_steps_are_counted() -> None:
    measured = Measured(read_signal("a", {}))
    for time_s, value in ((10.0, 1.0), (11.0, 4.0), (13.5, None), (14.0, 2.0)):
        measured.add(time_s, value)
    assert (measured.samples, measured.bad_samples, measured.duration_s) == (4, 1, 4.0)
    assert (measured.gaps.min, measured.gaps.max) == (0.5, 2.5)
    assert (measured.steps.min, measured.steps.max) == (2.0, 3.0)
    assert measured.mean_rate_hz == 0.75


@pytest.mark.parametrize("rate_hz", [0.2, 1.0, 7.3, 50.0, 1000.0])
@pytest.mark.parametrize("jitter", [0.0, 0.4])
def test_regular_messages_are_regular_whatever_their_rate(rate_hz: float, jitter: float) -> None:
    chance = random.Random(1)
    times = sorted((number + chance.uniform(0.0, jitter)) / rate_hz for number in range(max(20, int(60 * rate_hz))))
    assert arrivals(times).irregularity < MOST_IRREGULAR


def test_several_publishers_of_one_topic_are_regular() -> None:
    times = sorted([number * 0.02 for number in range(3000)] + [0.001 + number * 0.1 for number in range(600)])
    assert arrivals(times).irregularity < MOST_IRREGULAR


def test_publishers_that_send_together_are_regular() -> None:
    assert arrivals(second + number * 0.001 for second in range(60) for number in range(20)).irregularity < 0.07


@pytest.mark.parametrize("number", [20, 40, 100])
@pytest.mark.parametrize("seed", range(10))
def test_events_are_irregular(seed: int, number: int) -> None:
    chance = random.Random(seed)
    assert arrivals(sorted(chance.uniform(0.0, 60.0) for _ in range(number))).irregularity > MOST_IRREGULAR


def test_messages_that_come_in_bursts_are_irregular() -> None:
    assert (
        arrivals(burst + number * 0.01 for burst in (0.0, 20.0, 40.0) for number in range(100)).irregularity
        > MOST_IRREGULAR
    )


def test_a_few_messages_show_no_regularity() -> None:
    assert arrivals([0.0, 1.0, 2.0, 3.0]).irregularity == math.inf


def test_a_month_of_messages_is_counted_in_bounded_memory() -> None:
    measured = arrivals(number * 260.0 for number in range(10_000))
    assert measured.irregularity < 0.05
    assert len(measured._bins) == 16


# Listening on a middleware, here the in-process one.


def heard(config: dict[str, Any], type_name: str, *messages: Any) -> Measured:
    bus = LocalBus(start_s=100.0, wall_time_s=lambda: 1.7e9)
    robot = bus.node("robot")
    measured = Measured(read_signal("x", {"topic": "topic", "type": type_name, **config}))
    robot.advertise("topic", type_name)
    measured.listen(bus.node("survey"))
    for number, message in enumerate(messages):
        bus.run_until(100.0 + number)
        robot.publish("topic", message)
    return measured


def test_values_are_in_the_unit_of_the_signal_and_invalid_ones_are_counted() -> None:
    messages = [{"data": value} for value in (0.25, 7.0, 0.75)]
    measured = heard({"scale": 100.0, "valid_max": 100.0}, "std_msgs/Float32", *messages)
    assert (measured.values.count, measured.values.min, measured.values.max) == (2, 25.0, 75.0)
    assert measured.bad_samples == 1


def test_rates_are_those_that_the_monitor_would_judge() -> None:
    config = {"field": "", "statistic": "frequency_hz", "window_s": 10.0}
    measured = heard(config, "std_msgs/Float32", *({"data": 0.0} for _ in range(20)))
    # Defined after window_min_s, 5 s.
    assert (measured.values.count, measured.values.min, measured.values.max) == (15, 1.0, 1.0)


def test_stamps_are_measured_as_ages() -> None:
    stamps = [{"header": {"stamp": {"secs": 1_699_999_999, "nsecs": each}}} for each in (500_000_000, 750_000_000)]
    measured = heard({"field": "header.stamp"}, "sensor_msgs/Temperature", *stamps)
    assert (measured.values.min, measured.values.max) == (0.25, 0.5)


def test_elements_are_measured_one_by_one() -> None:
    message = {"name": ["left", "right"], "effort": [1.0, 3.0]}
    measured = heard({"field": 'effort["*"]'}, "sensor_msgs/JointState", message, {**message, "effort": [2.0, 3.0]})
    assert {name: each.values.max for name, each in measured.elements.items()} == {"left": 2.0, "right": 3.0}
    assert measured.samples == 2


def test_the_number_of_elements_is_bounded() -> None:
    names = [f"j{number}" for number in range(1000)]
    measured = heard({"field": 'effort["*"]'}, "sensor_msgs/JointState", {"name": names, "effort": [1.0] * 1000})
    assert list(measured.elements) == names[:MOST_ELEMENTS]
    assert measured.is_cut


def test_the_time_between_two_recordings_is_no_gap() -> None:
    measured = Measured(read_signal("x", {"topic": "topic", "type": "std_msgs/Float32"}))
    for start_s in (0.0, 1000.0):
        measured.begin_recording()
        bus = LocalBus(start_s=start_s)
        robot = bus.node("robot")
        robot.advertise("topic", "std_msgs/Float32")
        measured.listen(bus.node("survey"))
        for number in range(3):
            bus.run_until(start_s + number)
            robot.publish("topic", {"data": 1.0})
    assert measured.duration_s == 4.0
    assert measured.gaps.max == 1.0
