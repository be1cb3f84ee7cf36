"""CPU per message of the alert node where it watches a topic's frequency only, and where it watches a hundred topics.

The frequency of a topic at 1 kHz: beside `rostopic hz` on ROS 1; on ROS 2, whose `ros2 topic hz` no package index has,
beside a bare subscriber, which does not even divide. A hundred signals at 10 Hz: beside a hundred bare subscribers in
one process.
"""

from __future__ import annotations

import contextlib
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import Dict, Iterator, List, Tuple

from benchmarks.pacing import topics_below
from benchmarks.table import Row, median_ratio
from benchmarks.targets import Process, Target

SLICE_S = 5.0
ROUNDS = 9
SETTLE_S = 0.2
FREQUENCY_HZ = 1000.0
SIGNALS = 100
SIGNAL_HZ = 10.0
AT_MOST_OF_TOOL = 1.0
AT_MOST_OF_BARE = 1.2
AT_MOST_OF_HUNDRED = 1.3

# While the other contestant is served, these wait: no alert.
FREQUENCY = """
alert_system:
  ros__parameters:
    signals:
      arrivals: {topic: /watched, type: std_msgs/Float32, field: "", statistic: frequency_hz, warn_below: 100.0,
                 stale_after_s: 60.0}
"""
HUNDRED = "alert_system:\n  ros__parameters:\n    signals:\n" + "\n".join(
    f"      level_{number}: {{topic: {topic}, type: std_msgs/Float32, stale_after_s: 60.0,"
    " warn_below: 20.0, error_below: 10.0}"
    for number, topic in enumerate(topics_below("/watched", SIGNALS))
)


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    yield from frequency(target, rounds)
    yield from hundred(target, rounds)


def frequency(target: Target, rounds: int) -> Iterator[Row]:
    """Yields the rows about one topic's frequency."""
    tool = "rostopic hz" if target.package == "ros1" and shutil.which("rostopic") else ""
    with contextlib.ExitStack() as running:
        peer = target.tool("rostopic", "hz", "/bare") if tool else target.peer("subscriber")
        medians, ratio = _compare(target, running, peer, FREQUENCY, 1, FREQUENCY_HZ, rounds)
    what = f"{target.name}, frequency of one topic at 1 kHz"
    beside = tool or "bare subscriber"
    yield Row(what, beside, medians["/bare"])
    required = AT_MOST_OF_TOOL if tool else AT_MOST_OF_BARE
    yield Row(what, "alert_system", medians["/watched"], ratio, required, f"to {beside}, per message")


def hundred(target: Target, rounds: int) -> Iterator[Row]:
    """Yields the rows about a hundred signals."""
    with contextlib.ExitStack() as running:
        peer = target.peer("subscriber", SIGNALS)
        medians, ratio = _compare(target, running, peer, HUNDRED, SIGNALS, SIGNALS * SIGNAL_HZ, rounds)
    what = f"{target.name}, {SIGNALS} topics at {SIGNAL_HZ:g} Hz each"
    yield Row(what, "bare subscribers", medians["/bare"])
    yield Row(what, "alert_system", medians["/watched"], ratio, AT_MOST_OF_HUNDRED, "to bare subscribers, per message")


def _compare(
    target: Target,
    running: contextlib.ExitStack,
    peer: Process,
    configuration: str,
    topics: int,
    rate_hz: float,
    rounds: int,
) -> Tuple[Dict[str, str], float]:
    running.callback(peer.end)
    folder = Path(running.enter_context(tempfile.TemporaryDirectory()))
    parameters = folder / "parameters.yaml"
    parameters.write_text(configuration)
    publisher = target.peer("publisher", topics)
    running.callback(publisher.end)
    node = target.node("alert_system", f"watching_{topics}", parameters=parameters)
    running.callback(node.end)
    found: Dict[str, List[float]] = {"/bare": [], "/watched": []}
    for number in range(rounds + 1):
        for name, process in (("/bare", peer), ("/watched", node)):
            begin_s = process.cpu_s()
            sent = publisher.order(f"{name} {rate_hz} {SLICE_S}")
            time.sleep(SETTLE_S)
            if number:  # the first round warms up and fills the window
                found[name].append((process.cpu_s() - begin_s) / sent * 1e6)
    medians = {name: f"{statistics.median(values):.0f} us" for name, values in found.items()}
    return medians, median_ratio(found["/watched"], found["/bare"])
