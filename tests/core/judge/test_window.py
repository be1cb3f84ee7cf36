"""The window: which samples it keeps, and each statistic by hand."""

from __future__ import annotations

import math
from typing import Iterable

import pytest

from robot_health_monitor.core.config.signal_config import STATISTICS
from robot_health_monitor.core.judge.window import STATISTICS_OF_SAMPLES, CountWindow, Window


def window_of(*values: float, window_s: float = 60.0, window_samples: int = 6000) -> Window:
    """A window with a value per second."""
    return timed(enumerate(values), window_s, window_samples)


def timed(samples: Iterable[tuple[float, float]], window_s: float = 60.0, window_samples: int = 6000) -> Window:
    window = Window(window_s, window_samples)
    for now_s, value in samples:
        window.add(value, float(now_s))
    return window


def test_every_statistic_of_the_configuration_is_there() -> None:
    assert (*STATISTICS_OF_SAMPLES, "largest_gap_s", "count", "forecast") == STATISTICS  # these need other windows


def test_the_statistics_of_four_values() -> None:
    # mean 25/4; squared distances 14.0625 + 3.0625 + 0.0625 + 27.5625 = 44.75, over 4
    assert window_of(10.0, 8.0, 6.0, 1.0).statistics() == {
        "last": 1.0,
        "mean": 6.25,
        "min": 1.0,
        "max": 10.0,
        "stddev": math.sqrt(44.75 / 4),
        "rate": pytest.approx(-2.9),  # distances from 1.5 s: (-1.5 * 10 - 0.5 * 8 + 0.5 * 6 + 1.5 * 1) / 5
        "frequency_hz": 1.0,
    }


def test_an_empty_window_defines_nothing() -> None:
    assert Window(60.0, 10).statistics() == {}


def test_one_sample_has_no_rate_and_no_frequency() -> None:
    assert window_of(7.0).statistics() == {"last": 7.0, "mean": 7.0, "min": 7.0, "max": 7.0, "stddev": 0.0}


def test_samples_of_one_moment_have_no_rate_and_no_frequency() -> None:
    assert {"rate", "frequency_hz"}.isdisjoint(timed([(1.0, 5.0), (1.0, 7.0)]).statistics())


def test_rate_is_the_slope_of_the_least_squares_line() -> None:
    # mean time 2 s; (-2 * 10 - 1 * 40 + 3 * 20) / (4 + 1 + 9)
    assert timed([(0.0, 10.0), (1.0, 40.0), (5.0, 20.0)]).rate() == pytest.approx(0.0)
    assert timed([(0.0, 10.0), (1.0, 40.0), (5.0, 34.0)]).rate() == pytest.approx(3.0)


def test_two_samples_have_no_rate() -> None:
    assert timed([(0.0, 1.0), (1.0, 2.0)]).rate() is None


def test_a_rate_without_time_between_three_samples_is_undefined() -> None:
    assert timed([(1.0, 5.0), (1.0, 7.0), (1.0, 9.0)]).rate() is None


def test_frequency_counts_the_arrivals_after_the_oldest() -> None:
    assert timed([(0.0, 1.0), (0.5, 1.0), (1.0, 1.0), (2.0, 1.0)]).frequency_hz() == 1.5


def test_a_sample_exactly_window_s_old_stays_and_an_older_one_goes() -> None:
    assert len(timed([(0.0, 1.0), (60.0, 2.0)])) == 2
    assert timed([(0.0, 1.0), (60.5, 2.0)]).statistics()["min"] == 2.0


def test_at_most_window_samples_are_kept_the_newest_ones() -> None:
    window = window_of(1.0, 2.0, 3.0, 4.0, window_samples=3)
    assert (len(window), window.min(), window.mean()) == (3, 2.0, 3.0)


def test_the_smallest_of_several_equal_values_leaves_only_with_the_last_of_them() -> None:
    window = window_of(1.0, 1.0, 5.0, window_samples=3)
    window.add(5.0, 3.0)
    assert window.min() == 1.0
    window.add(5.0, 4.0)
    assert window.min() == 5.0


@pytest.mark.parametrize(("window_s", "window_samples", "mean"), [(1.0, 10, 3.5), (60.0, 1, 4.0), (60.0, 10, 2.5)])
def test_a_resized_window_keeps_what_still_fits(window_s: float, window_samples: int, mean: float) -> None:
    window = window_of(1.0, 2.0, 3.0, 4.0)
    resized = Window(window_s, window_samples)
    resized.take_over(window)
    assert resized.mean() == mean


