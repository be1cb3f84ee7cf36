"""Waiting for what another thread or process does, where it gives no event."""

from __future__ import annotations

import itertools
import time
import urllib.request
from typing import Callable

WAIT_S = 30.0
_TICK = "robot_health_last_tick_timestamp_seconds{"


def wait_for(condition: Callable[[], object], deadline_s: float = WAIT_S) -> None:
    """Waits until a condition holds.

    Raises:
        AssertionError: it does not hold in time.
    """
    end_s = time.monotonic() + deadline_s
    # Most things take milliseconds; later looks are rarer, since many are requests to a server under test.
    for pause_s in itertools.chain(itertools.repeat(0.01, 20), itertools.repeat(0.05)):
        if condition():
            return
        assert time.monotonic() < end_s, f"still not true after {deadline_s:g} s"
        time.sleep(pause_s)


def wait_for_ticks(port: int, lasts_s: float) -> None:
    """Waits until every robot of a monitor that serves on this port has ticked for some time, by the robots' ticks."""

    def ticks_s() -> list[float]:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics?profile=fleet", timeout=WAIT_S) as answer:
            lines = answer.read().decode().splitlines()
        return [float(line.rpartition(" ")[2]) for line in lines if line.startswith(_TICK)]

    wait_for(ticks_s)
    first_s = max(ticks_s())
    wait_for(lambda: min(ticks_s()) >= first_s + lasts_s)
