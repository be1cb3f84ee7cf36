"""CPU time of `Monitor.observe` per sample, compared with river's rolling statistics.

All contestants take the same samples, a batch each in turn, round after round; every ratio is the median of the
ratios within a round. What is timed is CPU time of this process, with the loop over the samples. River is only updated,
never read; the monitor's time includes making the `Sample` and judging it.
"""

from __future__ import annotations

import random
import time
from typing import Any, Callable, Iterator, Mapping

from benchmarks.table import Row, beside, side_by_side
from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.config.monitor_config import DEFAULT_SIGNALS

ALL_FEATURES: Mapping[str, Any] = {
    "statistic": "stddev", "scale": 0.9, "placeholders": [-0.01], "invalid_for_s": 0.5, "for_s": 1.0,
    "keep_firing_for_s": 1.0, "latch": True, "flap_detection": True, "repeat_s": 60.0,
    "only_if": {"signal": "charging", "is": 0.0},
}  # fmt: skip
"""On top of what the default configuration of the battery already has: both bounds, hysteresis, limits, staleness.

The costliest of each: no statistic takes longer than the standard deviation, which is always below both bounds here,
and a rule that fires takes longer than one that does not.
"""
_NOISE = random.Random(1)
VALUES = [50.0 + _NOISE.gauss(0.0, 5.0) for _ in range(6000)]
RIVER, PLAIN, ALL = "river: mean, std, min, max", "Monitor.observe", "Monitor.observe, every feature"
SOURCES, MEAN, FORECAST = "Monitor.observe, with sources", "Monitor.observe, mean", "Monitor.observe, forecast"
FEATURES: Mapping[str, Mapping[str, Any]] = {
    PLAIN: {}, ALL: ALL_FEATURES, SOURCES: {}, MEAN: {"statistic": "mean"},
    FORECAST: {"statistic": "forecast", "forecast_s": 60.0},
}  # fmt: skip
LIMITS = {RIVER: {PLAIN: 0.35, ALL: 1.0}, PLAIN: {SOURCES: 1.03}, MEAN: {FORECAST: 1.5}}
"""The largest ratios to each contestant. With every feature, it is twice that of plain observe."""


def _cpu_s(take: Callable[[float], None]) -> float:
    """Returns the CPU time per sample, while all samples are taken."""
    begin_s = time.process_time()
    for value in VALUES:
        take(value)
    return (time.process_time() - begin_s) / len(VALUES)


def _monitor(name: str, window: int) -> Callable[[float], None]:
    """Returns a monitor that watches a battery as by default, at a rate that fills the window in 60 s."""
    signal = {**DEFAULT_SIGNALS["battery_level"], "window_s": 60.0, "window_samples": window, **FEATURES[name]}
    watching = Monitor(load_config({"signals": {"battery_level": signal, "charging": {}}}))
    if name == SOURCES:  # the topics of its signals, whose silence is one alert
        watching.expect_sources()
    observe, period_s, now_s = watching.observe, 60.0 / window, 0.0
    observe(Sample("charging", 0.0, now_s))

    def take(value: float) -> None:
        nonlocal now_s
        now_s += period_s
        observe(Sample("battery_level", value, now_s))

    return take


def _river(window: int) -> Callable[[float], None]:
    """Returns river's rolling mean, standard deviation, minimum and maximum."""
    from river import stats, utils

    mean = utils.Rolling(stats.Mean, window_size=window)
    variance = utils.Rolling(stats.Var, window_size=window, ddof=0)
    smallest, largest = stats.RollingMin(window), stats.RollingMax(window)

    def take(value: float) -> None:
        mean.update(value)
        variance.update(value)
        smallest.update(value)
        largest.update(value)

    return take


def rows(rounds: int = 25) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    takers = {(window, name): _monitor(name, window) for window in (60, 6000) for name in FEATURES}
    takers.update({(window, RIVER): _river(window) for window in (60, 6000)})
    used_s = side_by_side(lambda: {each: _cpu_s(take) for each, take in takers.items()}, rounds)
    for window in (60, 6000):
        for peer, limits in LIMITS.items():
            measured = {name: used_s[window, name] for name in (peer, *limits)}
            for row in beside(f"one sample, window {window}", measured, "us", limits):
                if row.contestant != PLAIN or peer == RIVER:
                    yield row
    for name in (PLAIN, ALL, FORECAST):
        measured = {"window 60": used_s[60, name], name: used_s[6000, name]}
        yield list(beside("one sample, window 6000", measured, "us", 1.3))[1]
