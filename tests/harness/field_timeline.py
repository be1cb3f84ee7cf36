"""A timeline for every kind of field and every statistic: what a robot publishes, as mappings in the shape of ROS 2.

Every number is exact in 32 bits, and every time lies beside the ticks of AlertSystem, so that each middleware judges
the same values at the same instants. `tests/core/test_local.py` has the alerts, worked out by hand.
"""

from __future__ import annotations

from typing import Any, Dict, Iterator, List, Mapping, NamedTuple

from harness.port_conformance import FLOAT32, START_S

BATTERY = "sensor_msgs/BatteryState"
END_S = START_S + 16.0


class Published(NamedTuple):
    """A message of the robot."""

    time_s: float
    topic: str
    type_name: str
    message: Mapping[str, Any]


SIGNALS: Dict[str, Any] = {
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
}  # fmt: skip


def timeline() -> List[Published]:
    """Returns all messages in the order of their times."""
    return sorted((*_battery(), *_scan()), key=lambda published: published.time_s)


def _battery() -> Iterator[Published]:
    """60.0625 Ah at the start, 1 Ah less per s; charged from 110 s on, 1 Ah more per s."""
    for step in range(65):
        elapsed_s = 0.25 * step + (0.125 if step else 0.0)
        if elapsed_s < 16.0:
            charge = 60.0625 - elapsed_s if elapsed_s < 10.0 else 40.0625 + elapsed_s
            yield Published(START_S + elapsed_s, "/battery", BATTERY, {"charge": charge})


def _scan() -> Iterator[Published]:
    """Every 0.5 s, but for a gap of 1.75 s from 104.875 s on."""
    times_s = [0.125 + 0.5 * step for step in range(10)]
    times_s += [times_s[-1] + 1.75 + 0.5 * step for step in range(15)]
    for elapsed_s in times_s:
        if elapsed_s < 16.0:
            yield Published(START_S + elapsed_s, "/scan", FLOAT32, {"data": 1.0})
