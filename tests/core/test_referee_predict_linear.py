"""Prometheus's `predict_linear` and `deriv`, by `promtool test rules`: each prediction of a forecast, and the rate."""

from __future__ import annotations

import json
import random
import subprocess
from pathlib import Path
from typing import Any, Sequence

import pytest
from harness.promtool import PROMTOOL, needs_promtool
from harness.seeds import examples, fixed_seed

from robot_health_monitor.core.judge.forecast import ForecastWindow

pytestmark = [pytest.mark.newest_python, needs_promtool]

TIMELINES = examples(80)
STEPS = 400
WINDOW_S, FORECAST_S = 40, 100
LINES = {
    "all": f"predict_linear(value[{WINDOW_S}s], {FORECAST_S})",
    "older": f"predict_linear(value[{WINDOW_S // 2}s] offset {WINDOW_S // 2}s, {FORECAST_S})",
    "newer": f"predict_linear(value[{WINDOW_S // 2}s], {FORECAST_S})",
    "rate": f"deriv(value[{WINDOW_S}s])",
}
"""Prometheus predicts from the time of evaluation, also with an offset. In 2.42, a range includes both of its ends."""

ALLOWED = 1e-6


def random_values(chance: random.Random) -> list[Any]:
    """Returns a value for each second; None: a gap."""
    size, noise = 10.0 ** chance.uniform(-2, 6), chance.choice((1e-4, 0.01, 1.0))
    value, slope, values = chance.uniform(-size, size), 0.0, []
    gaps = chance.choice((0.02, 0.1, 0.4))
    for _ in range(STEPS):
        if chance.random() < 0.02:
            slope = chance.choice((0.0, chance.uniform(-size, size) / WINDOW_S))
        if chance.random() < 0.005:
            value = chance.uniform(-size, size)
        value += slope
        values.append(None if chance.random() < gaps else value + chance.gauss(0.0, noise * size))
    return values


def series_of(name: str, values: Sequence[Any]) -> list[dict[str, str]]:
    """Returns the input series of promtool: the values, and each prediction and rate where the monitor has one."""
    window = ForecastWindow(float(WINDOW_S), 6000, 0.0, float(FORECAST_S), {})
    texts: dict[str, list[str]] = {"value": [], **{line: [] for line in LINES}}
    for step, value in enumerate(values):
        found: list[Any] = [None] * len(LINES)
        if value is not None:
            window.add(value, float(step))
            lines = window.lines()
            found = [*([None] * 3 if lines is None else [line[0] for line in lines]), window.rate()]
        texts["value"].append("_" if value is None else repr(value))
        for number, line in enumerate(LINES):
            texts[line].append("stale" if found[number] is None else repr(found[number]))
    return [{"series": f'{line}{{timeline="{name}"}}', "values": " ".join(each)} for line, each in texts.items()]


def compare(folder: Path, series: Sequence[dict[str, str]]) -> str:
    """Returns promtool's findings; empty: each prediction is that of `predict_linear`."""
    tests = [
        {"expr": f"abs({line} - {own}) > {ALLOWED} * abs({own})", "eval_time": f"{step}s", "exp_samples": []}
        for own, line in LINES.items()
        for step in range(STEPS)
    ]
    test = {
        "evaluation_interval": "1s",
        "tests": [{"interval": "1s", "input_series": series, "promql_expr_test": tests}],
    }
    (folder / "test.yaml").write_text(json.dumps(test), encoding="utf-8")
    result = subprocess.run(
        [str(PROMTOOL), "test", "rules", "test.yaml"], cwd=folder, capture_output=True, text=True, timeout=600
    )
    return "" if result.returncode == 0 else result.stdout + result.stderr


def test_each_prediction_is_that_of_prometheus_at_every_step(tmp_path: Path) -> None:
    chance = random.Random(fixed_seed())
    series = [each for number in range(TIMELINES) for each in series_of(f"t{number}", random_values(chance))]
    predicted = [text for each in series if not each["series"].startswith("value") for text in each["values"].split()]
    assert sum(text != "stale" for text in predicted) >= TIMELINES * 1_100
    assert compare(tmp_path, series)[:2000] == ""


@pytest.mark.parametrize("line", LINES)
def test_the_referee_notices_a_prediction_that_is_off(tmp_path: Path, line: str) -> None:
    chance = random.Random(fixed_seed())
    series = series_of("t0", random_values(chance))
    number = 1 + list(LINES).index(line)
    words = series[number]["values"].split()
    changed = max(step for step, word in enumerate(words) if word != "stale")
    words[changed] = repr(float(words[changed]) * (1.0 + 3.0 * ALLOWED))
    series[number] = {**series[number], "values": " ".join(words)}
    findings = compare(tmp_path, series)
    assert f"time: {changed // 60}m{changed % 60}s" in findings or f"time: {changed}s" in findings
