"""The rule state machine: a value, its bounds and time decide whether the rule fires.

Theory of operation. A signal has up to two rules, WARN and ERROR. A rule is two steps of docs/rules.md:

* Its *condition* (step 3) says whether the judged statistic is beyond a bound. Bounds are strict, and with a
  hysteresis a condition that is true stays true until the value is back by that much on the healthy side. While
  `only_if` does not hold, the condition is false whatever the value.
* Its *state* (step 4) follows Prometheus's alerting rules: `for_s` is `for`, `keep_firing_for_s` is
  `keep_firing_for`.

A rule advances when its value is judged (`judge`) and when time passes (`advance`). Each time it takes one row of
this table, then, in a waiting state, ends the wait when its time is up:

    state     | condition true | condition false | waits for           | then
    ----------|----------------|-----------------|---------------------|---------
    INACTIVE  | PENDING        | INACTIVE        |                     |
    PENDING   | PENDING        | INACTIVE        | for_s               | FIRING
    FIRING    | FIRING         | KEEPING         |                     |
    KEEPING   | FIRING         | KEEPING         | keep_firing_for_s   | INACTIVE

A wait of 0 ends in the call that began it. FIRING and KEEPING fire. While a rule is frozen (the signal is stale, the
link is down, or the statistic is undefined), it takes no row, and the time does not count.
"""

from __future__ import annotations

import enum
from typing import Any, Dict, NamedTuple, Optional

from .formatting import datum_text
from .model import Level
from .signal_config import SignalConfig
from .state_reader import Saved, UnusableStateError

TIME_TOLERANCE_S = 1e-6
"""Two times closer than this are the same: a double of seconds since 1970 resolves 0.24 microseconds."""


class State(enum.Enum):
    """State of a rule; the values are the words in a status."""

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

_STATE_OF_WORD = {state.value: state for state in State}

# Globals are faster than members of an enumeration, and these are used per sample.
_INACTIVE = State.INACTIVE
_FIRING = State.FIRING


