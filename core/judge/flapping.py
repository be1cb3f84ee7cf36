"""Step 6 of docs/rules.md: flapping, which is detected as by Nagios.

Source of the formula: Nagios Core documentation, "Detection and Handling of State Flapping". The last 21 levels hold 20
possible changes; the oldest weighs 0.75, the newest 1.25, those between linearly, and all 20 make 100 %.
"""

from __future__ import annotations

from ..values import Level
from .saved_state import SavedState

CHANGES = 20
"""Possible changes in the 21 levels."""
# In units of 1/76 the weights are whole numbers, so that a sum exactly at a limit is found to be.
_WEIGHTS = tuple(95 - 2 * place for place in range(CHANGES))
"""Newest change first."""
_TOTAL = sum(_WEIGHTS)
_KEPT = 2**CHANGES - 1


class FlapDetector:
    """Follows the levels after good samples, decides whether the signal flaps, and what is not announced meanwhile."""

    __slots__ = ("_changes", "_last", "_worst", "flapping", "high", "low")

    def __init__(self, high: float, low: float) -> None:
        """Starts with a past of 21 times OK.

        Flapping begins at a state change of `high` %, if that is at most 100, and ends below `low` %.
        """
        self.high, self.low = high, low
        self._changes = 0
        """One bit per possible change, the newest in the lowest place."""
        self._last = Level.OK
        self._worst: Level | None = None
        self.flapping = False
        """Whether the signal flaps; a storm sets it, whatever the state change is."""

    @property
    def percent(self) -> float:
        """Weighted state change, 0 to 100 %."""
        changes = self._changes
        return 100.0 * sum(weight for place, weight in enumerate(_WEIGHTS) if changes >> place & 1) / _TOTAL

    @property
    def is_at_rest(self) -> bool:
        """Whether there was no change, so that the same level again makes no difference."""
        return not self._changes and not self.flapping

    def exchange(self, state: SavedState) -> None:
        """Writes the state, or continues from one; raises UnusableStateError."""
        state.fields(self, _changes=0.0, _last=Level.OK, flapping=False, _worst=Level)
        self._changes = int(self._changes) & _KEPT
        if not self.flapping:
            self._worst = None

    def add(self, level: Level, *, is_storm: bool = False) -> None:
        """Processes the level after a good sample. During a storm, flapping does not end."""
        self._changes = (self._changes << 1 | (level is not self._last)) & _KEPT
        self._last = level
        limit = self.low if self.flapping else self.high
        if limit <= 100.0 and not (is_storm and self.flapping):
            self.flapping = (self.percent if self._changes else 0.0) >= limit
            if not self.flapping:
                self._worst = None

    def end(self) -> None:
        """Ends flapping, whatever the state change is."""
        self.flapping = False
        self._worst = None

    def note_announced(self, level: Level) -> None:
        """Notes a level that is being announced: while flapping, only a worse one is announced again."""
        if self.flapping:
            self._worst = level if self._worst is None else Level.worst((level, self._worst))

    def withholds(self, level: Level) -> bool:
        """Whether a change to `level` is not announced: flapping was, and so was a level at least as bad since."""
        return self._worst is not None and level.severity <= self._worst.severity
