"""Prometheus's own promtool forecasts by the exported rules: its alerts are those of the monitor at every step."""

from __future__ import annotations

import json
import random
import subprocess
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import pytest
from harness.promtool import PROMTOOL, needs_promtool
from harness.seeds import fixed_seed

from robot_health_monitor.core import Level, Monitor, MonitorConfig, Sample, load_config
from robot_health_monitor.ops.export.prometheus import export_rules

pytestmark = [pytest.mark.newest_python, needs_promtool]

STEPS = 160
Key = Tuple[str, str]
"""A robot and a signal."""
Values = Mapping[Key, Sequence[float]]
"""A value per second."""
NUMBERS = {"ERROR": 2, "WARN": 1}


def random_signal(chance: random.Random) -> Dict[str, Any]:
    """Returns a forecast with bounds on one side around 0, and any durations."""
    window_s = chance.choice((10.0, 15.0, 20.0, 40.0))
    side, sign = chance.choice((("below", 1.0), ("above", -1.0)))
    signal: Dict[str, Any] = {
        "statistic": "forecast",
        "window_s": window_s,
        "forecast_s": chance.uniform(0.2, 2.7) * window_s,
        "hysteresis": chance.choice((0.0, 0.0, 3.0)),
        "stale_after_s": 0.0,
    }
    if chance.random() < 0.8:
        signal[f"warn_{side}"] = 0.0
    if chance.random() < 0.5 or f"warn_{side}" not in signal:
        signal[f"error_{side}"] = -5.0 * sign
    if chance.random() < 0.5:
        signal["window_min_s"] = chance.uniform(0.0, 1.0) * window_s
    for key in ("for_s", "keep_firing_for_s", "error_for_s", "error_keep_firing_for_s"):
        if chance.random() < 0.5:
            signal[key] = chance.choice((0.0, 1.0, 2.5, 5.0, 8.0))
    return signal


def random_values(chance: random.Random) -> List[float]:
    """Returns a value for each second: slopes, jumps, constants, and noise of any size."""
    noise = chance.choice((0.0, 0.01, 0.3, 2.0))
    value, slope, values = chance.uniform(-30.0, 30.0), 0.0, []
    for _ in range(STEPS):
        if chance.random() < 0.06:
            slope = chance.choice((0.0, -value / chance.uniform(10.0, 60.0), chance.uniform(-1.0, 1.0)))
        if chance.random() < 0.01:
            value = chance.uniform(-30.0, 30.0)
        value += slope
        values.append(value + chance.gauss(0.0, noise))
    return values


def levels_of(config: MonitorConfig, values: Values) -> List[Dict[Key, Level]]:
    """Returns the level of each signal of each robot after each second."""
    monitors = {robot: Monitor(config) for robot, _ in values}
    levels: List[Dict[Key, Level]] = []
    for step in range(STEPS):
        now_s = float(step)
        for (robot, name), of_signal in values.items():
            monitors[robot].observe(Sample(name, of_signal[step], now_s))
        of_step: Dict[Key, Level] = {}
        for robot, monitor in monitors.items():
            monitor.tick(now_s)
            of_step.update({(robot, name): found.level for name, found in monitor.judgements(now_s).items()})
        levels.append(of_step)
    return levels


def compare(folder: Path, config: MonitorConfig, values: Values, expected: List[Dict[Key, Level]]) -> str:
    """Returns promtool's findings; empty if the worst alert of each signal is as expected after each second."""
    (folder / "rules.yaml").write_text(export_rules(config, interval_s=1.0).text, encoding="utf-8")
    worst = " or ".join(
        f'max by (robot, signal) (ALERTS{{alertstate="firing", level="{level}"}} * {number})'
        for level, number in NUMBERS.items()
    )
    test = {
        "rule_files": ["rules.yaml"],
        "evaluation_interval": "1s",
        "tests": [
            {
                "interval": "1s",
                "input_series": [
                    {
                        "series": f'robot_health_latest{{robot="{robot}", signal="{name}", instance="a:9090"}}',
                        "values": " ".join(map(repr, of_signal)),
                    }
                    for (robot, name), of_signal in values.items()
                ],
                "promql_expr_test": [
                    {
                        "expr": worst,
                        "eval_time": f"{step}s",
                        "exp_samples": [
                            {"labels": f'{{robot="{robot}", signal="{name}"}}', "value": NUMBERS[level.name]}
                            for (robot, name), level in of_step.items()
                            if level is not Level.OK
                        ],
                    }
                    for step, of_step in enumerate(expected)
                ],
            }
        ],
    }
    (folder / "test.yaml").write_text(json.dumps(test), encoding="utf-8")
    done = subprocess.run(
        [str(PROMTOOL), "test", "rules", "test.yaml"], cwd=folder, capture_output=True, text=True, timeout=600
    )
    return "" if done.returncode == 0 else done.stdout + done.stderr


def random_robots(chance: random.Random, config: MonitorConfig, robots: int) -> Values:
    return {(f"r{number}", name): random_values(chance) for number in range(robots) for name in config.signals}


def test_the_exported_forecast_alerts_when_the_monitor_does_at_every_step(tmp_path: Path) -> None:
    chance = random.Random(fixed_seed())
    config = load_config({"signals": {f"s{number}": random_signal(chance) for number in range(24)}})
    values = random_robots(chance, config, robots=10)
    expected = levels_of(config, values)
    counts = {level: sum(list(of_step.values()).count(level) for of_step in expected) for level in Level}
    assert min(counts[level] for level in (Level.OK, Level.WARN, Level.ERROR)) > 2_000
    assert sum(counts.values()) >= 36_000

    assert compare(tmp_path, config, values, expected)[:3000] == ""


@pytest.mark.parametrize(("key", "factor", "more"), [("forecast_s", 0.9, 0.0), ("for_s", 1.0, 1.0)])
def test_the_referee_notices_a_setting_that_is_off(tmp_path: Path, key: str, factor: float, more: float) -> None:
    chance = random.Random(fixed_seed())
    signals = {f"s{number}": {**random_signal(chance), "window_min_s": 5.0} for number in range(5)}
    config = load_config({"signals": signals})
    values = random_robots(chance, config, robots=4)
    off = {
        name: {**signal, key: getattr(config.signals[name], key) * factor + more} for name, signal in signals.items()
    }
    assert compare(tmp_path, config, values, levels_of(load_config({"signals": off}), values))
