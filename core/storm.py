"""Storms: a signal that announces more than one transition per second for a minute flaps, whatever its configuration.

A value that is noisy around its bound at 400 Hz must not be 400 alerts per second. See step 6 of docs/rules.md.
"""

from __future__ import annotations

from collections import deque
from typing import Deque, Dict

from .rule import TIME_TOLERANCE_S
from .state_reader import Downtime, Saved, age_s

MOST = 60
"""Most transitions in `PERIOD_S` that are no storm."""
PERIOD_S = 60.0


class StormDetector:
    """Counts the transitions of one signal in the last minute."""

    __slots__ = ("_times",)

    def __init__(self) -> None:
        """Starts without transitions."""
        self._times: Deque[float] = deque(maxlen=MOST + 1)
        """When the latest transitions were announced, in seconds."""

    def note_transition(self, now_s: float) -> None:
        """Notes that a transition is announced at `now_s`, in seconds."""
        self._times.append(now_s)

    def is_storm(self, now_s: float) -> bool:
        """Whether more than `MOST` transitions lie within the last `PERIOD_S` before `now_s`, in seconds."""
        return len(self._times) > MOST and self._is_recent(self._times[0], now_s)

    def is_storm_with_next(self, now_s: float) -> bool:
        """Whether it would be a storm with one more transition at `now_s`, in seconds."""
        return len(self._times) >= MOST and self._is_recent(self._times[-MOST], now_s)

    def restart_time(self, back_s: float) -> None:
        """Time went back by `back_s`, in seconds: the transitions are as long ago as before."""
        for _ in range(len(self._times)):
            self._times.append(self._times.popleft() - back_s)

    def snapshot(self, now_s: float, wall_s: float) -> Dict[str, float]:
        """Returns the state at `now_s` as JSON values: the number of recent transitions, the times of two of them.

        Args:
            now_s: the time in seconds.
            wall_s: the same in seconds since 1970.
        """
        recent = [time_s for time_s in self._times if self._is_recent(time_s, now_s)]
        if not recent:
            return {}
        ahead_s = wall_s - now_s
        return {"number": len(recent), "first": recent[0] + ahead_s, "last": recent[-1] + ahead_s}

    def restore(self, saved: Saved, now_s: float, downtime: Downtime) -> None:
        """Continues from a snapshot. Transitions between the first and the last count as evenly spread.

        Args:
            saved: the snapshot.
            now_s: the time in seconds.
            downtime: between the earlier run and this one.

        Raises:
            UnusableStateError: the snapshot is malformed.
        """
        number = int(min(max(0.0, saved.number("number") or 0.0), MOST + 1.0))
        first_s, last_s = (now_s - age_s(saved.number(key), downtime.end_s) for key in ("first", "last"))
        step_s = max(0.0, last_s - first_s) / max(1, number - 1)
        self._times.extend(first_s + place * step_s for place in range(number))

    @staticmethod
    def _is_recent(time_s: float, now_s: float) -> bool:
        return now_s - time_s < PERIOD_S - TIME_TOLERANCE_S
