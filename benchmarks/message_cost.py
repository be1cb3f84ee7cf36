"""CPU per message of the alert node, beside a bare subscriber of the same middleware.

Both live all the time, each on a topic of its own, and one publisher serves them in turn, a slice each, round after
round. What is compared is the CPU time of the whole process within a slice. The alert node is the executable as
launched, with the three signals of `config/thresholds.yaml`, of which one gets the messages; the bare subscriber
counts.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from typing import Dict, Iterator, List

from benchmarks.table import Row, median_ratio
from benchmarks.targets import ROOT, Target

RATE_HZ = 1000.0
SLICE_S = 1.0
ROUNDS = 40
SETTLE_S = 0.2
"""For the messages that are still on their way when a slice ends."""
AT_MOST = 1.25


def rows(target: Target, rounds: int = ROUNDS) -> Iterator[Row]:
    """Measures and yields the rows of the table."""
    found: Dict[str, List[float]] = {"/bare": [], "/watched": []}
    with contextlib.ExitStack() as running:
        contestants = {
            "/bare": target.peer("subscriber"),
            "/watched": target.node(
                "alert_system", "watching", "battery_level:=/watched", ROOT / "config" / "thresholds.yaml"
            ),
        }
        publisher = target.peer("publisher")
        for process in (*contestants.values(), publisher):
            running.callback(process.end)
        for number in range(rounds + 1):
            for topic, process in contestants.items():
                begin_s = process.cpu_s()
                sent = publisher.order(f"{topic} {RATE_HZ} {SLICE_S}")
                time.sleep(SETTLE_S)
                if number:  # the first round warms up and fills the window
                    found[topic].append((process.cpu_s() - begin_s) / sent * 1e6)
    what = f"{target.name}, one message at {RATE_HZ / 1000.0:g} kHz"
    medians = {topic: f"{statistics.median(values):.0f} us" for topic, values in found.items()}
    ratio = median_ratio(found["/watched"], found["/bare"])
    yield Row(what, "bare subscriber", medians["/bare"])
    yield Row(what, "alert_system", medians["/watched"], ratio, AT_MOST, "to the bare subscriber")
