"""Prometheus's own `promtool test rules` judges what a recording holds: the alerts of its replay agree at every step.

tests/core/test_referee_promtool.py says what is comparable.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Sequence

import pytest
from harness.promtool import (
    STEPS,
    Timeline,
    mismatches,
    needs_promtool,
    random_timelines,
    run_promtool,
)
from harness.recorded import START_NS, Recorded, write_bag, write_mcap
from harness.seeds import fixed_seed

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.values.model import Level, Transition
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

pytestmark = pytest.mark.newest_python


def levels_of_replay(path: str, timelines: Sequence[Timeline]) -> dict[str, list[Level]]:
    """Returns the announced level of each timeline at every second."""
    levels: dict[str, list[Level]] = {timeline.name: [Level.OK] * STEPS for timeline in timelines}
    with Recordings([path]) as recordings:
        player = Player(recordings)

        def note(event: Any) -> None:
            if isinstance(event, Transition):
                step = round(player.wall_s - START_NS / 1e9)
                levels[event.signal][step:] = [event.to_level] * (STEPS - step)

        signals = {timeline.name: {**timeline.signal, "topic": timeline.name} for timeline in timelines}
        AlertSystem(player.node("alert_system", {"signals": signals}), {"test": note}, log_alerts=False)
        player.play()
        assert player.problems == []
    return levels


@needs_promtool
def test_levels_of_a_replay_are_those_of_prometheus_at_every_step(tmp_path: Path) -> None:
    timelines = random_timelines(fixed_seed() + 1)  # others than those of tests/core
    messages = [Recorded(float(step), "/clock_tick", 0.0) for step in range(STEPS)]
    for timeline in timelines:
        samples = enumerate(timeline.values)
        messages += [Recorded(float(step), f"/{timeline.name}", value) for step, value in samples if value is not None]
    levels = levels_of_replay(write_bag(tmp_path / "a.bag", messages), timelines)
    assert levels_of_replay(write_mcap(tmp_path / "a.mcap", messages), timelines) == levels
    assert {level for of_one in levels.values() for level in of_one} == {Level.OK, Level.WARN, Level.ERROR}
    findings = run_promtool(tmp_path, timelines, levels)
    assert findings == "", mismatches(findings)[:10]
