"""Waiting for what another thread or process does, where it gives no event."""

from __future__ import annotations

import time
from typing import Callable

WAIT_S = 30.0


def wait_for(condition: Callable[[], object]) -> None:
    """Waits until a condition holds.

    Raises:
        AssertionError: it does not hold within 30 s.
    """
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s, f"still not true after {WAIT_S:g} s"
        time.sleep(0.01)
