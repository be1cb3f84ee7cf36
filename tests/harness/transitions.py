"""A transition to write."""

from __future__ import annotations

from typing import Any

from robot_health_monitor.core import Level, Status, Transition


def transition(value: Any = 19.5, to_level: Level = Level.WARN, **fields: Any) -> Transition:
    known = {
        "signal": "battery_level",
        "from_level": Level.OK,
        "to_level": to_level,
        "value": value,
        "statistic": "last",
        "bound": 20.0,
        "now_s": 1000.0,
        "since_s": 688.0,
        "robot": "atlas",
        "fingerprint": "0123456789abcdef",
        "text": "battery_level WARN: 19.5 % is below 20 % (was OK for 312 s)",
        "status": Status("battery_level", to_level, "19.5 % is below 20 %", "atlas", {}),
    }
    return Transition(**{**known, **fields})
