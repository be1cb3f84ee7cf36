"""A timeline of topics that fall silent, and of a known cause; `tests/data/silence_alerts.txt` has the alerts."""

from __future__ import annotations

from typing import Any, Iterator

from harness.field_timeline import JOINTS, Published, Scene
from harness.port_conformance import DIAGNOSTICS, FLOAT32, START_S, STATUS

SIGNALS: dict[str, Any] = {
    "speed": {
        "topic": "speed", "type": FLOAT32, "warn_below": 0.5, "for_s": 1.0, "stale_after_s": 3.0,
        "depends_on": ["drivers[motor]"],
    },
    "right": {"topic": "joints", "type": JOINTS, "field": 'effort["right"]', "stale_after_s": 3.0},
    "left": {"topic": "joints", "type": JOINTS, "field": 'effort["left"]', "stale_after_s": 3.0, "warn_above": 9.0},
    "odom": {"topic": "odom", "type": FLOAT32, "stale_after_s": 3.0},
    "slow": {"topic": "slow", "type": FLOAT32, "stale_after_s": 8.0},
    "drivers": {"topic": "drivers", "type": DIAGNOSTICS, "field": 'status["*"]', "stale_after_s": 0.0},
}  # fmt: skip


def messages() -> list[Published]:
    """Returns all messages in the order of their times."""
    return sorted((*_motion(), *_driver()), key=lambda published: published.time_s)


def _motion() -> Iterator[Published]:
    """The node of joints, odom and slow is dead from 4 to 12 s; then one joint is missing, and odom from 16 s on."""
    for step in range(24):
        time_s = START_S + step + 0.25
        if step < 4 or step >= 12:
            names = ["left", "right"] if step < 4 else ["left"]
            effort = [10.0 if step == 13 else 1.0] * len(names)
            yield Published(time_s, "/joints", JOINTS, {"name": names, "effort": effort})
        if step < 4 or 12 <= step < 16:
            yield Published(time_s, "/odom", FLOAT32, {"data": 1.0})
        if step in (3, 12, 18):
            yield Published(time_s, "/slow", FLOAT32, {"data": 1.0})


def _driver() -> Iterator[Published]:
    """The motor is hot from 5 to 9 s, and the robot stands still from 6 to 20 s."""
    for step in range(24):
        time_s = START_S + step + (0.5 if step else 0.0)  # a replay ticks from its first message on
        status = {**STATUS, "name": "motor", "level": 2 if 5 <= step < 9 else 0, "message": "hot"}
        yield Published(time_s, "/drivers", DIAGNOSTICS, {"status": [status]})
        yield Published(time_s, "/speed", FLOAT32, {"data": 0.0 if 6 <= step < 20 else 1.0})


SILENCE = Scene(SIGNALS, messages(), 26.0)
