"""CPU time of `Monitor.observe` per sample, compared with river's rolling statistics and a bare deque.

All contestants take the same samples, a batch each in turn, round after round; every ratio is the median of the
ratios within a round. What is timed is CPU time of this process, with the loop over the samples. River and the
deque are only updated, never read; the monitor's time includes making the `Sample` and judging it.
"""

from __future__ import annotations

import random
import statistics
import time
from collections import deque
from typing import Any, Callable, Dict, Iterator, Mapping

from benchmarks.table import Row, in_turn, median_ratio
from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.config.monitor_config import DEFAULT_SIGNALS

WINDOWS = (60, 6000)
ROUNDS = 25
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


def _timed(take: Callable[[], None]) -> Callable[[], float]:
    """Returns what measures the CPU time per sample, in us, while all samples are taken."""

    def measure() -> float:
        begin_s = time.process_time()
        take()
        return (time.process_time() - begin_s) / len(VALUES) * 1e6

    return measure


def _deque(window: int) -> Callable[[], float]:
    """Measures a deque that keeps the window and nothing else."""
    kept: deque[float] = deque(maxlen=window)

    def take() -> None:
        for value in VALUES:
            kept.append(value)

    return _timed(take)


def _monitor(window: int, *, sources: bool = False, **features: Any) -> Callable[[], float]:
    """Measures a monitor that watches a battery as by default, at a rate that fills the window in 60 s.

    `sources`: with the topics of its signals, whose silence is one alert.
    """
    signal = {**DEFAULT_SIGNALS["battery_level"], "window_s": 60.0, "window_samples": window, **features}
    watching = Monitor(load_config({"signals": {"battery_level": signal, "charging": {}}}))
    if sources:
        watching.expect_sources()
    observe, period_s, now_s = watching.observe, 60.0 / window, 0.0
    observe(Sample("charging", 0.0, now_s))

    def take() -> None:
        nonlocal now_s
        for value in VALUES:
            now_s += period_s
            observe(Sample("battery_level", value, now_s))

    return _timed(take)


def _river(window: int) -> Callable[[], float]:
    """Measures river's rolling mean, standard deviation, minimum and maximum."""
    from river import stats, utils

    mean = utils.Rolling(stats.Mean, window_size=window)
    variance = utils.Rolling(stats.Var, window_size=window, ddof=0)
    smallest, largest = stats.RollingMin(window), stats.RollingMax(window)

    def take() -> None:
        for value in VALUES:
            mean.update(value)
            variance.update(value)
            smallest.update(value)
            largest.update(value)

    return _timed(take)


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    contestants: Dict[str, Callable[[], float]] = {}
    missing = ""
    for window in WINDOWS:
        contestants[f"deque {window}"] = _deque(window)
        contestants[f"observe {window}"] = _monitor(window)
        contestants[f"sources {window}"] = _monitor(window, sources=True)
        contestants[f"all {window}"] = _monitor(window, **ALL_FEATURES)
        contestants[f"mean {window}"] = _monitor(window, statistic="mean")
        contestants[f"forecast {window}"] = _monitor(window, statistic="forecast", forecast_s=60.0)
        try:
            contestants[f"river {window}"] = _river(window)
        except ImportError as error:
            missing = f"{error}: pip install -r benchmarks/requirements.txt"
    cost_us = in_turn(contestants, rounds)

    def row(contestant: str, key: str, against: str = "", required: float = 0.0, remark: str = "") -> Row:
        what = f"one sample, window {key.split()[1]}"
        if key not in cost_us or (against and against not in cost_us):
            return Row(what, contestant, required=required or None, remark=missing)
        ratio = median_ratio(cost_us[key], cost_us[against]) if against else None
        return Row(what, contestant, f"{statistics.median(cost_us[key]):.2f} us", ratio, required or None, remark)

    for window in WINDOWS:
        yield row("deque(maxlen).append", f"deque {window}")
        yield row("river: mean, std, min, max", f"river {window}")
        yield row("Monitor.observe", f"observe {window}", f"river {window}", 0.35, "to river")
        plain = median_ratio(cost_us[f"all {window}"], cost_us[f"observe {window}"])
        remark = f"to river, which is twice what plain observe may cost; {plain:.1f} times plain observe here"
        yield row("Monitor.observe, every feature", f"all {window}", f"river {window}", 1.0, remark)
        yield row("Monitor.observe, with sources", f"sources {window}", f"observe {window}", 1.03, "to observe")
        yield row("Monitor.observe, mean", f"mean {window}")
        yield row("Monitor.observe, forecast", f"forecast {window}", f"mean {window}", 1.5, "to mean")
    for key, added in {"observe": "", "all": ", every feature", "forecast": ", forecast"}.items():
        yield row(f"Monitor.observe{added}", f"{key} 6000", f"{key} 60", 1.3, "to window 60")
