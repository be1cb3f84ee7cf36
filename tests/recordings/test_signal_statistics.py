"""Statistics of a signal's samples; expected values by hand."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Sequence

import numpy as np
import pytest

from robot_health_monitor.core.quality import Quality
from robot_health_monitor.core.signal_config import read_signal
from robot_health_monitor.recordings.signal_statistics import SignalStatistics, as_numbers


def statistics(config: Dict[str, Any], *chunks: Sequence[float]) -> SignalStatistics:
    """Returns the statistics of samples that came every second, in chunks."""
    found = SignalStatistics(read_signal("signal", config))
    start = 0
    for chunk in chunks:
        found.add(np.arange(start, start + len(chunk), dtype=float), np.array(chunk, dtype=float))
        start += len(chunk)
    return found


def test_range_and_mean_are_those_of_all_chunks() -> None:
    found = statistics({}, [1.0, 2.0], [9.0], [4.0, 4.0])
    assert (found.samples, found.min, found.max, found.mean) == (5, 1.0, 9.0, 4.0)


def test_without_samples_nothing_is_known() -> None:
    found = statistics({})
    assert (found.samples, found.min, found.mean, found.max, found.longest_gap_s) == (0, None, None, None, None)


def test_bad_samples_count_but_have_no_value() -> None:
    found = statistics({"valid_min": 0.0, "valid_max": 100.0}, [50.0, math.nan, -1.0, 101.0, math.inf, 60.0])
    assert (found.samples, found.bad_samples, found.min, found.mean, found.max) == (6, 4, 50.0, 55.0, 60.0)


def test_values_are_in_the_unit_of_the_signal() -> None:
    found = statistics({"scale": 100.0, "placeholders": [-1.0]}, [0.25, -1.0, 0.75])
    assert (found.bad_samples, found.min, found.mean, found.max) == (1, 25.0, 50.0, 75.0)


def test_the_longest_gap_may_lie_between_two_chunks() -> None:
    found = SignalStatistics(read_signal("signal", {}))
    for times in ([0.0, 1.0], [31.0, 33.0], [34.0]):
        found.add(np.array(times), np.zeros(len(times)))
    assert (found.longest_gap_s, found.first_s) == (30.0, 0.0)


def test_one_sample_has_no_gap() -> None:
    assert statistics({}, [1.0]).longest_gap_s is None


def test_the_mean_of_the_largest_doubles_is_a_double() -> None:
    found = statistics({}, [1.7e308] * 10, [1.7e308] * 3)
    assert found.mean == pytest.approx(1.7e308)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([1, True, 2.5], [1.0, 1.0, 2.5]),
        ([None, 1.0], [math.nan, 1.0]),
        (["12", 1.0], [math.nan, 1.0]),
        ([{"data": 1}, [1]], [math.nan, math.nan]),
        ([10**400, 1], [math.nan, 1.0]),
    ],
)
def test_what_is_no_number_is_nan(values: List[Any], expected: List[float]) -> None:
    assert as_numbers(values).tolist() == pytest.approx(expected, nan_ok=True)


def test_a_sample_is_bad_exactly_where_the_monitor_says_so() -> None:
    config = read_signal("signal", {"scale": -0.1, "placeholders": [-0.01], "valid_min": -5.0, "valid_max": 2.0})
    values = [-0.01, -0.009999999776, 0.0, 50.0, 50.00001, -20.0, -20.1, math.nan, math.inf, -math.inf, 1e308]
    quality = Quality(config)
    expected = [quality.judge(value) for value in values]
    found = SignalStatistics(config).add(np.arange(float(len(values))), np.array(values))
    assert found.tolist() == pytest.approx(expected, nan_ok=True)