def test_a_cleared_window_starts_again() -> None:
    window = window_of(1e9, -1e9)
    window.clear()
    window.add(3.0, 0.0)
    assert window.statistics() == {"last": 3.0, "mean": 3.0, "min": 3.0, "max": 3.0, "stddev": 0.0}


@pytest.mark.parametrize(
    ("values", "mean", "stddev"),
    [
        ([1.7e308, 1.7e308, -1.7e308, -1.7e308], 0.0, 1.7e308),
        ([1.7e308, 1.6e308], 1.65e308, 5e306),
        ([1e200, -1e200, 0.0, 0.0], 0.0, 1e200 / math.sqrt(2.0)),
        ([5e-324, 5e-324], 5e-324, 0.0),
        ([-0.0, 0.0], 0.0, 0.0),
    ],
)
def test_the_ends_of_the_doubles_give_finite_statistics(values: Iterable[float], mean: float, stddev: float) -> None:
    window = window_of(*values)
    assert window.mean() == pytest.approx(mean)
    assert window.stddev() == pytest.approx(stddev)
    assert all(math.isfinite(value) for value in window.statistics().values())


@pytest.mark.parametrize("place", [0, 1, 2999, 5999])
def test_statistics_are_right_while_a_huge_value_is_anywhere_in_the_window(place: int) -> None:
    """The same window full of zeros and one of the largest doubles, first while it fills, then after it has turned."""
    window, huge = Window(1e9, 6000), 1.7e308
    for number in range(6000):
        window.add(huge if number == place else 0.0, float(number))
    expected = (huge / 6000, huge * math.sqrt(1 / 6000 - 1 / 6000**2))
    assert (window.mean(), window.stddev()) == (pytest.approx(expected[0]), pytest.approx(expected[1]))
    for number in range(6000, 6000 + place):
        window.add(0.0, float(number))
        if number % 1000 == 0:
            assert (window.mean(), window.stddev()) == (pytest.approx(expected[0]), pytest.approx(expected[1]))
    window.add(0.0, 6000.0 + place)
    assert (window.mean(), window.stddev()) == (0.0, 0.0)


def test_huge_values_that_are_far_apart_are_summed_without_overflow() -> None:
    # the mean of 3, -5 and 7 is 5/3; squared distances 16/9 + 400/9 + 256/9 = 672/9, over 3
    window = window_of(1e200, 3e200, -5e200, 7e200, window_samples=3)
    assert window.mean() == pytest.approx(5e200 / 3, rel=1e-14)
    assert window.stddev() == pytest.approx(math.sqrt(224) / 3 * 1e200, rel=1e-14)


@pytest.mark.newest_python
def test_one_huge_value_costs_no_more_than_any_other() -> None:
    """Each sample is moved once per two window lengths, whatever the values and however often statistics are read."""

    class CountingWindow(Window):
        discards = 0

        def _discard(self) -> None:
            self.discards += 1
            super()._discard()

    plain, huge = CountingWindow(1e9, 6000), CountingWindow(1e9, 6000)
    for number in range(60_000):
        plain.add(float(number % 7), float(number))
        huge.add(1.7e308 if number == 3000 else float(number % 7), float(number))
        assert huge.mean() is not None
    assert plain.discards == huge.discards == 1 + 4  # at the start, and per 12,001 samples after the first 6,000


@pytest.mark.parametrize("gap_s", [0.0, 4.95, 20.0])
def test_reading_changes_nothing(gap_s: float) -> None:
    """Not even a rounding error: a replay reads less often than the robot did, and gives the same texts."""
    read, unread = Window(5.0, 100), Window(5.0, 100)
    for number in range(1000):
        value, now_s = 1e9 + (number * 7919 % 1000) / 997.0, number * 0.1 + number // 70 * gap_s
        read.add(value, now_s)
        unread.add(value, now_s)
        read.statistics()
        if number % 97 == 0:
            assert read.statistics() == unread.statistics()
    assert read.statistics() == unread.statistics()


def test_nothing_but_last_is_judged_before_window_min_s_has_passed() -> None:
    window = Window(60.0, 100, window_min_s=30.0)
    for now_s in (100.0, 110.0, 129.9):
        window.add(5.0, now_s)
        assert [name for name in STATISTICS_OF_SAMPLES if window.statistic(name) is not None] == ["last"]
        assert window.statistics()["mean"] == 5.0  # to show
    window.add(5.0, 130.0)
    assert all(window.statistic(name) is not None for name in STATISTICS_OF_SAMPLES)


