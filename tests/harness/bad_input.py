"""A timeline of what broken drivers publish, in the shape of ROS 2; `tests/data/bad_input_alerts.txt` has the alerts.

Only what every middleware can carry; `tests/rosbridge/test_bad_fields.py` has what only JSON can.
"""

from __future__ import annotations

import math
from typing import Any, Iterator, Mapping

from harness.field_timeline import BATTERY, JOINTS, Published, Scene, status
from harness.port_conformance import DIAGNOSTICS, START_S

SIGNALS: dict[str, Any] = {
    "age": {"topic": "battery", "type": BATTERY, "field": "header.stamp", "warn_above": 5.0, "warn_below": -5.0},
    "cells": {
        "topic": "battery", "type": BATTERY, "field": "cell_voltage[*]", "unit": "V", "warn_below": 3.25,
        "max_elements": 4, "stale_after_s": 3.0,
    },
    "lowest": {
        "topic": "battery", "type": BATTERY, "field": "cell_voltage[*]", "unit": "V", "reduce": "min",
        "warn_below": 3.25, "stale_after_s": 3.0,
    },
    "wheels": {
        "topic": "joints", "type": JOINTS, "field": 'effort["wheel_*"]', "warn_above": 9.0, "max_elements": 3,
        "stale_after_s": 4.0,
    },
    "left": {"topic": "joints", "type": JOINTS, "field": 'effort["wheel_left"]', "warn_above": 9.0},
    "drivers": {
        "topic": "drivers", "type": DIAGNOSTICS, "field": 'status["*"]', "max_elements": 4, "stale_after_s": 3.0,
    },
}  # fmt: skip


def messages() -> list[Published]:
    """Returns all messages in the order of their times."""
    return sorted((*_batteries(), *_joints(), *_drivers()), key=lambda published: published.time_s)


def _batteries() -> Iterator[Published]:
    stamps: dict[int, dict[str, int]] = {
        4: {"sec": 0, "nanosec": 0},
        5: {"sec": 1_000_000, "nanosec": 999_999_999},
        6: {"sec": 0, "nanosec": 1},
    }
    cells: dict[int, list[float]] = {
        1: [3.75] * 10_000,
        2: [3.75] * 10_001,
        3: [],
        5: [3.75, math.inf, -math.inf, 0.0],
        6: [math.nan],
        7: [3.0],
    }
    for step in range(12):
        time_s = START_S + step + (0.25 if step else 0.0)
        stamp = stamps.get(step, {"sec": int(time_s), "nanosec": 0})
        message = {"header": {"stamp": stamp}, "cell_voltage": cells.get(step, [3.75, 3.75, 3.75])}
        yield Published(time_s, "/battery", BATTERY, message)


def _joints() -> Iterator[Published]:
    names: dict[int, list[str]] = {
        1: ["wheel_left"],
        2: [],
        3: ["wheel_left", "wheel_left"],
        4: ["wheel_\x07\n", "", "wheel_" + "x" * 500],
        5: [f"wheel_{number}" for number in range(50)],
        6: [f"wheel_{number}" for number in range(10_001)],
        7: ["wheel_right", "wheel_left", "wheel_caf\u00e9"],
    }
    efforts: dict[int, list[float]] = {1: [1.0, 2.0], 2: [1.0, 2.0], 3: [1.0, 50.0], 7: [2.0, 10.0, 3.0]}
    for step in range(12):
        name = names.get(step, ["wheel_left", "wheel_right"])
        message = {"name": name, "effort": efforts.get(step, [1.0] * len(name))}
        yield Published(START_S + step + 0.25, "/joints", JOINTS, message)


def _drivers() -> Iterator[Published]:
    """The second driver renames itself with each message."""
    for step in range(12):
        statuses: list[Mapping[str, Any]] = [status("motor", 0), status(f"driver {step}", 0)]
        if step == 3:
            statuses[0] = status("motor", 7)
        if step == 4:
            statuses.append(status("", 2))
        if step == 5:
            statuses[0] = {**status("motor", 2), "message": "a\x1b[31m\n" + "b" * 10_000}
        if step == 6:
            statuses = [status(f"new {number}", 1) for number in range(300)]
        yield Published(START_S + step + 0.25, "/drivers", DIAGNOSTICS, {"status": statuses})


BAD_INPUT = Scene(SIGNALS, messages(), 14.0)
