"""Random timelines for Prometheus's own `promtool test rules` and for the monitor."""

from __future__ import annotations

import json
import random
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Sequence

import pytest

from harness.seeds import examples
from robot_health_monitor.core import Level

TIMELINES = examples(120)
STEPS = 50

PROMTOOL = shutil.which("promtool")

needs_promtool = pytest.mark.skipif(PROMTOOL is None, reason="promtool is not installed (Debian's package prometheus)")


def promtool(folder: Path, *arguments: str) -> str:
    """Returns what promtool reports about files in a folder; empty if it accepts them."""
    assert PROMTOOL is not None
    done = subprocess.run([PROMTOOL, *arguments], cwd=folder, capture_output=True, text=True, check=False, timeout=600)
    return "" if done.returncode == 0 else done.stdout + done.stderr


@dataclass(frozen=True)
class Timeline:
    """A signal's configuration and a value, or None, for every second."""

    name: str
    signal: Mapping[str, Any]
    values: Sequence[float | None]


def random_duration(chance: random.Random) -> float:
    return chance.choice((0.0, 0.0, 1.0, 2.0, 2.5, 3.0, 5.0, 8.0, 0.25))


def random_timeline(chance: random.Random, name: str) -> Timeline:
    signal: dict[str, Any] = {"stale_after_s": 0.0, "hysteresis": chance.choice((0.0, 0.0, 0.5, 1.0, 2.0))}
    low, high = chance.choice((-5.0, 0.0, 20.0)), chance.choice((23.0, 25.5, 30.0))
    if chance.random() < 0.7:
        signal["warn_below"] = low
    if chance.random() < 0.6:
        signal["warn_above"] = high
    if chance.random() < 0.6:
        signal["error_below"] = low - chance.choice((0.0, 0.5, 2.0))
    if chance.random() < 0.6 or len(signal) == 2:
        signal["error_above"] = high + chance.choice((0.0, 0.5, 2.0))
    for key in ("for_s", "keep_firing_for_s", "error_for_s", "error_keep_firing_for_s"):
        if chance.random() < 0.7:
            signal[key] = random_duration(chance)
    bounds = [value for key, value in signal.items() if key.endswith(("below", "above"))]
    values: list[float | None] = []
    value = chance.choice(bounds)
    for _ in range(STEPS):
        kind = chance.random()
        if kind < 0.2:
            values.append(None)
            continue
        if kind < 0.35:
            value = chance.choice(bounds)  # exactly at a bound
        elif kind < 0.45:
            value = chance.choice(bounds) + chance.choice((-1.0, 1.0)) * signal["hysteresis"]  # where it clears
        elif kind < 0.6:
            value = chance.choice(bounds) + chance.choice((-4.0, 4.0))
        else:
            value += chance.choice((-1.0, -0.5, 0.0, 0.5, 1.0))
        values.append(value)
    values[0] = value if values[0] is None else values[0]
    return Timeline(name, signal, values)


def random_timelines(seed: int) -> list[Timeline]:
    chance = random.Random(seed)
    return [random_timeline(chance, f"t{number}") for number in range(TIMELINES)]


def prometheus_rules(timeline: Timeline) -> list[dict[str, Any]]:
    signal, rules = timeline.signal, []
    for level in ("warn", "error"):
        crossed = []
        for side, operator, sign in (("below", "<", 1.0), ("above", ">", -1.0)):
            bound = signal.get(f"{level}_{side}")
            if bound is None:
                continue
            record = f"{timeline.name}:{level}_{side}"
            clears = bound + sign * signal["hysteresis"]
            value = timeline.name
            expression = (
                f"clamp_max(({value} {operator} bool {bound})"
                f" + ({value} {operator} bool {clears}) * ({record} or {value} * 0), 1)"
            )
            rules.append({"record": record, "expr": expression})
            crossed.append(f"{record} == 1")
        if crossed:
            rule: dict[str, Any] = {
                "alert": level.upper(),
                "expr": " or ".join(crossed),
                "labels": {"timeline": timeline.name},
            }
            for key, name in (("for_s", "for"), ("keep_firing_for_s", "keep_firing_for")):
                seconds = signal.get(key, 0.0)
                if level == "error":
                    seconds = signal.get(f"error_{key}", seconds)
                rule[name] = f"{round(seconds * 1000)}ms"
            rules.append(rule)
    return rules


def firing_at(step: int, levels: Mapping[str, Sequence[Level]]) -> list[dict[str, Any]]:
    return [
        {"labels": f'{{alertname="{of_name[step].name}",timeline="{name}"}}', "value": 1}
        for name, of_name in levels.items()
        if of_name[step] is not Level.OK
    ]


def run_promtool(folder: Path, timelines: Sequence[Timeline], levels: Mapping[str, Sequence[Level]]) -> str:
    """Returns promtool's findings: empty when its levels are `levels` at every step."""
    assert PROMTOOL is not None
    rules = {"groups": [{"name": each.name, "rules": prometheus_rules(each)} for each in timelines]}
    # WARN counts where ERROR does not fire.
    level = (
        'max by (alertname, timeline) (ALERTS{alertstate="firing", alertname="ERROR"})'
        ' or (max by (alertname, timeline) (ALERTS{alertstate="firing", alertname="WARN"})'
        ' unless on (timeline) ALERTS{alertstate="firing", alertname="ERROR"})'
    )
    test = {
        "rule_files": ["rules.yaml"],
        "evaluation_interval": "1s",
        "tests": [
            {
                "interval": "1s",
                "input_series": [
                    {
                        "series": each.name,
                        "values": " ".join("_" if value is None else repr(value) for value in each.values),
                    }
                    for each in timelines
                ],
                "promql_expr_test": [
                    {"expr": level, "eval_time": f"{step}s", "exp_samples": firing_at(step, levels)}
                    for step in range(STEPS)
                ],
            }
        ],
    }
    # JSON is YAML, and needs nothing installed to be written.
    (folder / "rules.yaml").write_text(json.dumps(rules))
    (folder / "test.yaml").write_text(json.dumps(test))
    result = subprocess.run(
        [PROMTOOL, "test", "rules", "test.yaml"], cwd=folder, capture_output=True, text=True, check=False, timeout=600
    )
    findings = result.stdout + result.stderr
    assert (result.returncode == 0) == ("SUCCESS" in findings and "FAILED" not in findings), findings[:2000]
    return "" if result.returncode == 0 else findings


def mismatches(findings: str) -> list[tuple[str, str]]:
    """Pairs of (time, timelines that differ) out of promtool's report."""
    found = []
    for part in re.split(r"(?=expr: )", findings)[1:]:
        time = re.search(r"time: (\w+)", part)
        expected, _, got = part.partition("got:")
        labels = re.compile(r'alertname=\\*"(\w+)\\*", timeline=\\*"(\w+)')
        differing = set(labels.findall(expected)) ^ set(labels.findall(got))
        found.append((time.group(1) if time else "?", ", ".join(" ".join(pair[::-1]) for pair in sorted(differing))))
    return found
