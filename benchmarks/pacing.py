"""Code shared by the publishers of both middlewares: values, pacing, and commands on stdin."""

from __future__ import annotations

import itertools
import random
import sys
import time
from typing import Callable, Dict, Iterator, List, Tuple

BARE, WATCHED = "/bare", "/watched"
"""Topics of the two contestants, or the prefixes of their topics."""


def battery_levels() -> Iterator[float]:
    """Yields healthy levels in %."""
    noise = random.Random(1)
    while True:
        yield min(99.0, max(30.0, 60.0 + noise.gauss(0.0, 5.0)))


STATUSES = 200
"""Statuses of a message on /diagnostics."""


def statuses(number: int) -> Iterator[Tuple[str, str, Dict[str, str]]]:
    """Yields name, message and key-values of each status of a message, by its number: every driver is OK."""
    for driver in range(STATUSES):
        values = {"temperature": f"{40.0 + number % 10 + driver / 10.0:.1f}", "errors": "0", "firmware": "2.4.1"}
        yield f"driver_{driver}: status", f"running for {number} s", values


CAMERA, LEVEL = f"{WATCHED}/camera", f"{WATCHED}/level"
FRAME_BYTES = 1_000_000
_HEALTHY_FRAMES = 450


def levels_of_frames() -> Iterator[float]:
    """Yields the battery level that comes with each frame of the camera: healthy ones, then an alert."""
    yield from itertools.repeat(60.0, _HEALTHY_FRAMES)
    yield from itertools.repeat(10.0)


def topics_below(name: str, count: int) -> List[str]:
    """Returns the topics of a contestant: its name, or a number of topics below it."""
    return [name] if count == 1 else [f"{name}/t{number}" for number in range(count)]


def serve(connected: Callable[[], bool], publish: Callable[[int], None]) -> None:
    """Reads lines `RATE_HZ SECONDS`, publishes accordingly and prints the number of messages, until stdin ends.

    Args:
        connected: returns whether all contestants are subscribed.
        publish: sends a message to each; takes its number.
    """
    for line in sys.stdin:
        rate_hz, seconds = map(float, line.split())
        while not connected():
            time.sleep(0.05)
        wanted = round(rate_hz * seconds)
        begin_s = time.monotonic()
        for number in range(wanted):
            early_s = begin_s + number / rate_hz - time.monotonic()
            if early_s > 0.0:
                time.sleep(early_s)
            publish(number)
        print(wanted, flush=True)
