"""The rules of a signal: values, bounds and time decide which rules fire; with the latch they give the level.

Theory of operation. A signal has a WARN and an ERROR rule, and one for invalid data, whose condition quality.py judges.
A rule is two steps of docs/rules.md:

* Its *condition* (step 3) says whether the judged statistic is beyond a bound. Bounds are strict, and with a
  hysteresis a condition that is true stays true until the value is back by that much on the healthy side. While
  `only_if` does not hold, the condition is false whatever the value.
* Its *state* (step 4) follows Prometheus's alerting rules: `for_s` is `for`, `keep_firing_for_s` is
  `keep_firing_for`.

Whether it fires and whether its condition is true are its state. A rule advances when its value is judged (`judge`) and
when time passes (`advance`). Each time it takes one row of this table, then, in a waiting state, ends the wait when its
time is up:

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
import math

from ..config import SignalConfig
from ..values import Level
from .saved_state import SavedState

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


# Globals are faster than members of an enumeration, above all in Python 3.11, and these are used per sample.
_OK, _WARN, _ERROR, _STALE = Level
_SEVERITIES = {float(level): level.severity for level in Level}


class Rule:
    """One rule of one signal. Times (`now_s`) are in seconds, values in the unit of the judged statistic."""

    __slots__ = (
        "_above", "_above_clear", "_below", "_below_clear", "_crossed", "_for_s", "_frozen_since_s",
        "_keep_firing_for_s", "allowed", "bound", "fires", "is_below", "since_s",
    )  # fmt: skip

    def __init__(self) -> None:
        """Creates an inactive rule without bounds, which fires at once."""
        self.since_s: float | None = None
        """Since when it waits; moved forward by the time for which it was frozen. None if it does not wait."""
        self.fires = False
        """Whether the rule is firing, or still firing until keep_firing_for_s has passed."""
        self._crossed = False
        self.allowed = True
        """Whether `only_if` holds, or there is none; counts when the rule advances."""
        self._frozen_since_s: float | None = None
        self.bound: float | None = None
        """The bound that the condition crossed last, None before the first time."""
        self.is_below = False
        """Whether `bound` is a lower one."""
        self.configure()

    def configure(
        self,
        below: float | None = None,
        above: float | None = None,
        for_s: float = 0.0,
        keep_firing_for_s: float = 0.0,
        hysteresis: float = 0.0,
    ) -> None:
        """Takes new bounds and durations, those of `SignalConfig`; the state stays until the rule advances."""
        self._below = -math.inf if below is None else below
        self._above = math.inf if above is None else above
        self._below_clear = self._below + hysteresis
        self._above_clear = self._above - hysteresis
        self._for_s = for_s
        self._keep_firing_for_s = keep_firing_for_s
        if self._crossed and self.bound not in (below, above):
            self._crossed = False

    @property
    def condition(self) -> bool:
        """Whether the value last judged was beyond a bound, and `only_if` holds."""
        return self._crossed and self.allowed

    @property
    def has_bounds(self) -> bool:
        """Whether a value can be beyond a bound."""
        return self._below > -math.inf or self._above < math.inf

    @property
    def held_back(self) -> bool:
        """Whether the value last judged was beyond a bound, but `only_if` does not hold."""
        return self._crossed and not self.allowed

    @property
    def state(self) -> State:
        """The state, in which it waits unless it is inactive or firing."""
        if self.fires:
            return State.FIRING if self.condition else State.KEEPING
        return State.PENDING if self.condition else State.INACTIVE

    @property
    def is_at_rest(self) -> bool:
        """Whether it stays inactive, or firing, as long as values stay on their side of its bounds."""
        return self.since_s is None and self._crossed is self.condition is self.fires

    def judge(self, value: float, now_s: float) -> bool:
        """Judges a new value, then advances; returns whether it is at rest, without having advanced."""
        below, above = self._below, self._above
        if self._crossed:
            if self.is_below:
                below = self._below_clear
            else:
                above = self._above_clear
        crossed = self._crossed = value < below or value > above
        if crossed:
            self.is_below = value < below
            self.bound = self._below if self.is_below else self._above
        if self.since_s is None and crossed is self.fires and (self.allowed or not crossed):
            return True
        self.advance(now_s)
        return False

    def judge_condition(self, condition: bool, now_s: float) -> None:
        """Takes a condition that is not about a bound, then advances."""
        self._crossed = condition
        self.advance(now_s)

    def clear(self) -> None:
        """Makes the rule inactive."""
        self._crossed = self.fires = False
        self.since_s = None

    def advance(self, now_s: float) -> None:
        """Advances the time."""
        if self._frozen_since_s is not None:
            return
        if self.condition is self.fires:
            self.since_s = None
            return
        if self.since_s is None:
            self.since_s = now_s
        wait_s = self._for_s if self.condition else self._keep_firing_for_s
        if now_s - self.since_s >= wait_s - TIME_TOLERANCE_S:
            self.fires, self.since_s = self.condition, None

    def freeze(self, now_s: float, *, is_frozen: bool = True) -> None:
        """Neither fires nor clears from `now_s` on, or continues where it stopped."""
        if is_frozen is (self._frozen_since_s is None):
            if self.since_s is not None and self._frozen_since_s is not None:
                self.since_s += now_s - self._frozen_since_s
            self._frozen_since_s = now_s if is_frozen else None

    def restart(self, now_s: float) -> None:
        """Restarts a running wait: time went back to `now_s`."""
        if self.since_s is not None:
            self.since_s = now_s
        if self._frozen_since_s is not None:
            self._frozen_since_s = now_s

    def exchange(self, state: SavedState) -> None:
        """Writes the state, or continues from one, frozen."""
        state.fields(self, bound=float, is_below=False, _crossed=False, allowed=True, fires=False)
        waited_s = state.waited_s("waited_s", self.waited_s(state.now_s))
        if state.is_saved:
            self.freeze(state.now_s)
            if self.bound is not None:  # which may have been changed
                self._crossed = self._crossed and self.bound == (self._below if self.is_below else self._above)
            self.since_s = None if self.condition is self.fires else state.now_s - waited_s

    def waited_s(self, now_s: float) -> float:
        """Returns for how long it has waited, without frozen time, in seconds."""
        if self.since_s is None:
            return 0.0
        return (now_s if self._frozen_since_s is None else self._frozen_since_s) - self.since_s


class SignalRules:
    """Steps 3 to 6 of docs/rules.md without flapping: the rules of one signal, and its latch."""

    __slots__ = ("_config", "_latched", "invalid", "of_bounds", "rules")

    def __init__(self, config: SignalConfig) -> None:
        """Starts with inactive rules."""
        self._latched = _OK
        self.of_bounds = True
        """Whether values are compared with bounds; False if each is a level that a driver reports."""
        self.rules = {_ERROR: Rule(), _WARN: Rule()}
        """The rules about values by the levels that they give, the worst first."""
        self.invalid = Rule()
        """Fires after invalid data."""
        self.configure(config)

    def configure(self, config: SignalConfig) -> None:
        """Applies a new configuration; states stay where they still have a meaning."""
        self._config = config
        of_warn = (config.warn_below, config.warn_above, config.for_s, config.keep_firing_for_s)
        of_error = (config.error_below, config.error_above, config.error_for_s, config.error_keep_firing_for_s)
        for level, rule in self.rules.items():
            rule.configure(*(of_error if level is _ERROR else of_warn), config.hysteresis)
            if self.of_bounds and not rule.has_bounds:
                rule.clear()
            if config.only_if is None:
                rule.allowed = True
        self.invalid.configure(for_s=config.invalid_for_s)
        if not config.latch:
            self._latched = _OK

    def expect_levels(self) -> None:
        """From now on, judges the levels of a DiagnosticStatus as a whole: they take the place of bounds.

        There is a rule for each level but OK. Its condition is that the driver reports this level or a worse one; what
        follows from it is steps 4 and 5 of docs/rules.md, as for bounds.
        """
        self.of_bounds = False
        warn = self.rules.pop(_WARN)
        self.rules.update({_STALE: Rule(), _WARN: warn})
        self.rules[_STALE].allowed = warn.allowed
        self.configure(self._config)

    def judge(self, value: float, now_s: float) -> bool:
        """Judges a value of the statistic, or a level by its wire value; returns whether no rule has advanced."""
        if self.of_bounds:
            are_at_rest = True
            for rule in self.rules.values():
                are_at_rest = rule.judge(value, now_s) and are_at_rest
            return are_at_rest
        for level, rule in self.rules.items():
            rule.judge_condition(_SEVERITIES.get(value, 0) >= level.severity, now_s)
        return False

    def note_quality(self, *, good: bool, now_s: float) -> None:
        """Notes whether a datum was valid."""
        invalid = self.invalid
        if not good or invalid.condition or invalid.fires:
            invalid.judge_condition(not good, now_s)

    def advance(self, now_s: float) -> None:
        """Advances the time."""
        for rule in self.rules.values():
            rule.advance(now_s)
        self.invalid.advance(now_s)

    def allow(self, allowed: bool) -> None:
        """Says whether `only_if` holds; counts when the rules advance."""
        for rule in self.rules.values():
            rule.allowed = allowed

    def freeze_or_thaw(self, now_s: float, *, unknown: bool, undefined: bool) -> None:
        """Freezes all rules while the level is `unknown`, those with bounds while the statistic is `undefined`."""
        for rule in self.rules.values():
            rule.freeze(now_s, is_frozen=unknown or undefined)
        self.invalid.freeze(now_s, is_frozen=unknown)

    def restart(self, now_s: float) -> None:
        """Restarts running waits: time went back to `now_s`."""
        for rule in (*self.rules.values(), self.invalid):
            rule.restart(now_s)

    def release_latch(self) -> None:
        """Clears the latch: the level is what the rules give now."""
        self._latched = _OK

    def _fired(self) -> Level:
        for level, rule in self.rules.items():
            if rule.fires:
                return level
        return _OK

    def level(self, *, stale: bool) -> Level:
        """Returns the true level, and latches it; `stale`: the signal was silent for too long."""
        level = self._fired()
        if self._config.latch and level is not self._latched:
            level = self._latched = Level.worst((level, self._latched))
        if level is not _ERROR:
            if self.invalid.fires:
                return _ERROR
            if stale:
                return _STALE
        return level

    @property
    def state(self) -> str:
        """The state to show of a signal with samples: invalid, latched, or that of the rule."""
        fired = self._fired()
        if self.invalid.fires:
            return "invalid"
        if self._latched.severity > fired.severity:
            return "latched"
        rules = [rule for level, rule in self.rules.items() if fired in (_OK, level)]
        return next((rule for rule in rules if rule.condition or rule.fires), rules[-1]).state.value

    @property
    def is_at_rest(self) -> bool:
        """Whether data is valid, and the rules stay as they are as long as values stay on their side of the bounds."""
        return self.invalid.state is State.INACTIVE and all(rule.is_at_rest for rule in self.rules.values())

    def explaining(self, level: Level, announced: Rule | None) -> Rule | None:
        """Returns the rule that explains a level; for OK the one that is pending, held back, or was left last.

        `announced` is the rule of an announced level that is not OK. A value that was beyond the ERROR bound left the
        WARN bound of the same side last.
        """
        for its_level, rule in self.rules.items():
            if its_level is level or (level is _OK and (rule.state is State.PENDING or rule.held_back)):
                return rule
        if announced is None:
            return None
        bounds, warn = self._config.bounds, self.rules[_WARN]
        side = "warn_below" if announced.is_below else "warn_above"
        if warn.is_below is announced.is_below and warn.bound == bounds.get(side, math.nan):
            return warn
        return announced if announced.bound in bounds.values() else None

    def exchange(self, state: SavedState) -> None:
        """Writes the state of the signal, or continues from one, frozen; raises UnusableStateError."""
        if not state.value("of_bounds", self.of_bounds, True) and self.of_bounds and not self._config.bounds:
            self.expect_levels()
        for level, rule in self.rules.items():
            if rule.has_bounds or not self.of_bounds:
                rule.exchange(state.section("reported_stale" if level is _STALE else level.name.lower()))
        self.invalid.exchange(state.section("invalid"))
        latched = state.value("latched", self._latched, _OK)
        if self._config.latch and (latched is not _STALE or not self.of_bounds):
            self._latched = latched
