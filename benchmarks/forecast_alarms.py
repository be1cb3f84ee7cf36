"""How often a forecast alerts falsely, and how early it warns, in simulated robots with fixed seeds."""

from __future__ import annotations

import math
import random
import statistics
from typing import Any, Callable, Iterator, List

from benchmarks.table import Row
from robot_health_monitor.core import Level, Monitor, Sample, load_config

HOURS = 1000
WINDOW_S, FORECAST_S = 600.0, 1800.0
SLOW_NOISE = (3.0, 200.0)
"""Noise of 3 % that is correlated over 200 s looks like a trend for longer than `for_s`."""

_Values = Iterator[float]
"""One value per second."""


def rows() -> Iterator[Row]:
    """Yields the figures."""
    for noise in (0.5, 1.0, 3.0):
        for correlation_s in (20.0, 60.0, 200.0):
            values = add(constant(55.0), correlated(noise, correlation_s, random.Random(f"{noise} {correlation_s}")))
            alerts = count_alerts(values, HOURS * 3600, warn_below=40.0)
            what = f"55 %, noise {noise:g} % over {correlation_s:g} s, bound 40 %"
            most = 10.0 if (noise, correlation_s) == SLOW_NOISE else 0.0
            yield Row(what, "forecast, for_s 300", f"{alerts} alerts in {HOURS} h", alerts, most, "false alerts")
    for what, make, settings, seconds in SCENES:
        alerts = sum(count_alerts(make(random.Random(f"{what} {seed}")), seconds, **settings) for seed in range(50))
        yield Row(what, "forecast, for_s 300", f"{alerts} alerts in 50 runs", alerts, 0.0, "false alerts")
    leads_s = sorted(lead_s(random.Random(seed)) for seed in range(50))
    median_s = statistics.median(leads_s)
    figure = f"{median_s:.0f} s, the worst of 50 {leads_s[0]:.0f} s"
    what = "discharge of 1 %/min, noise 0.5 %, bound 20 %, lead"
    yield Row(
        what, "forecast, for_s 60", figure, 0.8 * FORECAST_S / median_s, 1.0, f"80 % of {FORECAST_S:g} s, to the median"
    )


def count_alerts(values: _Values, seconds: int, **settings: Any) -> int:
    """Returns how often a forecast warns."""
    return sum(
        transition.to_level is Level.WARN for transition in transitions(values, seconds, for_s=300.0, **settings)
    )


def lead_s(chance: random.Random) -> float:
    """Returns how long before the bound is crossed the forecast warns, in s."""
    values = add(ramp(100.0, -1.0 / 60.0), correlated(0.5, 1.0, chance))
    crossed_s = (100.0 - 20.0) * 60.0
    found = transitions(values, int(crossed_s), for_s=60.0, warn_below=20.0)
    first = next((transition.now_s for transition in found if transition.to_level is Level.WARN), crossed_s)
    return crossed_s - first


def transitions(values: _Values, seconds: int, **settings: Any) -> Iterator[Any]:
    """Yields the transitions of a forecast."""
    signal = {"statistic": "forecast", "window_s": WINDOW_S, "forecast_s": FORECAST_S, **settings}
    monitor = Monitor(load_config({"signals": {"value": signal}}))
    for second, value in zip(range(seconds), values):
        yield from monitor.observe(Sample("value", value, float(second)))


def constant(value: float) -> _Values:
    """Yields the same value."""
    while True:
        yield value


def ramp(start: float, per_s: float, end: float = -math.inf) -> _Values:
    """Yields a straight line, which ends at `end` if it rises."""
    value = start
    while True:
        yield value
        value = min(value + per_s, end) if per_s > 0.0 else value + per_s


def correlated(deviation: float, correlation_s: float, chance: random.Random) -> _Values:
    """Yields AR(1) noise."""
    kept = math.exp(-1.0 / correlation_s)
    new = deviation * math.sqrt(1.0 - kept * kept)
    value = chance.gauss(0.0, deviation)
    while True:
        yield value
        value = kept * value + chance.gauss(0.0, new)


def add(*parts: _Values) -> _Values:
    """Yields the sums."""
    return map(sum, zip(*parts))


def after(seconds: int, before: float, then: float) -> _Values:
    """Yields one value, and after some seconds another one."""
    for _ in range(seconds):
        yield before
    yield from constant(then)


def approach(end: float, start: float, time_s: float) -> _Values:
    """Yields an exponential approach."""
    distance, kept = start - end, math.exp(-1.0 / time_s)
    while True:
        yield end + distance
        distance *= kept


def _with_noise(values: Callable[[], _Values]) -> Callable[[random.Random], _Values]:
    return lambda chance: add(values(), correlated(0.5, 20.0, chance))


_BATTERY = {"warn_below": 20.0}
SCENES: List[Any] = [
    (
        "70 degrees approached in 1800 s, bound 80",
        _with_noise(lambda: approach(70.0, 25.0, 1800.0)),
        {"warn_above": 80.0},
        14_400,
    ),
    (
        "70 degrees approached in 3600 s, bound 80",
        _with_noise(lambda: approach(70.0, 25.0, 3600.0)),
        {"warn_above": 80.0},
        14_400,
    ),
    ("charging from 21 to 100 %, bound 20 %", _with_noise(lambda: ramp(25.0, 1.0 / 60.0, 100.0)), _BATTERY, 7_200),
    ("battery swapped, 25 to 100 %, bound 20 %", _with_noise(lambda: after(3600, 30.0, 100.0)), _BATTERY, 7_200),
    ("battery swapped, 100 to 60 %, bound 20 %", _with_noise(lambda: after(3600, 100.0, 60.0)), _BATTERY, 7_200),
    ("parked at 60 %, bound 20 %", _with_noise(lambda: constant(60.0)), _BATTERY, 14_400),
    ("a night, 0.2 % per hour less, bound 20 %", _with_noise(lambda: ramp(90.0, -0.2 / 3600.0)), _BATTERY, 43_200),
]
"""What it is, its values, its bound, and its length in s."""
