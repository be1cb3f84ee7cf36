"""Random alerts as a history has them: random thresholds, samples with irregular times, ticks at their own times."""

from __future__ import annotations

import math
import random
from typing import Any, Dict, Iterator, List, Tuple

from robot_health_monitor.alert_attempts import RecordedAlert
from robot_health_monitor.core import Sample, load_config
from robot_health_monitor.core.config import MonitorConfig
from robot_health_monitor.core.continuity import MAX_EVIDENCE
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.signal_config import OF_ARRIVALS
from robot_health_monitor.ops.history.rows import pack_samples, unpack_samples

WALL_S = 1_795_324_000.0


def random_config(chance: random.Random, statistic: str) -> Dict[str, Any]:
    """Returns the settings of a signal whose ordinary value is about 50."""
    settings: Dict[str, Any] = {"statistic": statistic, "hysteresis": chance.choice([0.0, 1.0])}
    settings["for_s"] = chance.choice([0.0, 0.0, 1.0, 3.5, 10.0])
    settings["keep_firing_for_s"] = chance.choice([0.0, 0.0, 4.0])
    settings["stale_after_s"] = chance.choice([5.0, 3.0])
    settings["window_s"] = chance.choice([10.0, 20.0, 30.0])
    if statistic == "forecast":
        settings.update(window_s=60.0, forecast_s=60.0, warn_below=20.0)
    elif statistic == "rate":
        settings.update(warn_below=-1.5, error_above=3.0, hysteresis=0.0)
    elif statistic == "stddev":
        settings.update(warn_above=8.0)
    elif statistic == "frequency_hz":
        settings.update(field="", warn_below=0.8, stale_after_s=10.0, hysteresis=0.0)
    elif statistic == "largest_gap_s":
        settings.update(field="", warn_above=2.5, stale_after_s=10.0, hysteresis=0.0)
    else:
        settings.update(warn_below=30.0, error_below=20.0, warn_above=70.0, valid_min=-100.0, valid_max=200.0)
    if statistic == "last" and chance.random() < 0.3:
        settings["invalid_for_s"] = chance.choice([0.0, 2.0])
    return settings


def random_alerts(seed: int, statistic: str) -> Iterator[Tuple[MonitorConfig, RecordedAlert, str]]:
    """Yields each transition of 5 minutes of a signal, with its configuration and its line."""
    chance = random.Random(seed)
    config = load_config({"signals": {"battery": random_config(chance, statistic)}})
    monitor = Monitor(config)
    times = _times(chance, 300.0)
    value, drift, now_s = 50.0, 0.0, 0.0
    before: List[RecordedAlert] = []
    monitor.tick(0.0)
    for now_s, is_tick in times:
        if is_tick:
            transitions = monitor.tick(now_s)
        else:
            if chance.random() < 0.05:
                drift = chance.choice([0.0, -2.0, 2.0, -5.0, (50.0 - value) / 5.0])
            value = min(max(value + drift + chance.gauss(0.0, 0.5), -20.0), 120.0)
            is_bad = "invalid_for_s" in config.signals["battery"].__dict__ and chance.random() < 0.01
            datum = math.nan if is_bad and statistic == "last" else value
            transitions = monitor.observe(Sample("battery", datum, now_s))
        for transition in transitions:
            samples = monitor.window_samples("battery", MAX_EVIDENCE)
            if statistic in OF_ARRIVALS:
                samples = [*monitor.shown_samples("battery", MAX_EVIDENCE - 1), (now_s, transition.value or 0.0)]
            unpacked = unpack_samples(pack_samples([(WALL_S + time_s, each) for time_s, each in samples]))
            stored = [] if unpacked is None else unpacked.samples
            alert = RecordedAlert(
                "battery", transition.from_level, transition.to_level, WALL_S + now_s, transition.value,
                transition.bound, stored, tuple(before[-5:]),
            )  # fmt: skip
            yield config, alert, transition.text
            before.append(alert._replace(before=()))


def _times(chance: random.Random, length_s: float) -> List[Tuple[float, bool]]:
    """Returns times of samples, and of ticks each second that are late by a few ms; some samples are missing."""
    found = [(number + 0.37 + chance.uniform(0.0, 0.004), True) for number in range(int(length_s))]
    period_s, jitter_s = chance.choice([(1.0, 0.0), (1.0, 0.2), (0.5, 0.1), (0.25, 0.0), (1.7, 0.3)])
    now_s = chance.uniform(0.5, 3.0)
    while now_s < length_s:
        found.append((now_s, False))
        now_s += period_s + chance.uniform(-jitter_s, jitter_s)
        if chance.random() < 0.01:
            now_s += chance.uniform(1.0, 9.0)
    return sorted(found)
