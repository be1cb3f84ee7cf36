"""Target `heartbeat`: calls an address while the monitor ticks, so that another system notices if it does not."""

from __future__ import annotations

import time
from typing import Callable, Optional

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.model import Level
from robot_health_monitor.runtime.backoff import Backoff

from ..configuration import TargetSettings
from .http_target import HttpTarget
from .sender import DeliveryError

MAX_TICK_AGE_S = 10.0
"""Age of the latest tick, in s, from which the monitor counts as stopped. It ticks each second."""

_FIRST_RETRY_S = 1.0
_CHECK_PERIOD_S = 1.0


class Heartbeat(HttpTarget):
    """Calls the address every `every_s` (GET), as long as ticks come."""

    def __init__(self, settings: TargetSettings, faults: Faults, clock: Callable[[], float] = time.monotonic) -> None:
        """Waits for the first tick.

        Args:
            settings: the target.
            faults: receives failures, as `notify <name>`.
            clock: monotonic seconds.
        """
        super().__init__(settings)
        self._every_s = settings.every_s
        self._part = f"notify {settings.name}"
        self._faults = faults
        self._clock = clock
        self._tick_s: Optional[float] = None
        self._due_s = clock()
        self._backoff = Backoff(_FIRST_RETRY_S, settings.every_s)

    def note_tick(self) -> None:
        """Call at each tick of the monitor; returns at once."""
        self._tick_s = self._clock()

    def step(self) -> float:
        """Calls the address if it is due.

        Returns:
            When to call this again, in s from now.
        """
        now_s = self._clock()
        if now_s < self._due_s:
            return self._due_s - now_s
        if self._tick_s is None or now_s - self._tick_s > MAX_TICK_AGE_S:
            return _CHECK_PERIOD_S
        self._due_s = now_s + self._every_s
        try:
            self.deliver(None)
        except DeliveryError as error:
            self._faults.report(self._part, f"{self.place}: {error}", Level.WARN)
            self._due_s = max(
                min(self._due_s, self._clock() + self._backoff.next_s()), self._clock() + error.retry_after_s
            )
        else:
            self._faults.clear(self._part)
            self._backoff.reset()
        if self.warning:
            self._faults.report(f"{self._part}: url_file", self.warning, Level.WARN)
        else:
            self._faults.clear(f"{self._part}: url_file")
        return max(0.0, self._due_s - self._clock())
