"""What is measured of one signal."""

from __future__ import annotations

import math
import random
from typing import Iterable

import pytest

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.proposal.measured import Measured
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
    assert len(measured._bins) == 128
