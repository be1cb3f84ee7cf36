"""Forecasts: three least-squares lines, of which the most cautious counts."""

from __future__ import annotations

import math
import random
from fractions import Fraction
from typing import Mapping, Sequence

import pytest
from harness.seeds import examples, fixed_seed

from robot_health_monitor.core.judge.forecast import ForecastWindow, LineOfRange
from robot_health_monitor.core.values.model import Forecast

NONE: Mapping[str, float] = {}
BELOW, ABOVE = {"warn_below": 20.0}, {"warn_above": 80.0, "error_above": 90.0}


def forecast_of(
    samples: Sequence[tuple[float, float]], window_s: float, forecast_s: float, bounds: Mapping[str, float] = NONE
) -> Forecast | None:
    """Returns the forecast after samples of (time in s, value)."""
    window = ForecastWindow(window_s, 6000, 0.0, forecast_s, bounds)
    for at_s, value in samples:
        window.add(value, at_s)
    return window.outlook()


def test_a_straight_line_goes_on() -> None:
    discharge = [(float(second), 80.0 - 0.5 * second) for second in range(21)]
    assert forecast_of(discharge, 20.0, 40.0) == Forecast(pytest.approx(50.0), pytest.approx(-0.5), 40.0, None, None)


def test_a_constant_stays_exactly_what_it_is() -> None:
    assert forecast_of([(0.1 * step, 12.6) for step in range(300)], 20.0, 60.0) == Forecast(12.6, 0.0, 60.0, None, None)


def test_the_most_cautious_of_three_lines_counts() -> None:
    """0 to 10 s falling by 2 per s, then by 1: at 20 s the older half predicts -20 - 20, the newer -10 - 10 = -20."""
    bend = [(float(second), 20.0 - 2.0 * second if second < 10 else 10.0 - second) for second in range(21)]
    below, above = (forecast_of(bend, 20.0, 10.0, bounds) for bounds in (BELOW, ABOVE))
    assert below is not None and above is not None
    assert (below.value, below.slope_per_s) == (pytest.approx(-20.0), pytest.approx(-1.0))
    assert (above.value, above.slope_per_s) == (pytest.approx(-40.0), pytest.approx(-2.0))


def test_without_bounds_the_line_of_the_window_counts() -> None:
    """0 to 10 s flat at 10, then falling by 1 per s."""
    bend = [(float(second), 10.0 - max(0.0, second - 10.0)) for second in range(21)]
    neither = forecast_of(bend, 20.0, 10.0, NONE)
    assert neither is not None
    # By hand: sum of (t - 10) * v over all is -385 with the squares 770, and the mean of v is 155 / 21.
    assert neither.value == pytest.approx(155.0 / 21.0 - 0.5 * 20.0)


@pytest.mark.parametrize(
    ("sign", "bounds", "expected"),
    [
        (1.0, ABOVE, 20.0),  # the older half predicts 10, the newer 30
        (-1.0, BELOW, -20.0),
        (1.0, BELOW, 30.0),  # the most cautious line does not contradict
        (-1.0, ABOVE, -30.0),
    ],
)
def test_a_forecast_never_contradicts_the_present(sign: float, bounds: dict[str, float], expected: float) -> None:
    """10, and from 10 s on 1 more per s, which is 20 at the end: a motor that begins to warm up."""
    bend = [(float(second), sign * (10.0 + max(0.0, second - 10.0))) for second in range(21)]
    found = forecast_of(bend, 20.0, 10.0, bounds)
    assert found is not None and found.value == pytest.approx(expected)
    if abs(expected) == 20.0:
        assert found == Forecast(expected, 0.0, 10.0, None, None)


def test_while_the_window_falls_a_forecast_may_lie_below_the_latest_value() -> None:
    """A peak that is over: the line of the whole window falls, so nothing is known of a rise."""
    peak = [(float(second), 40.0 - second) for second in range(20)] + [(20.0, 70.0)]
    found = forecast_of(peak, 20.0, 10.0, ABOVE)
    assert found is not None and found.value < 20.0


@pytest.mark.parametrize(
    ("times", "is_defined"),
    [
        ([0, 1, 2, 3, 4, 6, 7, 8, 9, 10], True),
        ([1, 2, 3, 4, 6, 7, 8, 9, 10], False),  # four are older than half a window
        ([1, 2, 3, 4, 5, 7, 8, 9, 10], True),  # 5 belongs to both halves
        ([0, 1, 2, 3, 4, 7, 8, 9, 10], False),  # four in the newer half
        ([0, 0, 0, 0, 0, 6, 7, 8, 9, 10], False),  # no line goes through samples of one time
        ([], False),
    ],
)
def test_each_half_needs_five_samples(times: list[int], is_defined: bool) -> None:
    assert (forecast_of([(float(at_s), 1.0) for at_s in times], 10.0, 5.0) is not None) is is_defined


def test_a_sample_that_has_left_counts_no_more() -> None:
    """An outlier of 1e300 is the first sample, then the middle one, then leaves: nothing of it stays."""
    window = ForecastWindow(20.0, 6000, 0.0, 10.0, NONE)
    for second in range(100):
        window.add(1e300 if second in (0, 50) else 5.0, float(second))
    assert window.outlook() == Forecast(5.0, 0.0, 10.0, None, None)


def test_an_overflow_is_no_forecast() -> None:
    assert forecast_of([(float(second), (-1.0) ** second * 1.7e308) for second in range(21)], 20.0, 60.0) is None
    assert forecast_of([(float(second), second * 1e307) for second in range(17)], 16.0, 48.0) is None


