"""The values that a report keeps of a signal: in bounded memory, and without losing an extreme."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.ops.report.plotted_signal import PlottedSignal


def points(envelope: PlottedSignal) -> list[tuple[int, float, float]]:
    """Returns number, smallest and largest value of each bucket with samples."""
    return list(zip(*envelope.columns))


def plot(start_s: float, span_s: float, buckets: int) -> PlottedSignal:
    """Returns an empty plot."""
    return PlottedSignal(read_signal("battery", {}), "", start_s, span_s, buckets)


def filled(envelope: PlottedSignal, *samples: tuple[float, float]) -> PlottedSignal:
    """Adds samples one by one."""
    for time_s, value in samples:
        envelope.add(time_s, value)
    return envelope


def test_a_bucket_keeps_the_smallest_and_the_largest_value() -> None:
    envelope = plot(100.0, 8.0, buckets=4)
    filled(envelope, (100.0, 5.0), (101.0, -3.0), (101.9, 4.0), (107.0, 1.0))
    assert envelope.width_s == pytest.approx(2.0)
    assert points(envelope) == [(0, -3.0, 5.0), (3, 1.0, 1.0)]


def test_the_end_of_the_expected_span_lies_in_the_last_bucket() -> None:
    envelope = filled(plot(0.0, 8.0, buckets=4), (8.0, 1.0))
    assert points(envelope) == [(3, 1.0, 1.0)]


def test_what_is_after_the_end_lies_in_the_last_bucket() -> None:
    envelope = filled(plot(0.0, 4.0, buckets=4), (0.5, 1.0), (7.5, 3.0))
    assert points(envelope) == [(0, 1.0, 1.0), (3, 3.0, 3.0)]


def test_samples_that_are_late_or_too_early_are_not_lost() -> None:
    envelope = filled(plot(10.0, 4.0, buckets=4), (13.5, 1.0), (11.5, 2.0), (3.0, -7.0))
    assert points(envelope) == [(0, -7.0, -7.0), (1, 2.0, 2.0), (3, 1.0, 1.0)]


def test_samples_may_be_out_of_order() -> None:
    envelope = plot(0.0, 4.0, buckets=4)
    filled(envelope, (0.5, 1.0), (2.5, 5.0), (0.6, -1.0), (2.6, 6.0), (0.7, 3.0))
    assert points(envelope) == [(0, -1.0, 3.0), (2, 5.0, 6.0)]


def test_values_that_are_not_finite_are_left_out() -> None:
    envelope = filled(plot(0.0, 4.0, buckets=4), (0.5, math.nan), (1.5, math.inf), (2.5, 1.0))
    assert points(envelope) == [(2, 1.0, 1.0)]


def test_bad_samples_are_kept_by_their_bucket() -> None:
    envelope = plot(0.0, 4.0, buckets=4)
    for time_s in (0.1, 0.2, 3.9):
        envelope.add_bad(time_s)
    assert envelope.bad_times_s == pytest.approx([0.5, 3.5])


def test_a_recording_without_duration_has_a_place() -> None:
    envelope = filled(plot(1_700_000_000.0, 0.0, buckets=4), (1_700_000_000.0, 1.0))
    assert [point[1:] for point in points(envelope)] == [(1.0, 1.0)]


@given(
    st.lists(st.tuples(st.floats(0.0, 1e6), st.floats(-1e300, 1e300)), min_size=1, max_size=200),
)
def test_no_extreme_is_lost_however_long_it_lasts(samples: list[tuple[float, float]]) -> None:
    envelope = filled(plot(0.0, 1.0, buckets=16), *samples)
    found = points(envelope)
    assert len(found) <= 16
    assert min(low for _, low, _ in found) == min(value for _, value in samples)
    assert max(high for _, _, high in found) == max(value for _, value in samples)


def test_a_band_fills_the_buckets_of_its_time() -> None:
    """Of 10 s each, from 100 and 110 on, and of 5 min from 400 on; the bucket of 410 has both values, too."""
    plotted = plot(100.0, 640.0, 64)  # buckets of 10 s
    for band in ((100.0, 10.0, 1.0, 1.5), (110.0, 10.0, 2.0, 2.0), (400.0, 300.0, -5.0, 50.0)):
        plotted.add_band(*band)
    found = points(plotted)
    assert found[:2] == [(0, 1.0, 1.5), (1, 2.0, 2.0)]
    assert found[2:] == [(place, -5.0, 50.0) for place in range(30, 60)]
    assert plotted.levels == [(100.0, "OK")]


def test_a_band_that_is_shorter_than_a_bucket_is_one_point() -> None:
    plotted = plot(0.0, 64_000.0, 64)
    plotted.add_band(10.0, 10.0, 1.0, 2.0)
    plotted.add_band(20.0, 10.0, -1.0, 0.0)
    assert points(plotted) == [(0, -1.0, 2.0)]