def test_window_min_s_counts_from_the_first_sample_after_a_gap() -> None:
    window = Window(60.0, 100, window_min_s=10.0)
    for now_s in range(11):
        window.add(5.0, float(now_s))
    assert window.statistic("mean") == 5.0
    window.begin_anew()
    assert window.statistic("mean") is None
    window.add(7.0, 20.0)
    window.add(7.0, 29.0)
    assert window.statistic("mean") is None
    window.add(7.0, 30.0)
    assert window.statistic("max") == 7.0 and window.statistic("min") == 5.0  # what came before the gap is still there


def test_window_min_s_counts_from_the_first_sample_after_a_clear() -> None:
    window = Window(60.0, 100, window_min_s=10.0)
    for now_s in (0.0, 10.0):
        window.add(5.0, now_s)
    window.clear()
    window.add(5.0, 20.0)
    assert (window.statistic("last"), window.statistic("mean")) == (5.0, None)


def test_a_rate_that_is_no_double_is_undefined() -> None:
    assert timed([(0.0, -1.7e308), (0.5, 0.0), (1.0, 1.7e308)]).rate() is None
    assert timed([(0.0, -1e300), (1.0, 0.0), (2.0, 1e300)]).rate() == pytest.approx(1e300)


def test_an_outlier_that_left_leaves_no_trace() -> None:
    window = window_of(1e300, 1.0, 2.0, 3.0, 4.0, window_samples=4)
    assert (window.mean(), window.stddev()) == (2.5, math.sqrt(1.25))


def test_no_array_grows_beyond_three_times_the_window() -> None:
    window = Window(60.0, 50)
    for step in range(10_000):
        window.add(float(step * (-1) ** step), step * 0.001)
        assert window.max() == max(value for _, value in window.samples(100))
        assert len(window) <= 50
        assert len(window._times) == len(window._values) <= 151  # the samples, and twice as many that have left
        assert len(window._largest) <= 50


def test_samples_of_a_small_window_are_all_of_them() -> None:
    window = Window(60.0, 100)
    for number in range(5):
        window.add(float(number), 10.0 + number)
    assert window.samples(5) == [(10.0, 0.0), (11.0, 1.0), (12.0, 2.0), (13.0, 3.0), (14.0, 4.0)]
    assert Window(60.0, 100).samples(5) == []


@pytest.mark.parametrize("count", [301, 302, 599, 6000])
@pytest.mark.parametrize("limit", [4, 5, 300])
def test_fewer_samples_keep_the_first_the_last_and_the_extremes(count: int, limit: int) -> None:
    window = Window(1e6, 6000)
    for number in range(count):
        window.add(math.sin(number), float(number))
    window.add(0.5, float(count))
    full = window.samples(10_000)
    assert len(full) == min(count + 1, 6000)
    found = window.samples(limit)
    assert len(found) <= limit
    assert (found[0], found[-1]) == (full[0], full[-1])
    assert found == sorted(set(found)) and set(found) <= set(full)
    values = [value for _, value in found]
    assert (min(values), max(values)) == (min(value for _, value in full), max(value for _, value in full))


def test_samples_that_have_left_appear_nowhere() -> None:
    window = Window(9.5, 100)
    for second in range(100):  # the whole window is exchanged ten times
        window.add(float(second % 7), float(second))
        newest = [(float(past), float(past % 7)) for past in range(max(0, second - 9), second + 1)]
        values = [value for _, value in newest]
        assert window.samples(100) == newest
        assert window.samples(100, -1.0) == newest
        assert len(window) == len(newest)
        assert (window.min(), window.max(), window.last()) == (min(values), max(values), values[-1])
        if second:
            assert window.frequency_hz() == 1.0
    shorter = Window(3.5, 100)
    shorter.take_over(window)
    assert shorter.samples(100) == newest[-4:]


def test_only_samples_after_a_time_are_returned() -> None:
    window = Window(60.0, 100)
    for second in range(5):
        window.add(float(second), 100.0 + second)
    assert window.samples(10, 102.0) == [(103.0, 3.0), (104.0, 4.0)]
    assert window.samples(10, 104.0) == []
    assert len(window.samples(10)) == 5


def test_a_window_that_counts_has_the_statistics_of_the_samples_that_are_left() -> None:
    window = CountWindow(10.0, 100)
    assert (window.statistic("count"), window.statistics()) == (0.0, {})
    for now_s, value in enumerate((1.0, 2.0, 6.0)):
        window.add(value, float(now_s))
    window.advance(11.0)
    assert (window.statistic("count"), window.mean(), window.min()) == (1.0, 6.0, 6.0)
    window.advance(12.0)
    assert (window.statistic("count"), window.statistics(), window.last()) == (0.0, {}, 6.0)
    window.add(3.0, 13.0)
    assert (window.statistic("count"), window.mean()) == (1.0, 3.0)
