"""CPU per message of the alert node, compared with a bare subscriber on the same middleware.

The alert node is the executable as launched, with the three signals of `config/thresholds.yaml`, of which one gets the
messages; the bare subscriber counts. On ROS 2 there are two bare ones: on the SingleThreadedExecutor, which most nodes
use, and on the EventsExecutor, which the alert node chooses where it works.
"""

from __future__ import annotations

from typing import Iterator

from benchmarks.pacing import WATCHED
from benchmarks.side_by_side import compare
from benchmarks.table import Row
from benchmarks.targets import ROOT, Target

RATE_HZ = 1000.0
SLICE_S = 2.0
ROUNDS = 30
REQUIRED = {
    "ros1": {"subscriber": 1.35},
    "ros2": {"subscriber": 0.35, "events_subscriber": 1.15},
}
"""Largest ratio to each bare subscriber."""
NAMES = {"subscriber": "bare subscriber", "events_subscriber": "bare subscriber, EventsExecutor"}


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    thresholds = ROOT / "config" / "thresholds.yaml"
    what = f"{target.name}, one message at {RATE_HZ / 1000.0:g} kHz"
    for role, required in REQUIRED[target.package].items():
        of_bare, of_node, ratio = compare(
            target,
            target.peer(role),
            target.node("alert_system", "watching", f"battery_level:={WATCHED}", thresholds),
            topics=1,
            rate_hz=RATE_HZ,
            slice_s=SLICE_S,
            rounds=rounds,
        )
        yield Row(what, NAMES[role], of_bare)
        yield Row(what, "alert_system", of_node, ratio, required, f"to the {NAMES[role]}")
