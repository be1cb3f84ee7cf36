"""The window: which samples it keeps, and each statistic by hand."""

from __future__ import annotations

import math
from typing import Iterable, Optional, Tuple

import pytest

from robot_health_monitor.core.config import STATISTICS
from robot_health_monitor.core.window import STATISTIC_OF_WINDOW, Window


def window_of(*values: float, window_s: float = 60.0, window_samples: int = 6000) -> Window:
    """A window with a value per second."""
    return timed(enumerate(values), window_s, window_samples)


def timed(samples: Iterable[Tuple[float, float]], window_s: float = 60.0, window_samples: int = 6000) -> Window:
    window = Window(window_s, window_samples)
    for now_s, value in samples:
        window.add(value, float(now_s))
    return window


def test_every_statistic_of_the_configuration_is_there() -> None:
    assert tuple(STATISTIC_OF_WINDOW) == STATISTICS


def test_the_statistics_of_four_values() -> None:
    # mean 25/4; squared distances 14.0625 + 3.0625 + 0.0625 + 27.5625 = 44.75, over 4
    assert window_of(10.0, 8.0, 6.0, 1.0).statistics() == {
        "last": 1.0,
        "mean": 6.25,
        "min": 1.0,
        "max": 10.0,
        "stddev": math.sqrt(44.75 / 4),
        "rate": -3.0,
        "frequency_hz": 1.0,
    }


def test_an_empty_window_defines_nothing() -> None:
    assert Window(60.0, 10).statistics() == {}


def test_one_sample_has_no_rate_and_no_frequency() -> None:
    assert window_of(7.0).statistics() == {"last": 7.0, "mean": 7.0, "min": 7.0, "max": 7.0, "stddev": 0.0}


def test_samples_of_one_moment_have_no_rate_and_no_frequency() -> None:
    assert {"rate", "frequency_hz"}.isdisjoint(timed([(1.0, 5.0), (1.0, 7.0)]).statistics())


def test_rate_is_from_the_oldest_to_the_newest_whatever_lies_between() -> None:
    assert timed([(0.0, 10.0), (1.0, 500.0), (4.0, 12.0)]).rate() == 0.5


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
    window.resize(window_s, window_samples)
    assert window.mean() == mean


def test_a_cleared_window_starts_again() -> None:
    window = window_of(1e9, -1e9)
    window.clear()
    window.add(3.0, 0.0)
    assert window.statistics() == {"last": 3.0, "mean": 3.0, "min": 3.0, "max": 3.0, "stddev": 0.0}


@pytest.mark.parametrize(
    ("values", "mean", "stddev"),
    [
        ([1.7e308, 1.7e308, -1.7e308, -1.7e308], 0.0, None),  # the deviation is no double
        ([1.7e308, 1.6e308], 1.65e308, None),
        ([5e-324, 5e-324], 5e-324, 0.0),
        ([-0.0, 0.0], 0.0, 0.0),
    ],
)
def test_the_ends_of_the_doubles_give_finite_statistics_or_none(
    values: Iterable[float], mean: float, stddev: Optional[float]
) -> None:
    window = window_of(*values)
    assert window.mean() == pytest.approx(mean)
    assert window.stddev() == stddev
    assert all(math.isfinite(value) for value in window.statistics().values())


def test_a_change_that_is_no_double_has_no_rate() -> None:
    assert window_of(-1.7e308, 1.7e308).rate() is None


def test_an_outlier_that_left_leaves_no_trace() -> None:
    window = window_of(1e300, 1.0, 2.0, 3.0, 4.0, window_samples=4)
    assert (window.mean(), window.stddev()) == (2.5, math.sqrt(1.25))


def test_no_queue_grows_beyond_the_window() -> None:
    window = Window(60.0, 50)
    for step in range(10_000):
        window.add(float(step * (-1) ** step), step * 0.001)
        queues = [getattr(window, name) for name in ("_times", "_values", "_minima", "_maxima")]
        assert max(map(len, queues)) <= 50
