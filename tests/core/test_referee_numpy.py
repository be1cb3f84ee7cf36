"""numpy computes the same windows: a relative error below 1e-9 after many samples.

The error of the mean is relative to the largest value of the window (a mean near 0 has no significant digits), that of
the standard deviation to itself.
"""

from __future__ import annotations

from typing import Callable

import numpy
import pytest
from harness.seeds import examples, fixed_seed

from robot_health_monitor.core.judge.window import Window

pytestmark = pytest.mark.newest_python

SAMPLES = examples(200_000)
ALLOWED = 1e-9

Series = Callable[["numpy.random.Generator"], "numpy.ndarray"]


def around_a_billion(chance: numpy.random.Generator) -> numpy.ndarray:
    return 1e9 + chance.standard_normal(SAMPLES)


def slow_drift(chance: numpy.random.Generator) -> numpy.ndarray:
    return numpy.linspace(0.0, 1e9, SAMPLES) + chance.standard_normal(SAMPLES)


def jumps_of_scale(chance: numpy.random.Generator) -> numpy.ndarray:
    scales = 10.0 ** chance.integers(-9, 10, SAMPLES // 10_000)
    return numpy.repeat(scales, 10_000) * (5.0 + chance.standard_normal(SAMPLES))


def outliers(chance: numpy.random.Generator) -> numpy.ndarray:
    values = 20.0 + chance.standard_normal(SAMPLES)
    values[10_000::100_000] = 1e300
    values[60_000::100_000] = -1e12
    values[30_000::100_000] = 1.7e308
    return values


def nearly_constant(chance: numpy.random.Generator) -> numpy.ndarray:
    values = numpy.full(SAMPLES, 12.6)
    values[::997] += 1e-6
    return values


SERIES: dict[str, Series] = {
    each.__name__: each for each in (around_a_billion, slow_drift, jumps_of_scale, outliers, nearly_constant)
}


@pytest.mark.parametrize("name", SERIES)
def test_statistics_after_many_samples_are_those_of_numpy(name: str) -> None:
    chance = numpy.random.default_rng(fixed_seed())
    values = SERIES[name](chance)
    # The first half is limited by samples at first, the second by time.
    steps_s = numpy.where(numpy.arange(SAMPLES) % 20_000 < 10_000, 0.001, 0.05)
    times = numpy.cumsum(steps_s)
    window_s, window_samples = 60.0, 2000
    window = Window(window_s, window_samples)
    checked = set(chance.integers(0, SAMPLES, 300)) | set(range(0, SAMPLES, 9_973)) | {SAMPLES - 1}

    for index, (value, now_s) in enumerate(zip(values.tolist(), times.tolist())):
        window.add(value, now_s)
        if index % 7 == 0:
            window.stddev()  # as a signal judged by it does: being read must change nothing
        if index in checked:
            first = max(numpy.searchsorted(times, now_s - window_s), index + 1 - window_samples)
            kept = values[first : index + 1]
            found = window.statistics()
            where = f"sample {index}"
            assert len(window) == len(kept), where
            assert (found["min"], found["max"], found["last"]) == (kept.min(), kept.max(), value), where
            reference = kept.astype(numpy.longdouble)
            assert abs(found["mean"] - reference.mean()) <= ALLOWED * numpy.abs(kept).max(), where
            deviation = float(reference.std())
            if abs(kept).max() < 1e150:  # beyond, squares are no doubles
                assert abs(found["stddev"] - deviation) <= ALLOWED * deviation, where
            if len(kept) > 1:
                span_s = now_s - times[first]
                if len(kept) > 2 and abs(kept).max() < 1e290:  # beyond, products are no doubles
                    apart_s = (times[first : index + 1] - now_s).astype(numpy.longdouble)
                    apart_s -= apart_s.mean()
                    slope = float((apart_s * (reference - reference.mean())).sum() / (apart_s * apart_s).sum())
                    assert abs(found["rate"] - slope) <= ALLOWED * numpy.ptp(kept) / span_s, where
                assert found["frequency_hz"] == pytest.approx((len(kept) - 1) / span_s, rel=ALLOWED), where


def test_statistics_are_defined_where_numpy_finds_window_min_s_of_samples() -> None:
    """Samples with gaps: after each gap and each clear, everything but `last` waits for window_min_s."""
    chance = numpy.random.default_rng(fixed_seed())
    steps_s = chance.choice([0.25, 1.0, 3.0], 5_000)
    times = numpy.cumsum(steps_s)
    values = chance.standard_normal(5_000)
    gaps = set(chance.integers(0, 5_000, 60).tolist())
    window = Window(20.0, 6000, window_min_s=12.5)
    began_s = times[0]
    for index, (value, now_s) in enumerate(zip(values.tolist(), times.tolist())):
        if index in gaps:
            window.begin_anew()
            began_s = now_s
        window.add(value, now_s)
        mean, deviation = window.statistic("mean"), window.statistic("stddev")
        if now_s - began_s < 12.5:
            assert (mean, deviation, window.statistic("last")) == (None, None, value), index
        else:
            kept = values[: index + 1][times[: index + 1] >= now_s - 20.0]
            assert mean == pytest.approx(kept.mean()), index
            assert deviation == pytest.approx(kept.std()), index
