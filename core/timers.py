"""Timers on a clock that may stand still, jump ahead or go back."""

from __future__ import annotations

import math
from typing import Callable, List, Optional


class ClockTimer:
    """One timer: due every period after its start."""

    def __init__(self, period_s: float, callback: Callable[[float], None], now_s: float) -> None:
        """Starts a period at `now_s`."""
        self.callback = callback
        self.cancelled = False
        self._period_s = period_s
        self._start_s = now_s
        self._periods = 1

    @property
    def due_s(self) -> float:
        """When it is due next, in s."""
        return self._start_s + self._periods * self._period_s

    def cancel(self) -> None:
        """Stops it. May be called twice, and from its own callback."""
        self.cancelled = True

    def restart(self, now_s: float) -> None:
        """Starts a new period at `now_s`."""
        self._start_s, self._periods = now_s, 1

    def advance(self, now_s: float) -> None:
        """Makes the next period after `now_s` the one that is due; the beat stays that of the start."""
        passed = math.floor((now_s - self._start_s) / self._period_s)
        self._periods = max(self._periods, passed) + 1


class ClockTimers:
    """The timers of one node."""

    def __init__(self) -> None:
        """Starts with none."""
        self._timers: List[ClockTimer] = []
        self._last_s = float("-inf")

    def add(self, timer: ClockTimer) -> None:
        """Adds a timer."""
        self._timers.append(timer)

    def cancel_all(self) -> None:
        """Stops every timer."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def next_s(self) -> Optional[float]:
        """Returns when the next one is due, in s; None when there is none."""
        return min((timer.due_s for timer in self._timers if not timer.cancelled), default=None)

    def take_due(self, now_s: float) -> List[ClockTimer]:
        """Returns the timers that are due, in the order of their times, each once; all start anew if time went back."""
        self._timers = [timer for timer in self._timers if not timer.cancelled]
        went_back, self._last_s = now_s < self._last_s, now_s
        if went_back:
            for timer in self._timers:
                timer.restart(now_s)
            return []
        due = sorted((timer for timer in self._timers if timer.due_s <= now_s), key=lambda timer: timer.due_s)
        for timer in due:
            timer.advance(now_s)
        return due
