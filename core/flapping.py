"""Which changes of a level are too many to be announced (step 6 of docs/rules.md): flapping after Nagios, and storms.

Source of the formula: Nagios Core documentation, "Detection and Handling of State Flapping". The last 21 levels hold
20 possible changes; the oldest weighs 0.75, the newest 1.25, those between linearly, and all 20 make 100 %.

Storms: a signal that announces more than one transition per second for a minute flaps, whatever its configuration. A
value that is noisy around its bound at 400 Hz must not be 400 alerts per second.
"""

from __future__ import annotations

from collections import deque
from typing import Any, Deque, Dict, Optional

from .model import Level
from .rule import TIME_TOLERANCE_S
from .state_reader import Downtime, Saved, UnusableStateError, age_s

CHANGES = 20
"""Possible changes in the 21 levels."""
# In units of 1/76 the weights are whole numbers, so that a sum exactly at a limit is found to be.
_WEIGHTS = tuple(95 - 2 * place for place in range(CHANGES))
"""Newest change first."""
_TOTAL = sum(_WEIGHTS)
_KEPT = 2**CHANGES - 1

MOST = 60
"""Most transitions in `PERIOD_S` that are no storm."""
PERIOD_S = 60.0


class FlapDetector:
    """Follows the levels after good samples, decides whether the signal flaps, and what is not announced meanwhile."""

    __slots__ = ("_changes", "_high", "_last", "_low", "_worst", "flapping")

    def __init__(self, high: float, low: float) -> None:
        """Starts with a past of 21 times OK; see `configure`."""
        self._changes = 0
        """One bit per possible change, the newest in the lowest place."""
        self._last = Level.OK
        self._worst: Optional[Level] = None
        self.flapping = False
        """Whether the signal flaps; a storm sets it, whatever the state change is."""
        self.configure(high, low)

    def configure(self, high: float, low: float) -> None:
        """Flapping begins at a state change of `high` %, if that is at most 100, and ends below `low` %."""
        self._high = high
        self._low = low

    @property
    def percent(self) -> float:
        """Weighted state change, 0 to 100 %."""
        changes = self._changes
        return 100.0 * sum(weight for place, weight in enumerate(_WEIGHTS) if changes >> place & 1) / _TOTAL

    @property
    def is_at_rest(self) -> bool:
        """Whether there was no change, so that the same level again makes no difference."""
        return not self._changes and not self.flapping

    def snapshot(self) -> Dict[str, Any]:
        """Returns the state as JSON values; empty if it is that of a new detector."""
        if self.is_at_rest and self._last is Level.OK:
            return {}
        changes = f"{self._changes:0{CHANGES}b}".replace("0", "-").replace("1", "x")
        state: Dict[str, Any] = {"changes": changes, "last": self._last.name, "flapping": self.flapping}
        return state if self._worst is None else {**state, "worst": self._worst.name}

    def restore(self, saved: Saved) -> None:
        """Continues from a snapshot; raises UnusableStateError."""
        changes = saved.text("changes", "-" * CHANGES)
        if len(changes) != CHANGES:
            raise UnusableStateError(f"changes of level: expected {CHANGES}, got {len(changes)}")
        self._changes = int("".join("1" if mark == "x" else "0" for mark in changes), 2)
        self._last, self.flapping = saved.level("last"), saved.flag("flapping")
        self._worst = saved.level("worst") if self.flapping and saved.has("worst") else None

    def add(self, level: Level, *, is_storm: bool = False) -> None:
        """Processes the level after a good sample. During a storm, flapping does not end."""
        self._changes = (self._changes << 1 | (level is not self._last)) & _KEPT
        self._last = level
        limit = self._low if self.flapping else self._high
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


class StormDetector:
    """Counts the transitions of one signal in the last minute. Times are in seconds."""

    __slots__ = ("_times",)

    def __init__(self) -> None:
        """Starts without transitions."""
        self._times: Deque[float] = deque(maxlen=MOST + 1)
        """When the latest transitions were announced."""

    def note_transition(self, now_s: float) -> None:
        """Notes that a transition is announced."""
        self._times.append(now_s)

    def is_storm(self, now_s: float) -> bool:
        """Whether more than `MOST` transitions lie within the last `PERIOD_S`."""
        return len(self._times) > MOST and _is_recent(self._times[0], now_s)

    def is_storm_with_next(self, now_s: float) -> bool:
        """Whether it would be a storm with one more transition."""
        return len(self._times) >= MOST and _is_recent(self._times[-MOST], now_s)

    def restart_time(self, back_s: float) -> None:
        """Time went back by `back_s`: the transitions are as long ago as before."""
        self._times = deque([time_s - back_s for time_s in self._times], maxlen=MOST + 1)

    def snapshot(self, now_s: float, wall_s: float) -> Dict[str, float]:
        """Returns the number of recent transitions and the times of two of them in seconds since 1970, as `wall_s`."""
        recent = [time_s for time_s in self._times if _is_recent(time_s, now_s)]
        if not recent:
            return {}
        ahead_s = wall_s - now_s
        return {"number": len(recent), "first": recent[0] + ahead_s, "last": recent[-1] + ahead_s}

    def restore(self, saved: Saved, now_s: float, downtime: Downtime) -> None:
        """Continues from a snapshot, with the transitions evenly spread; raises UnusableStateError."""
        number = int(min(max(0.0, saved.number("number") or 0.0), MOST + 1.0))
        first_s, last_s = (now_s - age_s(saved.number(key), downtime.end_s) for key in ("first", "last"))
        step_s = max(0.0, last_s - first_s) / max(1, number - 1)
        self._times.extend(first_s + place * step_s for place in range(number))


def _is_recent(time_s: float, now_s: float) -> bool:
    return now_s - time_s < PERIOD_S - TIME_TOLERANCE_S
