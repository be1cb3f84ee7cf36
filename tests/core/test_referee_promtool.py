"""Prometheus's own `promtool test rules` judges the same timelines as the core: the levels agree at every step.

Each timeline is a series of values and steps without one, with random bounds, hysteresis, `for_s` and
`keep_firing_for_s`, for WARN and ERROR apart. Every second is one evaluation of Prometheus and one call of the core.
Prometheus has no hysteresis; a recording rule that reads its own last result says what the document says.

Not comparable, and left out: NaN (a comparison with NaN is false for Prometheus; here a bad sample enters no rule), a
series that ends (Prometheus drops it and its alerts resolve; here a stale signal's rules stand still), latch and
flapping. A step without a sample is comparable: both go on judging the last value.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Callable

import pytest
from harness.promtool import Timeline, mismatches, needs_promtool, random_timelines, run_promtool
from harness.seeds import fixed_seed

from robot_health_monitor.core import Level, Monitor, Sample, load_config

pytestmark = pytest.mark.newest_python


def levels_of_core(timeline: Timeline, also_tick: Callable[[int], bool] = lambda step: step % 3 == 0) -> list[Level]:
    """The true level after each second; a step with a sample is sometimes followed by a tick at the same time."""
    monitor = Monitor(load_config({"signals": {"value": timeline.signal}}))
    levels = []
    for step, value in enumerate(timeline.values):
        now_s = float(step)
        if value is not None:
            monitor.observe(Sample("value", value, now_s))
        if value is None or also_tick(step):
            monitor.tick(now_s)
        levels.append(monitor.report(now_s).statuses["value"].level)
    return levels


@needs_promtool
def test_levels_of_random_timelines_are_those_of_prometheus_at_every_step(tmp_path: Path) -> None:
    timelines = random_timelines(fixed_seed())
    levels = {timeline.name: levels_of_core(timeline) for timeline in timelines}
    seen = {level for of_timeline in levels.values() for level in of_timeline}
    assert seen == {Level.OK, Level.WARN, Level.ERROR}

    findings = run_promtool(tmp_path, timelines, levels)

    if findings:
        differing = mismatches(findings)
        names = {name for _, text in differing for name in re.findall(r"t\d+", text)}
        shown = [timeline for timeline in timelines if timeline.name in names][:3]
        pytest.fail(f"{differing[:10]}\n{shown}\n{findings[:2000] if not differing else ''}")


@needs_promtool
@pytest.mark.parametrize("key", ["for_s", "keep_firing_for_s", "hysteresis"])
def test_the_referee_notices_a_setting_that_is_one_off(tmp_path: Path, key: str) -> None:
    timelines = random_timelines(fixed_seed())[:20]
    levels = {}
    for timeline in timelines:
        # The bounds leave room for a hysteresis of 3.
        wrong = {**timeline.signal, key: timeline.signal.get(key, 0.0) + 1.0}
        levels[timeline.name] = levels_of_core(Timeline(timeline.name, wrong, timeline.values))

    assert mismatches(run_promtool(tmp_path, timelines, levels))
