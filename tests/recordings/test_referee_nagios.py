"""Flapping in a recording: what a replay announces is what the formula of Nagios leaves to announce."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

import pytest
from harness.nagios import announcements
from harness.recorded import START_NS, values, write_bag
from harness.seeds import fixed_seed

from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.values.model import Level, Transition
from robot_health_monitor.recordings.middleware import Player
from robot_health_monitor.recordings.reading import Recordings

pytestmark = pytest.mark.newest_python

SECONDS = 120


def test_a_replay_announces_what_the_formula_leaves_to_announce(tmp_path: Path) -> None:
    chance = random.Random(fixed_seed())
    signals, messages, expected = {}, [], {}
    for number in range(60):
        name = f"signal{number}"
        signals[name] = {"warn_below": 20.0, "error_below": 10.0, "flap_detection": True}
        steadiness, numbers = chance.random(), [50.0]
        for _ in range(SECONDS - 1):
            numbers.append(chance.choice((5.0, 15.0, 50.0)) if chance.random() > steadiness else numbers[-1])
        levels = [Level.ERROR if value < 10.0 else Level.WARN if value < 20.0 else Level.OK for value in numbers]
        expected[name] = [
            (second, change) for second, (changes, _) in enumerate(announcements(levels)) for change in changes
        ]
        messages += values(f"/{name}", numbers)
    found: Any = {name: [] for name in signals}
    with Recordings([write_bag(tmp_path / "a.bag", messages)]) as recordings:
        player = Player(recordings)

        def note(event: Any) -> None:
            if isinstance(event, Transition):
                change: tuple[Level, Level] = event.from_level, event.to_level
                found[event.signal].append((round(player.wall_s - START_NS / 1e9), change))

        AlertSystem(player.node("alert_system", {"signals": signals}), {"test": note}, log_alerts=False)
        player.play()
    differing: list[str] = [name for name in signals if found[name] != expected[name]]
    assert differing == [], f"{found[differing[0]]}, expected {expected[differing[0]]}"
