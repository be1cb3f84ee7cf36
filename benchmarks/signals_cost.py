"""CPU per message of the alert node when it watches only a topic's frequency, and when it watches a hundred topics.

The frequency of a topic at 1 kHz: beside `rostopic hz` on ROS 1; on ROS 2, whose `ros2 topic hz` no package index has,
beside a bare subscriber, which does not even divide. A hundred signals at 10 Hz: beside a hundred bare subscribers in
one process.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Iterator, Tuple

from benchmarks.pacing import BARE, WATCHED, topics_below
from benchmarks.side_by_side import compare
from benchmarks.table import Row
from benchmarks.targets import Process, Target

SLICE_S = 3.0
ROUNDS = 20
FREQUENCY_HZ = 1000.0
SIGNALS = 100
SIGNAL_HZ = 10.0
AT_MOST_OF_TOOL = 1.0
AT_MOST_OF_BARE = 1.2
AT_MOST_OF_HUNDRED = 1.3

FREQUENCY = f"""
alert_system:
  ros__parameters:
    signals:
      arrivals: {{topic: {WATCHED}, type: std_msgs/Float32, field: "", statistic: frequency_hz, warn_below: 100.0}}
"""
HUNDRED = "alert_system:\n  ros__parameters:\n    signals:\n" + "\n".join(
    f"      level_{number}: {{topic: {topic}, type: std_msgs/Float32, warn_below: 20.0, error_below: 10.0}}"
    for number, topic in enumerate(topics_below(WATCHED, SIGNALS))
)


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    yield from frequency(target, rounds)
    yield from hundred(target, rounds)


def frequency(target: Target, rounds: int) -> Iterator[Row]:
    """Yields the rows about one topic's frequency."""
    has_tool = target.package == "ros1" and shutil.which("rostopic")
    beside, required = ("rostopic hz", AT_MOST_OF_TOOL) if has_tool else ("bare subscriber", AT_MOST_OF_BARE)
    bare = target.tool("rostopic", "hz", BARE) if has_tool else target.peer("subscriber")
    of_bare, of_node, ratio = _compare(target, bare, FREQUENCY, 1, FREQUENCY_HZ, rounds)
    what = f"{target.name}, frequency of one topic at 1 kHz"
    yield Row(what, beside, of_bare)
    yield Row(what, "alert_system", of_node, ratio, required, f"to {beside}, per message")


def hundred(target: Target, rounds: int) -> Iterator[Row]:
    """Yields the rows about a hundred signals."""
    bare = target.peer("subscriber", SIGNALS)
    of_bare, of_node, ratio = _compare(target, bare, HUNDRED, SIGNALS, SIGNALS * SIGNAL_HZ, rounds)
    what = f"{target.name}, {SIGNALS} topics at {SIGNAL_HZ:g} Hz each"
    yield Row(what, "bare subscribers", of_bare)
    yield Row(what, "alert_system", of_node, ratio, AT_MOST_OF_HUNDRED, "to bare subscribers, per message")


def _compare(
    target: Target, bare: Process, configuration: str, topics: int, rate_hz: float, rounds: int
) -> Tuple[str, str, float]:
    with tempfile.TemporaryDirectory() as folder:
        parameters = Path(folder, "parameters.yaml")
        parameters.write_text(configuration)
        node = target.node("alert_system", f"watching_{topics}", parameters=parameters)
        return compare(target, bare, node, topics, rate_hz, SLICE_S, rounds)
