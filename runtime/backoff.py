"""How long to wait before the next attempt, where attempts fail."""

from __future__ import annotations

import random

from ..core.values import Clock


class Backoff:
    """Delays that double with every failure, up to the longest."""

    def __init__(self, first_s: float, longest_s: float, *, spread: float = 0.0, chance: Clock = random.random) -> None:
        """`spread` is the random part of each delay, 0 to 1, so that many that failed together do not return together.

        `chance` returns a random number from 0 to 1.
        """
        self._first_s = first_s
        self._longest_s = longest_s
        self._spread = spread
        self._chance = chance
        self._delay_s = 0.0

    @property
    def is_failing(self) -> bool:
        """Whether an attempt has failed since the last success."""
        return self._delay_s > 0.0

    def next_s(self, longest_s: float | None = None) -> float:
        """Notes a failure and returns the delay before the next attempt, in s; `longest_s` limits this one, in s."""
        longest_s = self._longest_s if longest_s is None else longest_s
        self._delay_s = min(max(2.0 * self._delay_s, self._first_s), longest_s)
        return self._delay_s * (1.0 - self._spread + self._spread * self._chance())

    def reset(self) -> None:
        """Notes a success: the delays start again from the first."""
        self._delay_s = 0.0
