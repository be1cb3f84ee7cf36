"""CPU per message of a black box: the alert node keeps the bytes of ten topics at 100 Hz each.

Beside a bare subscriber of the bytes of the same topics, which counts them. The node judges a signal of another topic,
so that its own work, timers and /diagnostics, is in the figure too. The memory of the ring is that of its messages.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Iterator

from benchmarks.pacing import WATCHED, topics_below
from benchmarks.side_by_side import compare
from benchmarks.table import Row
from benchmarks.targets import Target

TOPICS = 10
RATE_HZ = 100.0
SLICE_S = 3.0
ROUNDS = 20
AT_MOST_OF_BARE = 1.3

PARAMETERS = """
alert_system:
  ros__parameters:
    ops: {ops}
    signals:
      other: {{topic: other, type: std_msgs/Float32, warn_below: 20.0, stale_after_s: 0.0}}
"""
OPS = """
black_box: {{folder: {folder}, topics: [{topics}]}}
"""


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    with tempfile.TemporaryDirectory() as folder:
        parameters, ops = Path(folder, "parameters.yaml"), Path(folder, "ops.yaml")
        ops.write_text(OPS.format(folder=folder, topics=", ".join(topics_below(WATCHED, TOPICS))))
        parameters.write_text(PARAMETERS.format(ops=ops))
        of_bare, of_node, ratio = compare(
            target,
            target.peer("raw_subscriber", TOPICS),
            target.node("alert_system", "black_box", parameters=parameters),
            TOPICS,
            TOPICS * RATE_HZ,
            SLICE_S,
            rounds,
        )
    what = f"{target.name}, black box of {TOPICS} topics at {RATE_HZ:g} Hz each"
    yield Row(what, "bare subscriber of bytes", of_bare)
    yield Row(what, "alert_system", of_node, ratio, AT_MOST_OF_BARE, "to the bare subscriber, per message")
