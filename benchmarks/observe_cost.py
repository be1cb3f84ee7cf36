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
from typing import Any, Callable, Dict, Iterator, List, Mapping, Sequence

from benchmarks.table import Row, median_ratio
from robot_health_monitor.core import Monitor, Sample, load_config
from robot_health_monitor.core.config.monitor_config import DEFAULT_SIGNALS

Contestant = Callable[[Sequence[float]], None]
"""Takes samples."""

WINDOWS = (60, 6000)
BATCH = 6000
ROUNDS = 25

ALL_FEATURES: Mapping[str, Any] = {
    "statistic": "stddev",
    "scale": 0.9,
    "placeholders": [-0.01],
    "invalid_for_s": 0.5,
    "for_s": 1.0,
    "keep_firing_for_s": 1.0,
    "latch": True,
    "flap_detection": True,
    "repeat_s": 60.0,
    "only_if": {"signal": "charging", "is": 0.0},
}
"""On top of what the default configuration of the battery already has: both bounds, hysteresis, limits, staleness.

The costliest of each: no statistic takes longer than the standard deviation, which is always below both bounds here,
and a rule that fires takes longer than one that does not.
"""


def monitor(window: int, *, sources: bool = False, **features: Any) -> Contestant:
    """Returns a monitor that watches a battery as by default, at a rate that fills the window in 60 s.

    `sources`: with the topics of its signals, whose silence is one alert.
    """
    signal = {**DEFAULT_SIGNALS["battery_level"], "window_s": 60.0, "window_samples": window, **features}
    watching = Monitor(load_config({"signals": {"battery_level": signal, "charging": {}}}))
    if sources:
        watching.expect_sources()
    observe = watching.observe
    period_s = 60.0 / window
    now_s = 0.0
    observe(Sample("charging", 0.0, now_s))

    def take(values: Sequence[float]) -> None:
        nonlocal now_s
        for value in values:
            now_s += period_s
            observe(Sample("battery_level", value, now_s))

    return take


def bare_deque(window: int) -> Contestant:
    """Returns a deque that keeps the window and nothing else."""
    kept: deque[float] = deque(maxlen=window)

    def take(values: Sequence[float]) -> None:
        for value in values:
            kept.append(value)

    return take


def river_statistics(window: int) -> Contestant:
    """Returns river's rolling mean, standard deviation, minimum and maximum."""
    from river import stats, utils

    mean = utils.Rolling(stats.Mean, window_size=window)
    variance = utils.Rolling(stats.Var, window_size=window, ddof=0)
    smallest, largest = stats.RollingMin(window), stats.RollingMax(window)

    def take(values: Sequence[float]) -> None:
        for value in values:
            mean.update(value)
            variance.update(value)
            smallest.update(value)
            largest.update(value)

    return take


def measure(contestants: Mapping[str, Contestant], values: Sequence[float], rounds: int) -> Dict[str, List[float]]:
    """Returns the microseconds per sample of every contestant in every round, after one round to warm up."""
    found: Dict[str, List[float]] = {name: [] for name in contestants}
    for number in range(rounds + 1):
        for name, take in contestants.items():
            begin_s = time.process_time()
            take(values)
            if number:
                found[name].append((time.process_time() - begin_s) / len(values) * 1e6)
    return found


def rows(rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    contestants: Dict[str, Contestant] = {}
    for window in WINDOWS:
        contestants[f"observe {window}"] = monitor(window)
        contestants[f"sources {window}"] = monitor(window, sources=True)
        contestants[f"all {window}"] = monitor(window, **ALL_FEATURES)
        contestants[f"mean {window}"] = monitor(window, statistic="mean")
        contestants[f"forecast {window}"] = monitor(window, statistic="forecast", forecast_s=60.0)
        contestants[f"deque {window}"] = bare_deque(window)
    missing = ""
    try:
        contestants.update((f"river {window}", river_statistics(window)) for window in WINDOWS)
    except ImportError as error:
        missing = f"{error}: pip install -r benchmarks/requirements.txt"
    noise = random.Random(1)
    values = [50.0 + noise.gauss(0.0, 5.0) for _ in range(BATCH)]
    found = measure(contestants, values, rounds)

    def row(contestant: str, key: str, against: str = "", required: float = 0.0, remark: str = "") -> Row:
        what = f"one sample, window {key.split()[1]}"
        if key not in found or (against and against not in found):
            return Row(what, contestant, required=required or None, remark=missing)
        figure = f"{statistics.median(found[key]):.2f} us"
        ratio = median_ratio(found[key], found[against]) if against else None
        return Row(what, contestant, figure, ratio, required or None, remark)

    for window in WINDOWS:
        yield row("deque(maxlen).append", f"deque {window}")
        yield row("river: mean, std, min, max", f"river {window}")
        yield row("Monitor.observe", f"observe {window}", f"river {window}", 0.35, "to river")
        plain = median_ratio(found[f"all {window}"], found[f"observe {window}"])
        remark = f"to river, which is twice what plain observe may cost; {plain:.1f} times plain observe here"
        yield row("Monitor.observe, every feature", f"all {window}", f"river {window}", 1.0, remark)
        yield row("Monitor.observe, with sources", f"sources {window}", f"observe {window}", 1.03, "to observe")
        yield row("Monitor.observe, mean", f"mean {window}")
        yield row("Monitor.observe, forecast", f"forecast {window}", f"mean {window}", 1.5, "to mean")
    names = {"observe": "", "all": ", every feature", "forecast": ", forecast"}
    for name, key in ((f"Monitor.observe{added}", key) for key, added in names.items()):
        yield row(name, f"{key} 6000", f"{key} 60", 1.3, "to window 60")
