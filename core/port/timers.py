"""Timers on a clock that may stand still, jump ahead or go back."""

from __future__ import annotations

import math
from operator import attrgetter
from typing import Callable


class ClockTimer:
    """A timer that is due every period after a start, however late it is noticed. Implements `middleware.Timer`."""

    due_s: float
    """When it is due next, in s."""
    cancelled = False

    def __init__(self, period_s: float, callback: Callable[[float], None], now_s: float) -> None:
        """Starts a period at `now_s`."""
        self.callback = callback
        self._period_s = period_s
        self._periods: int
        self.restart(now_s)

    def advance(self, now_s: float) -> None:
        """Makes the first period that ends after `now_s` due next. Periods that were missed are skipped."""
        passed = math.floor((now_s - self._start_s) / self._period_s)
        self._periods = max(self._periods, passed) + 1
        self.due_s = self._start_s + self._periods * self._period_s

    def restart(self, now_s: float) -> None:
        """Starts a new period at `now_s`; call when the clock went back."""
        self._start_s, self._periods = now_s, 1
        self.due_s = now_s + self._period_s

    def cancel(self) -> None:
        """Stops the timer. May be called twice, and from its own callback."""
        self.cancelled = True


class ClockTimers:
    """The timers that run on one clock."""

    def __init__(self) -> None:
        """Starts without timers."""
        self._timers: list[ClockTimer] = []
        self._last_s = float("-inf")

    def add(self, timer: ClockTimer) -> None:
        """Adds a timer, and forgets those that were cancelled."""
        self._timers = [*self._running(), timer]

    def cancel_all(self) -> None:
        """Stops every timer."""
        for timer in self._timers:
            timer.cancel()

    def restart(self, now_s: float) -> None:
        """Restarts every period at `now_s`."""
        self._last_s = now_s
        for timer in self._timers:
            timer.restart(now_s)

    def next_s(self) -> float:
        """Returns when the next timer is due, in s; infinity without timers."""
        return min([timer.due_s for timer in self._running()], default=math.inf)

    def take_due(self, now_s: float) -> list[ClockTimer]:
        """Returns the timers that are due, earliest first, each once. If time went back, all periods restart."""
        if now_s < self._last_s:
            self.restart(now_s)
            return []
        self._last_s = now_s
        due = sorted((timer for timer in self._running() if timer.due_s <= now_s), key=attrgetter("due_s"))
        for timer in due:
            timer.advance(now_s)
        return due

    def _running(self) -> list[ClockTimer]:
        return [timer for timer in self._timers if not timer.cancelled]
