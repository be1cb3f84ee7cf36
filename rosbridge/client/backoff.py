"""How long to wait before the next attempt to connect."""

from __future__ import annotations

import random
from typing import Callable, Optional

from robot_health_monitor.runtime.backoff import Backoff

HELD_S = 10.0
"""A connection that lasted this long, in s, is a good one: the delays start again from the shortest."""

_FIRST_S = 0.2
_LONGEST_S = 1.2
"""Longest delay while the server cannot be reached or connections break: short, so that a robot that can be reached
again is soon judged again."""
_SHORT_LIVED_S = 1.0
_LONGEST_AFTER_CLOSE_S = 30.0
"""Longest delay for a server that accepts connections only to close them within `_SHORT_LIVED_S`."""


class ConnectBackoff:
    """Delays that double with every attempt until a connection has held for `HELD_S`.

    Each delay is shortened by a random part of up to half, so that a fleet does not reconnect all at once.
    """

    def __init__(self, chance: Callable[[], float] = random.random) -> None:
        """Starts with the shortest delay.

        Args:
            chance: returns a random number from 0 to 1.
        """
        self._backoff = Backoff(_FIRST_S, _LONGEST_S, spread=0.5, chance=chance)

    def next_s(self, held_s: Optional[float]) -> float:
        """Returns the delay before the next attempt, in s.

        Args:
            held_s: how long the last connection lasted, in s; None: the attempt failed.
        """
        if held_s is not None and held_s >= HELD_S:
            self._backoff.reset()
        closed_at_once = held_s is not None and held_s < _SHORT_LIVED_S
        return self._backoff.next_s(_LONGEST_AFTER_CLOSE_S if closed_at_once else None)
