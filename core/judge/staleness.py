"""Steps 7 and 8 of docs/rules.md: for how long a signal or a source has been silent, and whether its level is known."""

from __future__ import annotations

import math

from ..config import SignalConfig
from .rule import TIME_TOLERANCE_S

LONG_DOWNTIME_S = 10.0
"""After a longer downtime of the link, the startup grace counts again: a robot that boots is not silent."""


class Staleness:
    """Follows the arrivals of one signal. The downtime of the link does not count as silence. Times are in seconds."""

    __slots__ = (
        "_hint", "_hint_since_s", "_limits", "counted_anew_s", "last_seen_s", "limit_s", "seen", "silent_since_s",
        "stale", "unreachable_since_s", "waiting", "without_link_s",
    )  # fmt: skip

    limit_s: float
    """Silence that is not yet too long; infinite where staleness is disabled."""

    def __init__(self, limits: SignalConfig, now_s: float) -> None:
        """Starts before the first sample: the startup grace counts from `now_s`."""
        self.seen = False
        """Whether there has been a sample, good or bad."""
        self.last_seen_s = now_s
        """When the latest sample came; before the first, when the signal began to be watched."""
        self.silent_since_s = now_s
        """The same, moved forward by the downtime of the link."""
        self.stale = False
        """Whether the silence was too long; the next sample ends it."""
        self.waiting = True
        """Whether no sample has come yet, and the silence is not yet too long."""
        self.unreachable_since_s: float | None = None
        """Since when the link has been down; None while it is up."""
        self.without_link_s = 0.0
        """How long the link was down since the latest sample."""
        self._hint = ""
        self._hint_since_s = now_s
        self.configure(limits, now_s)

    @property
    def unknown(self) -> bool:
        """Whether the level is unknown without being STALE."""
        return self.waiting or self.unreachable_since_s is not None

    @property
    def frozen(self) -> bool:
        """Whether rules and durations are frozen."""
        return self.stale or self.unknown

    def configure(self, limits: SignalConfig, now_s: float) -> None:
        """Applies the limits of a configuration; what is silent for less than the new one is not stale any more."""
        self._limits = limits
        self._count()
        self.stale = self.stale and self.is_silent(now_s)
        self.waiting = self.waiting or not (self.stale or self.seen)

    def _count(self) -> None:
        self.counted_anew_s = 0.0
        """The silence after which the limit began to count anew."""
        self.limit_s = self.first_limit_s

    @property
    def first_limit_s(self) -> float:
        """The limit if nothing has made it count anew."""
        limits = self._limits
        if limits.stale_after_s <= 0.0:
            return math.inf
        return limits.stale_after_s if self.seen else limits.startup_grace_s

    @property
    def counts_from_s(self) -> float:
        """Since when the silence counts towards the limit."""
        return self.silent_since_s + self.counted_anew_s

    @property
    def counted_limit_s(self) -> float:
        """The limit, as counted since then."""
        return self.limit_s - self.counted_anew_s

    def count_anew(self, limit_s: float, now_s: float) -> None:
        """Lets the silence be too long only `limit_s` after `now_s`, if that is later than before."""
        self.counted_anew_s = self.silence_s(now_s)
        self.limit_s = max(self.limit_s, self.counted_anew_s + limit_s)

    def is_in_grace(self, now_s: float) -> bool:
        """Whether the startup grace counts, and has not passed: what is not there may be there soon."""
        counts = self.waiting or self.counted_anew_s > 0.0
        return counts and now_s - self.counts_from_s < self._limits.startup_grace_s - TIME_TOLERANCE_S

    def is_due(self, now_s: float) -> bool:
        """Whether a signal that is not stale has been silent for too long."""
        return not self.stale and self.unreachable_since_s is None and self.is_silent(now_s)

    def is_silent(self, now_s: float) -> bool:
        """Whether the silence is too long."""
        return now_s - self.silent_since_s > self.limit_s + TIME_TOLERANCE_S

    def silence_s(self, now_s: float) -> float:
        """Returns the time without samples."""
        return (now_s if self.unreachable_since_s is None else self.unreachable_since_s) - self.silent_since_s

    @property
    def hint(self) -> str:
        """Why there are no samples; empty while there are, or while the link is down."""
        is_silent = (self.stale or self.waiting) and self.unreachable_since_s is None
        return self._hint if is_silent and self._hint_since_s == self.silent_since_s else ""

    def note_hint(self, hint: str) -> None:
        """Notes why there are no samples; valid until the next one."""
        self._hint, self._hint_since_s = hint, self.silent_since_s

    def is_half_over(self, now_s: float) -> bool:
        """Whether the link is up and half of the limit has passed (of the startup grace if staleness is disabled)."""
        limit_s = self._limits.startup_grace_s if self.waiting and math.isinf(self.limit_s) else self.limit_s
        return self.unreachable_since_s is None and now_s - self.silent_since_s >= limit_s / 2.0

    def arrive(self, now_s: float) -> None:
        """Processes a sample, good or bad."""
        self.last_seen_s = self.silent_since_s = now_s
        self.stale = self.waiting = False
        if not self.seen or self.counted_anew_s or self.without_link_s:
            self.seen, self.without_link_s = True, 0.0
            self._count()
        if self.unreachable_since_s is not None:
            self.unreachable_since_s = now_s  # it was on its way when the link broke

    def fall_silent(self) -> float:
        """Makes the signal stale; returns when the limit was reached."""
        self.stale, self.waiting = True, False
        return self.silent_since_s + self.limit_s

    def end_downtime(self, now_s: float, *, is_link: bool = True) -> float:
        """The robot is watched again; returns for how long it was not. `is_link`: for its link was down."""
        if self.unreachable_since_s is None:
            return 0.0
        downtime_s = now_s - self.unreachable_since_s
        self.unreachable_since_s = None
        self.silent_since_s += downtime_s
        if is_link:
            self.without_link_s += downtime_s
            if downtime_s > LONG_DOWNTIME_S and not self.stale:
                self.count_anew(self._limits.startup_grace_s, now_s)
        return downtime_s

    def restart(self, now_s: float) -> None:
        """Time went back to `now_s`: silence counts from here. A stale signal waits for its next sample."""
        self.last_seen_s = self.silent_since_s = now_s
        self.without_link_s = 0.0
        self._count()
        if self.stale:
            self.stale, self.waiting = False, True
        if self.unreachable_since_s is not None:
            self.unreachable_since_s = now_s
