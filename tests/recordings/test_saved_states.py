"""The states with which a black box begins."""

from __future__ import annotations

import pytest

from robot_health_monitor.core import Level
from robot_health_monitor.core.attachments import SavedMonitor
from robot_health_monitor.recordings.saved_states import SavedStates, announced_level

SAVED = SavedMonitor("r1", 50.0, {"link": {}, "a": {"announced": {"level": "WARN"}}, "b": {"announced": 1}, "c": {}})


def test_the_states_are_those_of_the_signals() -> None:
    states = SavedStates(SAVED, lambda: 51.0)
    assert set(states.restore()) == {"a", "b", "c"}
    assert (states.watched_until_s(), states.wall_s(), states.is_kept, states.keeps_samples) == (
        50.0,
        51.0,
        True,
        False,
    )


@pytest.mark.parametrize(("signal", "level"), [("a", Level.WARN), ("b", Level.OK), ("c", Level.OK), ("d", Level.OK)])
def test_the_announced_level_is_ok_unless_it_is_known(signal: str, level: Level) -> None:
    assert announced_level(SAVED, signal) is level