class RuleConfig(NamedTuple):
    """Bounds and durations of one rule; the fields are those of `SignalConfig`."""

    below: Optional[float]
    above: Optional[float]
    hysteresis: float
    for_s: float
    keep_firing_for_s: float

    @classmethod
    def of(cls, signal: SignalConfig, level: Level) -> RuleConfig:
        """Returns the configuration of the WARN or the ERROR rule of `signal`."""
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
        "_for_s",
        "_frozen_since_s",
        "_keep_firing_for_s",
        "bound",
        "condition",
        "fires",
        "is_below",
        "since_s",
        "state",
    )

    def __init__(self, config: RuleConfig) -> None:
        """Creates an inactive rule."""
        self.state = State.INACTIVE
        self.since_s = 0.0
        """When the state began, in seconds; moved forward by the time for which the rule was frozen."""
        self.fires = False
        """Whether the rule is firing, or still firing until keep_firing_for_s has passed."""
        self.condition = False
        """Whether the value last judged was beyond a bound, and `only_if` holds."""
        self._crossed = False
        self._allowed = True
        self._frozen_since_s: Optional[float] = None
        self.bound: Optional[float] = None
        """The bound that the condition crossed last, None before the first time."""
        self.is_below = False
        """Whether `bound` is a lower one."""
        self.configure(config)

    def configure(self, config: RuleConfig) -> None:
        """Takes new bounds and durations; the state stays until the rule advances."""
        infinity = float("inf")
        self._below = -infinity if config.below is None else config.below
        self._above = infinity if config.above is None else config.above
        self._below_clear = self._below + config.hysteresis
        self._above_clear = self._above - config.hysteresis
        self._for_s = config.for_s
        self._keep_firing_for_s = config.keep_firing_for_s
        if self._crossed and self.bound not in (config.below, config.above):
            self._crossed = self.condition = False

    @property
    def held_back(self) -> bool:
        """Whether the value last judged was beyond a bound, but `only_if` does not hold."""
        return self._crossed and not self._allowed

    @property
    def is_at_rest(self) -> bool:
        """Whether it is inactive and stays so as long as no value is beyond a bound."""
        return self.state is _INACTIVE and not self._crossed

    def judge(self, value: float, now_s: float) -> None:
        """Judges a new value, then advances.

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
        if self.state is not (_FIRING if condition else _INACTIVE):
            self.advance(now_s)

    def allow(self, allowed: bool) -> None:
        """Says whether `only_if` holds; counts when the rule advances."""
        self._allowed = allowed
        self.condition = self._crossed and allowed

    def clear(self) -> None:
        """Makes the rule inactive."""
        self._crossed = self.condition = self.fires = False
        self.state = State.INACTIVE

    def set_condition(self, condition: bool, now_s: float) -> None:
        """Applies a condition that was judged elsewhere, then advances."""
        self.condition = condition
        self.advance(now_s)

    def advance(self, now_s: float) -> None:
        """Advances the time to `now_s`, in seconds."""
        if self._frozen_since_s is not None or self.state is (_FIRING if self.condition else _INACTIVE):
            return  # nothing can change
        state = (_NEXT_IF_TRUE if self.condition else _NEXT_IF_FALSE)[self.state]
        if state is not self.state:
            self._enter(state, now_s)
        if state in _AFTER_WAIT:
            wait_s = self._for_s if state is State.PENDING else self._keep_firing_for_s
            if now_s - self.since_s >= wait_s - TIME_TOLERANCE_S:
                self._enter(_AFTER_WAIT[state], now_s)

    def freeze(self, now_s: float) -> None:
        """Neither fires nor clears from `now_s` on, until `thaw`."""
        if self._frozen_since_s is None:
            self._frozen_since_s = now_s

    def thaw(self, now_s: float) -> None:
        """Continues where `freeze` stopped."""
        if self._frozen_since_s is not None:
            self.since_s += now_s - self._frozen_since_s
            self._frozen_since_s = None

    def restart(self, now_s: float) -> None:
        """Restarts a running wait: time went back to `now_s`."""
        self.since_s = now_s
        if self._frozen_since_s is not None:
            self._frozen_since_s = now_s

    def snapshot(self, now_s: float) -> Dict[str, Any]:
        """Returns the state at `now_s` as JSON values; empty if it is that of a new rule."""
        if self.state is _INACTIVE and self.bound is None and not self.condition:
            return {}
        state: Dict[str, Any] = {"state": self.state.value, "condition": self.condition}
        if self.state in _AFTER_WAIT:
            state["waited_s"] = self.waited_s(now_s)
        if self.bound is not None:
            state.update(bound=self.bound, is_below=self.is_below, crossed=self._crossed, allowed=self._allowed)
        return state

    def restore(self, saved: Saved, now_s: float) -> None:
        """Continues from a snapshot, frozen at `now_s` until `thaw`.

        Raises:
            UnusableStateError: the snapshot is malformed.
        """
        bound = saved.number("bound")
        is_below, crossed, allowed = saved.flag("is_below"), saved.flag("crossed"), saved.flag("allowed")
        word = saved.text("state", State.INACTIVE.value)
        state = _STATE_OF_WORD.get(word)
        if state is None:
            words = ", ".join(_STATE_OF_WORD)
            raise UnusableStateError(f"state of a rule: expected one of {words}, got {datum_text(word)}")
        condition = saved.flag("condition")
        waited_s = saved.duration_s("waited_s")
        self.freeze(now_s)
        if bound is not None:
            if bound != (self._below if is_below else self._above):  # the bound was changed
                crossed = False
            self.bound, self.is_below, self._crossed, self._allowed = bound, is_below, crossed, allowed
            condition = crossed and allowed
        self.condition = condition
        self._enter(state, now_s - waited_s)

    def waited_s(self, now_s: float) -> float:
        """Returns for how long the state has lasted, without frozen time, in seconds."""
        return (now_s if self._frozen_since_s is None else self._frozen_since_s) - self.since_s

    def _enter(self, state: State, now_s: float) -> None:
        self.state = state
        self.since_s = now_s
        self.fires = state is State.FIRING or state is State.KEEPING
