"""The rule state machine: a value, its bounds and time become "fires" or "does not fire".

Theory of operation. A signal has up to two rules, WARN and ERROR. A rule is two steps of SEMANTICS.md:

* Its *condition* (step 3) says whether the judged statistic is beyond a bound. Bounds are strict, and with a
  hysteresis a condition that is true stays true until the value is back by that much on the healthy side. While
  `only_if` forbids it, the condition is false whatever the value.
* Its *state* (step 4) says since when. These are the alerting rules of Prometheus: `for_s` is its `for`,
  `keep_firing_for_s` its `keep_firing_for`.

A rule is looked at when its value is judged (`judge`) and when time passes (`advance`). Each look takes one row of
this table, then, in a waiting state, ends the wait when its time is up:

    state     | condition true | condition false | waits for           | then
    ----------|----------------|-----------------|---------------------|---------
    INACTIVE  | PENDING        | INACTIVE        |                     |
    PENDING   | PENDING        | INACTIVE        | for_s               | FIRING
    FIRING    | FIRING         | KEEPING         |                     |
    KEEPING   | FIRING         | KEEPING         | keep_firing_for_s   | INACTIVE

A wait of 0 ends in the look that began it, so that PENDING and KEEPING are passed through unseen. FIRING and KEEPING
fire. The signal's level is the level of its worst rule that fires; `signal_monitor.py` puts latch, quality and
staleness on top of it.
"""

from __future__ import annotations

import enum
from typing import NamedTuple, Optional

from .config import SignalConfig
from .model import Level

TIME_TOLERANCE_S = 1e-6
"""Two times closer than this are the same: a double of seconds since 1970 resolves 0.24 microseconds."""


class State(enum.Enum):
    """Where a rule is; the values are the words that people read."""

    INACTIVE = "inactive"
    """The condition is false."""
    PENDING = "pending"
    """The condition is true, not yet for long enough."""
    FIRING = "firing"
    """The condition has been true for long enough."""
    KEEPING = "keeps firing"
    """The condition is false again, not yet for long enough."""


_NEXT_IF_TRUE = {
    State.INACTIVE: State.PENDING,
    State.PENDING: State.PENDING,
    State.FIRING: State.FIRING,
    State.KEEPING: State.FIRING,
}
_NEXT_IF_FALSE = {
    State.INACTIVE: State.INACTIVE,
    State.PENDING: State.INACTIVE,
    State.FIRING: State.KEEPING,
    State.KEEPING: State.KEEPING,
}
_AFTER_WAIT = {State.PENDING: State.FIRING, State.KEEPING: State.INACTIVE}

# Globals are found faster than members of an enumeration, and these are looked at per sample.
_INACTIVE = State.INACTIVE
_FIRING = State.FIRING


class RuleConfig(NamedTuple):
    """What a rule is told; the fields are those of `SignalConfig`."""

    below: Optional[float]
    above: Optional[float]
    hysteresis: float
    for_s: float
    keep_firing_for_s: float

    @classmethod
    def of(cls, signal: SignalConfig, level: Level) -> RuleConfig:
        """Returns what `signal` says about its WARN or its ERROR rule."""
        if level is Level.WARN:
            return cls(signal.warn_below, signal.warn_above, signal.hysteresis, signal.for_s, signal.keep_firing_for_s)
        return cls(
            signal.error_below,
            signal.error_above,
            signal.hysteresis,
            signal.error_for_s,
            signal.error_keep_firing_for_s,
        )


class Rule:
    """One rule of one signal."""

    __slots__ = (
        "_above",
        "_above_clear",
        "_allowed",
        "_below",
        "_below_clear",
        "_crossed",
        "_wait_s",
        "bound",
        "condition",
        "fires",
        "is_below",
        "since_s",
        "state",
    )

    def __init__(self, config: RuleConfig) -> None:
        """Makes an inactive rule."""
        self.state = State.INACTIVE
        self.since_s = 0.0
        """When the state began, in seconds; moved on by as long as the rule stood still."""
        self.fires = False
        """Whether the rule's level counts: it is firing or keeps firing."""
        self.condition = False
        """Whether the value last judged was beyond a bound, and the rule is allowed to say so."""
        self._crossed = False
        self._allowed = True
        self.bound: Optional[float] = None
        """The bound that the condition crossed last, None before the first time."""
        self.is_below = False
        """Whether `bound` is a lower one."""
        self.configure(config)

    def configure(self, config: RuleConfig) -> None:
        """Takes new bounds and durations; the state stays, and the next look decides by the new ones."""
        infinity = float("inf")
        self._below = -infinity if config.below is None else config.below
        self._above = infinity if config.above is None else config.above
        self._below_clear = self._below + config.hysteresis
        self._above_clear = self._above - config.hysteresis
        self._wait_s = {State.PENDING: config.for_s, State.KEEPING: config.keep_firing_for_s}
        if self._crossed and self.bound not in (config.below, config.above):
            self._crossed = self.condition = False

    @property
    def held_back(self) -> bool:
        """Whether the value last judged was beyond a bound, and `only_if` forbids the rule to say so."""
        return self._crossed and not self._allowed

    @property
    def is_at_rest(self) -> bool:
        """Whether it is inactive and stays so as long as no value is beyond a bound."""
        return self.state is _INACTIVE and not self._crossed

    def judge(self, value: float, now_s: float) -> None:
        """Looks at the condition with a new value, then advances.

        Args:
            value: the judged statistic, in its unit.
            now_s: the time in seconds.
        """
        below, above = self._below, self._above
        if self._crossed:
            if self.is_below:
                below = self._below_clear
            else:
                above = self._above_clear
        if value < below:
            self.bound = self._below
            self._crossed = self.is_below = True
        elif value > above:
            self.bound = self._above
            self._crossed = True
            self.is_below = False
        else:
            self._crossed = False
        condition = self.condition = self._crossed and self._allowed
        if self.state is not (_FIRING if condition else _INACTIVE):  # else it waits for nothing
            self.advance(now_s)

    def allow(self, allowed: bool) -> None:
        """Lets the condition count or not (`only_if`), from the next look on."""
        self._allowed = allowed
        self.condition = self._crossed and allowed

    def clear(self) -> None:
        """Forgets what was judged: the rule is inactive."""
        self._crossed = self.condition = self.fires = False
        self.state = State.INACTIVE

    def set_condition(self, condition: bool, now_s: float) -> None:
        """Takes a condition that was judged elsewhere, then advances."""
        self.condition = condition
        self.advance(now_s)

    def advance(self, now_s: float) -> None:
        """Lets time pass until `now_s`, in seconds."""
        state = (_NEXT_IF_TRUE if self.condition else _NEXT_IF_FALSE)[self.state]
        if state is not self.state:
            self._enter(state, now_s)
        wait_s = self._wait_s.get(state)
        if wait_s is not None and now_s - self.since_s >= wait_s - TIME_TOLERANCE_S:
            self._enter(_AFTER_WAIT[state], now_s)

    def _enter(self, state: State, now_s: float) -> None:
        self.state = state
        self.since_s = now_s
        self.fires = state is State.FIRING or state is State.KEEPING
