"""A timeline for every kind of field and every statistic: what a robot publishes, as mappings in the shape of ROS 2.

Every number is exact in 32 bits, and every time lies beside the ticks of AlertSystem, so that each middleware judges
the same values at the same instants. `tests/data/field_alerts.txt` has the alerts, worked out by hand.
"""

from __future__ import annotations

import math
from typing import Any, Iterator, Mapping, NamedTuple, Sequence

from harness.port_conformance import DIAGNOSTICS, FLOAT32, START_S

BATTERY = "sensor_msgs/BatteryState"
JOINTS = "sensor_msgs/JointState"


class Published(NamedTuple):
    """A message of the robot."""

    time_s: float
    topic: str
    type_name: str
    message: Mapping[str, Any]


class Scene(NamedTuple):
    """Messages, and what is watched."""

    signals: Mapping[str, Any]
    messages: Sequence[Published]
    seconds: float


SIGNALS: dict[str, Any] = {
    # A falling charge: three lines through 4 s, 8 s ahead.
    "charge_soon": {
        "topic": "battery", "type": BATTERY, "field": "charge", "unit": "Ah",
        "statistic": "forecast", "window_s": 4.0, "forecast_s": 8.0, "warn_below": 45.0, "for_s": 0.5,
        "stale_after_s": 0.0,
    },
    "scan_gap": {
        "topic": "scan", "type": FLOAT32, "field": "",
        "statistic": "largest_gap_s", "window_s": 4.0, "window_min_s": 2.0, "warn_above": 1.0, "stale_after_s": 0.0,
    },
    **{
        f"cells_{reduce}": {
            "topic": "battery", "type": BATTERY, "field": "cell_voltage[*]", "reduce": reduce, **bounds,
        }
        for reduce, bounds in {
            "min": {"unit": "V", "warn_below": 3.25},
            "max": {"warn_above": 4.125},
            "mean": {"warn_below": 3.5, "hysteresis": 0.125},
            "spread": {"warn_above": 0.5},
            "sum": {"warn_below": 10.0},
            "count": {"error_below": 4.0},
        }.items()
    },
    "battery_age": {
        "topic": "battery", "type": BATTERY, "field": "header.stamp", "warn_above": 0.5, "warn_below": -0.125,
    },
    "charge": {"topic": "battery", "type": BATTERY, "field": "charge", "unit": "Ah"},
    "cells_in_use": {
        "topic": "battery", "type": BATTERY, "field": "cell_voltage[*]", "reduce": "min", "warn_below": 3.25,
        "only_if": {"signal": "charge", "between": [57.5, 59.0]},
    },
    "cells": {
        "topic": "battery", "type": BATTERY, "field": "cell_voltage[*]", "unit": "V", "warn_below": 3.25,
        "stale_after_s": 0.75,
    },
    "wheel": {
        "topic": "joints", "type": JOINTS, "field": 'effort["wheel_*"]', "warn_above": 9.0, "stale_after_s": 2.0,
        "forget_after_s": 4.0,
    },
    "driver_levels": {
        "topic": "drivers", "type": DIAGNOSTICS, "field": 'status["*"].level', "warn_above": 0.0, "error_above": 1.0,
        "valid_max": 3.0, "stale_after_s": 2.0,
    },
    "drivers": {
        "topic": "drivers", "type": DIAGNOSTICS, "field": 'status["*"]', "stale_after_s": 2.0,
    },
    "hottest": {
        "topic": "drivers", "type": DIAGNOSTICS, "field": 'status["motor_driver: *"].values["Temperature (C)"]',
        "reduce": "max", "unit": "degC", "warn_above": 80.0,
    },
    "left_effort": {
        "topic": "joints", "type": JOINTS, "field": 'effort["wheel_left"]', "unit": "Nm", "warn_above": 8.0,
        "stale_after_s": 4.0,
    },
    "wheels": {
        "topic": "joints", "type": JOINTS, "field": 'effort["wheel_*"]', "reduce": "max", "warn_above": 9.0,
    },
    "left_hot": {
        "topic": "drivers", "type": DIAGNOSTICS, "field": "", "where": 'status["motor_driver: left"].level == WARN',
        "statistic": "count", "window_s": 4.0, "warn_above": 1.0,
    },
    "right_beside": {
        "topic": "drivers", "type": DIAGNOSTICS, "field": 'status["motor_driver: right"].values["Temperature (C)"]',
        "where": 'status["motor_driver: left"].level != OK and status["motor_driver: right"].name == "*: right"',
        "unit": "degC", "warn_above": 61.0, "stale_after_s": 2.0,
    },
}  # fmt: skip


