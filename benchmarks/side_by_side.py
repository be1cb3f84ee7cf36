"""CPU time of two subscribers that receive the same messages at the same time.

Other load on the machine affects both alike. Neither ever pauses: after a second of idleness, caches (on a virtual
machine even the host's memory) no longer hold a process, and reloading it would count as its cost.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from typing import Dict, List, Tuple

from benchmarks.pacing import BARE, WATCHED
from benchmarks.table import median_ratio
from benchmarks.targets import Process, Target

SETTLE_S = 0.2
"""Time for messages in flight at the end of a slice."""


def compare(
    target: Target,
    bare: Process,
    watching: Process,
    topics: int,
    rate_hz: float,
    slice_s: float,
    rounds: int,
    publisher: str = "publisher",
) -> Tuple[str, str, float]:
    """Feeds two running processes slice after slice; ends them.

    Args:
        target: where they run.
        bare: listens to `BARE`.
        watching: listens to `WATCHED`.
        topics: how many topics each listens to; they get messages in turn.
        rate_hz: messages per second and contestant, over all its topics.
        slice_s: length of a slice in s.
        rounds: how many slices count; one more warms up and fills the windows.
        publisher: role of the peer that feeds them.

    Returns:
        The median CPU time per message of the one and of the other, as text, and the median of their ratios.
    """
    contestants = {BARE: bare, WATCHED: watching}
    found: Dict[str, List[float]] = {name: [] for name in contestants}
    with contextlib.ExitStack() as running:
        for process in contestants.values():
            running.callback(process.end)
        feeding = target.peer(publisher, topics)
        running.callback(feeding.end)
        feeding.order(f"{rate_hz} {slice_s}")
        for _ in range(rounds):
            begin_s = {name: process.cpu_s() for name, process in contestants.items()}
            sent = feeding.order(f"{rate_hz} {slice_s}")
            time.sleep(SETTLE_S)
            for name, process in contestants.items():
                found[name].append((process.cpu_s() - begin_s[name]) / sent * 1e6)
    of_bare, of_watching = (f"{statistics.median(values):.0f} us" for values in found.values())
    return of_bare, of_watching, median_ratio(found[WATCHED], found[BARE])
