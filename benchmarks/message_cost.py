"""CPU per message of the alert node, beside a bare subscriber of the same middleware.

The alert node is the executable as launched, with the three signals of `config/thresholds.yaml`, of which one gets the
messages; the bare subscriber counts.
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
AT_MOST = 1.25


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    thresholds = ROOT / "config" / "thresholds.yaml"
    of_bare, of_node, ratio = compare(
        target,
        target.peer("subscriber"),
        target.node("alert_system", "watching", f"battery_level:={WATCHED}", thresholds),
        topics=1,
        rate_hz=RATE_HZ,
        slice_s=SLICE_S,
        rounds=rounds,
    )
    what = f"{target.name}, one message at {RATE_HZ / 1000.0:g} kHz"
    yield Row(what, "bare subscriber", of_bare)
    yield Row(what, "alert_system", of_node, ratio, AT_MOST, "to the bare subscriber")
