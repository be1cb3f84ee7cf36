"""Flap detection after Nagios: how much of the recent past was changes.

Source of the formula: Nagios Core documentation, "Detection and Handling of State Flapping". The last 21 levels hold
20 possible changes; the oldest weighs 0.75, the newest 1.25, those between linearly, and all 20 make 100 %.

The changes are kept as the bits of a number, the newest lowest. In units of 1/76 the weights are whole (57 for the
oldest, 95 for the newest, 2 more for each between), so that a sum that is exactly a limit is found to be.
"""

from __future__ import annotations

from typing import Tuple

from .model import Level

CHANGES = 20
"""Possible changes in the 21 levels that are looked at."""

_HALF = CHANGES // 2
_NEWER = (1 << _HALF) - 1
_ALL = (1 << CHANGES) - 1
_WEIGHTS = tuple(57 + 2 * (CHANGES - 1 - bit) for bit in range(CHANGES))
_TOTAL = sum(_WEIGHTS)


def _sums(first_bit: int) -> Tuple[int, ...]:
    return tuple(
        sum(_WEIGHTS[first_bit + bit] for bit in range(_HALF) if changes >> bit & 1) for changes in range(1 << _HALF)
    )


_NEWER_SUMS = _sums(0)
_OLDER_SUMS = _sums(_HALF)


class FlapDetector:
    """Follows the levels after good samples and says whether the signal flaps."""

    __slots__ = ("_changes", "_high", "_last", "_low", "flapping", "told")

    def __init__(self, high: float, low: float) -> None:
        """Starts with a past that was always OK.

        Args:
            high: flapping begins at this state change or above, in %.
            low: flapping ends below this state change, in %.
        """
        self._changes = 0
        self._last = Level.OK
        self.flapping = False
        """Whether the signal flaps."""
        self.told = False
        """Whether people were told so; whoever tells them sets it, and the end of flapping clears it."""
        self.configure(high, low)

    def configure(self, high: float, low: float) -> None:
        """Takes new limits; the past stays, and the next sample decides by the new ones."""
        self._high = high
        self._low = low

    @property
    def percent(self) -> float:
        """Weighted state change, 0 to 100 %."""
        return 100.0 * (_OLDER_SUMS[self._changes >> _HALF] + _NEWER_SUMS[self._changes & _NEWER]) / _TOTAL

    @property
    def is_at_rest(self) -> bool:
        """Whether there was no change, so that the same level again makes no difference."""
        return not self._changes

    def add(self, level: Level) -> None:
        """Takes the level after a good sample."""
        self._changes = (self._changes << 1 | (level is not self._last)) & _ALL
        self._last = level
        percent = self.percent if self._changes else 0.0
        self.flapping = percent >= (self._low if self.flapping else self._high)
        self.told = self.told and self.flapping