def messages() -> list[Published]:
    """Returns all messages in the order of their times."""
    return sorted((*_battery(), *_scan(), *_joints(), *_drivers()), key=lambda published: published.time_s)


def _battery() -> Iterator[Published]:
    """60.0625 Ah at the start, 1 Ah less per s; charged from 110 s on, 1 Ah more per s."""
    for step in range(65):
        elapsed_s = 0.25 * step + (0.125 if step else 0.0)
        if elapsed_s < 16.0:
            charge = 60.0625 - elapsed_s if elapsed_s < 10.0 else 40.0625 + elapsed_s
            header = {"stamp": _stamp(elapsed_s)}
            message = {"header": header, "charge": charge, "cell_voltage": _cells(elapsed_s)}
            yield Published(START_S + elapsed_s, "/battery", BATTERY, message)


def _stamp(elapsed_s: float) -> dict[str, int]:
    """0.0625 s ago; from 3 s on 0.75 s ago, from 5 s on in the future, from 7 s on none, for one second each."""
    if 7.0 < elapsed_s < 8.0:
        return {"sec": 0, "nanosec": 0}
    age_s = 0.75 if 3.0 < elapsed_s < 4.0 else -0.25 if 5.0 < elapsed_s < 6.0 else 0.0625
    seconds = START_S + elapsed_s - age_s
    return {"sec": int(seconds), "nanosec": round(seconds % 1.0 * 1e9)}


def _cells(elapsed_s: float) -> list[float]:
    """Four cells of 3.75 V: one drops at 2 s, one is not measured from 4 s on, one is high at 6 s, none from 8 s on."""
    cells = [3.75, 3.75, 3.75, 3.75]
    if 2.0 < elapsed_s < 3.0:
        cells[2] = 3.125
    if 4.0 < elapsed_s < 5.0:
        cells[1] = math.nan
    if 6.0 < elapsed_s < 7.0:
        cells[3] = 4.25
    if 8.0 < elapsed_s < 9.0:
        cells = [math.nan] * 4
    if 10.0 < elapsed_s < 11.0:
        cells = cells[:2]
    if 12.0 < elapsed_s < 13.0:
        cells = []
    return cells


def _joints() -> Iterator[Published]:
    """Three joints at 1 Hz."""
    for step in range(16):
        elapsed_s = 0.25 + step
        names, effort = ["wheel_left", "wheel_right", "arm"], [2.0, 3.0, 20.0]
        if 2 <= step < 4:
            effort[0] = 8.5
        if 4 <= step < 6:
            effort[1] = 9.5
        if step == 6:
            effort = effort[:2]
        if 8 <= step < 14:
            effort = []
        message = {"name": names, "effort": effort}
        yield Published(START_S + elapsed_s, "/joints", JOINTS, message)


def _scan() -> Iterator[Published]:
    """Every 0.5 s, but for a gap of 1.75 s from 104.875 s on."""
    times_s = [0.125 + 0.5 * step for step in range(10)]
    times_s += [times_s[-1] + 1.75 + 0.5 * step for step in range(15)]
    for elapsed_s in times_s:
        if elapsed_s < 16.0:
            yield Published(START_S + elapsed_s, "/scan", FLOAT32, {"data": 1.0})


def _drivers() -> Iterator[Published]:
    """Two motors and a lidar, which is gone from 9 s on. The left motor is hot, and 7 is no level."""
    left = {2: 1, 3: 1, 4: 2, 6: 3, 8: 7}
    for step in range(16):
        statuses = [
            status("motor_driver: left", left.get(step, 0), "90.5" if step in (2, 3, 4) else "60"),
            status("motor_driver: right", 0, "n/a" if step == 6 else "61.5"),
        ]
        if step < 9:
            statuses.append(status("lidar: front", 0, "99"))
        yield Published(START_S + 0.25 + step, "/drivers", DIAGNOSTICS, {"status": statuses})


def status(name: str, level: int, temperature: str = "60") -> Mapping[str, Any]:
    """Returns a DiagnosticStatus."""
    texts = {0: "fine", 1: "hot", 2: "too hot", 3: "no answer"}
    values = [{"key": "Temperature (C)", "value": temperature}]
    return {"level": level, "name": name, "message": texts.get(level, ""), "hardware_id": "robot1", "values": values}


FIELDS = Scene(SIGNALS, messages(), 16.0)
