"""CPU per message of 200 statuses on /diagnostics, each of which is a signal of its own through one wildcard.

Beside a bare subscriber of the same messages, which deserializes them and counts the statuses. On ROS 2 it spins with
the EventsExecutor, as the alert node does: the ratio is smaller beside the SingleThreadedExecutor.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Iterator

from benchmarks.pacing import STATUSES, WATCHED
from benchmarks.side_by_side import compare
from benchmarks.table import Row
from benchmarks.targets import Target

RATE_HZ = 10.0
SLICE_S = 3.0
ROUNDS = 20
AT_MOST_OF_BARE = 1.5

DRIVERS = f"""
alert_system:
  ros__parameters:
    signals:
      drivers:
        topic: {WATCHED}
        type: diagnostic_msgs/DiagnosticArray
        field: 'status["*"]'
"""


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with tempfile.TemporaryDirectory() as folder:
        parameters = Path(folder, "parameters.yaml")
        parameters.write_text(DRIVERS)
        of_bare, of_node, ratio = compare(
            target,
            target.peer("diagnostics_subscriber"),
            target.node("alert_system", "watching_statuses", parameters=parameters),
            topics=1,
            rate_hz=RATE_HZ,
            slice_s=SLICE_S,
            rounds=rounds,
            publisher="diagnostics_publisher",
        )
    what = f"{target.name}, {STATUSES} statuses at {RATE_HZ:g} Hz"
    yield Row(what, "bare subscriber", of_bare)
    yield Row(what, "alert_system", of_node, ratio, AT_MOST_OF_BARE, "to the bare subscriber, per message")
