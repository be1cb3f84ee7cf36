"""Samples collected in periods of 10 s of the wall clock."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.judge.sample_summary import SampleCollector, SampleSummary
from robot_health_monitor.core.values.model import Level

OK, WARN, ERROR, STALE = Level


def collector(offset_s: float = 0.0) -> SampleCollector:
    return SampleCollector(lambda: offset_s)


def test_samples_belong_to_the_period_in_which_they_arrive() -> None:
    collected = collector(offset_s=1000.0)
    for now_s, value in [(0.0, 3.0), (9.99, 1.0), (10.0, 5.0)]:
        collected.note(value, now_s)
    assert collected.take(math.inf) == [
        SampleSummary(1000.0, 1.0, 3.0, 2.0, 1.0, 2, 0, OK),
        SampleSummary(1010.0, 5.0, 5.0, 5.0, 5.0, 1, 0, OK),
    ]


def test_what_was_taken_is_not_taken_again() -> None:
    collected = collector()
    collected.note(3.0, 1.0)
    assert [part.good for part in collected.take(math.inf)] == [1]
    assert collected.take(math.inf) == []
    collected.note(4.0, 2.0)
    assert collected.take(math.inf) == [SampleSummary(0.0, 4.0, 4.0, 4.0, 4.0, 1, 0, OK)]


def test_the_open_period_is_taken_when_it_has_ended() -> None:
    collected = collector(offset_s=1000.0)
    collected.note(3.0, 1.0)
    assert collected.take(9.99) == []
    collected.note(5.0, 9.995)
    assert collected.take(10.0) == [SampleSummary(1000.0, 3.0, 5.0, 4.0, 5.0, 2, 0, OK)]
    collected.note(7.0, 10.0)
    assert collected.take(5.0) == [SampleSummary(1010.0, 7.0, 7.0, 7.0, 7.0, 1, 0, OK)]  # time went back


def test_bad_samples_and_undefined_statistics_have_no_values() -> None:
    collected = collector()
    collected.note(None, 1.0, good=False)
    collected.note(None, 2.0)
    assert collected.take(math.inf) == [SampleSummary(0.0, None, None, None, None, 1, 1, OK)]


def test_the_level_is_the_worst_one() -> None:
    collected = collector()
    for level in (OK, STALE, WARN):
        collected.note_level(level, 1.0)
    collected.note_level(WARN, 11.0)
    collected.note_level(ERROR, 11.5)
    collected.note_level(STALE, 12.0)
    assert [(part.start_s, part.level) for part in collected.take(math.inf)] == [(0.0, STALE), (10.0, ERROR)]


def test_periods_without_a_sample_or_a_known_level_do_not_exist() -> None:
    collected = collector()
    collected.note(1.0, 1.0)
    collected.note(1.0, 31.0)
    assert [part.start_s for part in collected.take(math.inf)] == [0.0, 30.0]


def test_time_that_goes_back_and_a_changed_wall_clock_begin_other_periods() -> None:
    offset_s = 0.0
    collected = SampleCollector(lambda: offset_s)
    collected.note(1.0, 25.0)
    collected.note(2.0, 3.0)
    offset_s = 100.0
    collected.note(3.0, 14.0)
    assert [(part.start_s, part.last) for part in collected.take(math.inf)] == [(20.0, 1.0), (0.0, 2.0), (110.0, 3.0)]


def test_what_nobody_takes_is_bounded() -> None:
    collected = collector()
    for number in range(1000):
        collected.note(float(number), number * 10.0)
    taken = collected.take(math.inf)
    assert len(taken) <= 361
    assert taken[-1].last == 999.0


@given(st.lists(st.floats(-1e308, 1e308), min_size=1, max_size=30))
def test_extremes_are_exact_and_the_mean_lies_between_them(values: list[float]) -> None:
    collected = collector()
    for value in values:
        collected.note(value, 5.0)
    (part,) = collected.take(math.inf)
    assert (part.least, part.most, part.last) == (min(values), max(values), values[-1])
    assert part.mean is not None
    assert math.isclose(part.mean, math.fsum(value / len(values) for value in values), rel_tol=1e-6, abs_tol=1e300)


@given(st.floats(-1e9, 1e9), st.floats(-1e9, 2e9))
def test_every_time_has_a_period_that_contains_it(now_s: float, offset_s: float) -> None:
    collected = collector(offset_s)
    collected.note(1.0, now_s)
    (part,) = collected.take(math.inf)
    assert -1e-3 <= now_s + offset_s - part.start_s <= 10.001