def test_the_most_samples_limit_both_halves() -> None:
    window = ForecastWindow(1000.0, 10, 0.0, 10.0, NONE)
    for second in range(50):
        window.add(float(second), float(second))
    assert (len(window), window.outlook()) == (10, None)  # all ten are of the newer half
    shorter = ForecastWindow(8.0, 100, 0.0, 10.0, NONE)
    shorter.take_over(window)
    assert shorter.outlook() == Forecast(pytest.approx(59.0), pytest.approx(1.0), 10.0, None, None)


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        ({"warn_below": 20.0}, 50.0),
        ({"warn_below": 25.0, "error_below": 20.0}, 40.0),  # the nearest
        ({"warn_below": 60.0, "error_below": 20.0}, 50.0),  # 60 lies behind
        ({"warn_below": 60.0}, None),
        ({"warn_above": 50.0}, None),
        ({"warn_below": -104.0}, 298.0),
        ({"warn_below": -106.0}, None),  # in 302 s, beyond ten times 30 s
        ({}, None),
    ],
)
def test_the_time_to_a_bound_is_that_of_the_line(bounds: dict[str, float], expected: float | None) -> None:
    """45 at the end, 0.5 less per s."""
    found = forecast_of([(float(second), 55.0 - 0.5 * second) for second in range(21)], 20.0, 30.0, bounds)
    assert found is not None
    assert found.time_to_bound_s == (expected and pytest.approx(expected))
    assert (found.bound is None) is (expected is None)
    assert found.bound is None or found.bound == pytest.approx(45.0 - 0.5 * found.time_to_bound_s)


def test_a_flat_line_reaches_no_bound() -> None:
    found = forecast_of([(float(second), 30.0) for second in range(21)], 20.0, 30.0, BELOW)
    assert found == Forecast(30.0, 0.0, 30.0, None, None)


def exact_line(samples: Sequence[tuple[float, float]], at_s: float) -> tuple[float, float]:
    """Returns prediction and slope of a line in exact arithmetic."""
    times, values = [Fraction(at) for at, _ in samples], [Fraction(value) for _, value in samples]
    mean_s, mean = sum(times) / len(times), sum(values) / len(values)
    products = sum((at - mean_s) * (value - mean) for at, value in zip(times, values))
    slope = products / sum((at - mean_s) ** 2 for at in times)
    return float(mean + slope * (Fraction(at_s) - mean_s)), float(slope)


def test_a_range_whose_samples_come_and_leave_has_the_line_of_those_that_are_left() -> None:
    samples = [(1000.0 + 0.5 * step, 1e9 + (7 * step) % 5 - 0.25 * step) for step in range(30)]
    for step in (1, 2, 7):
        for length in (5, 8, 20):
            line = LineOfRange(*zip(*samples))
            for begin in range(0, 30 - length, step):
                end = begin + length
                at_s = samples[-1][0] + 10.0
                expected = exact_line(samples[begin:end], at_s)
                assert line.line(begin, end, at_s) == (
                    pytest.approx(expected[0], rel=1e-15),
                    pytest.approx(expected[1]),
                )


@pytest.mark.newest_python
def test_random_windows_agree_with_numpy() -> None:
    """Values up to 1e12, times up to 1e9, gaps, several samples at one time, outliers."""
    import numpy

    chance = random.Random(fixed_seed())
    compared = 0
    robots = examples(40)
    for _ in range(robots):
        window_s = chance.choice((10.0, 60.0, 600.0))
        forecast_s = chance.uniform(0.1, 3.0) * window_s
        bounds, choose = chance.choice(((NONE, None), (BELOW, max), (ABOVE, min)))
        window = ForecastWindow(window_s, 6000, 0.0, forecast_s, bounds)
        size, step_s, now_s = (
            10.0 ** chance.uniform(-3, 12),
            window_s / chance.choice((16, 32, 128)),
            2.0 ** chance.uniform(0, 30),
        )
        now_s = float(math.floor(now_s))
        base, trend = (
            chance.uniform(-size, size),
            chance.choice((0.0, 1e-3, 1.0)) * chance.uniform(-size, size) / window_s,
        )
        noise = chance.choice((1e-6, 1e-3, 1.0)) * size
        times: list[float] = []
        values: list[float] = []
        for step in range(250):
            now_s += chance.choice((step_s,) * 8 + (0.0, 3.0 * step_s))
            value = base + trend * step * step_s + chance.gauss(0.0, noise)
            times.append(now_s)
            values.append(value * 1e6 if chance.random() < 0.002 else value)
            window.add(values[-1], now_s)
            if step % 3:
                continue
            found = window.outlook()
            x, y = numpy.array(times) - now_s, numpy.array(values)
            parts = (x >= -window_s, (x >= -window_s) & (x <= -window_s / 2.0), x >= -window_s / 2.0)
            if min(part.sum() for part in parts) < 5 or any(numpy.ptp(x[part]) == 0.0 for part in parts):
                assert found is None
                continue
            lines = [numpy.polyfit(x[part], y[part], 1) for part in parts]
            predictions = [slope * forecast_s + offset for slope, offset in lines]
            expected = predictions[0] if choose is None else choose(predictions)
            assert found is not None
            scale = max(abs(y[parts[0]]).max(), *map(abs, predictions))
            if abs(lines[0][0]) * window_s <= 1e-9 * scale:
                continue  # whether it rises is a matter of rounding
            if choose is not None and bool(lines[0][0] > 0.0) is (choose is min):
                expected = (max if choose is min else min)(expected, values[-1])
            assert abs(found.value - expected) <= 1e-9 * scale
            compared += 1
    assert compared >= 50 * robots
