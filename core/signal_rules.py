"""The rules of one signal: WARN and ERROR bounds, invalid data, and the latch. Together they give its level."""

from __future__ import annotations

from typing import Any, Dict, Optional, Tuple

from .model import Level
from .rule import Rule, RuleConfig, State
from .signal_config import SignalConfig
from .state_reader import Saved

# Globals are faster than members of an enumeration, above all in Python 3.11, and these are used per sample.
_OK, _WARN, _ERROR, _STALE = Level
_INACTIVE = State.INACTIVE
_WITHOUT_BOUNDS = RuleConfig(below=None, above=None, hysteresis=0.0, for_s=0.0, keep_firing_for_s=0.0)


class SignalRules:
    """Steps 3 to 6 of docs/rules.md without flapping."""

    __slots__ = ("_config", "_latched", "bounds", "error", "invalid", "warn")

    def __init__(self, config: SignalConfig) -> None:
        """Starts with inactive rules."""
        self._config = config
        self._latched = _OK
        self.warn = Rule(RuleConfig.of(config, _WARN))
        self.error = Rule(RuleConfig.of(config, _ERROR))
        self.bounds: Tuple[Rule, Rule] = (self.warn, self.error)
        """The rules with bounds."""
        self.invalid = Rule(_WITHOUT_BOUNDS._replace(for_s=config.invalid_for_s))
        """Fires after invalid data."""

    def configure(self, config: SignalConfig) -> None:
        """Applies a new configuration; states stay where they still have a meaning."""
        self._config = config
        for rule, level in zip(self.bounds, (_WARN, _ERROR)):
            rule.configure(RuleConfig.of(config, level))
            if not self._has_bounds(level.name.lower()):
                rule.clear()
            if config.only_if is None:
                rule.allow(True)
        self.invalid.configure(_WITHOUT_BOUNDS._replace(for_s=config.invalid_for_s))
        if not config.latch:
            self._latched = _OK

    def judge(self, value: float, now_s: float) -> None:
        """Judges a value of the statistic at `now_s`, in seconds."""
        self.warn.judge(value, now_s)
        self.error.judge(value, now_s)

    def note_quality(self, *, good: bool, now_s: float) -> None:
        """Notes whether a datum was valid at `now_s`, in seconds."""
        invalid = self.invalid
        if good is invalid.condition or invalid.state is not _INACTIVE:
            invalid.set_condition(not good, now_s)

    def advance(self, now_s: float) -> None:
        """Advances the time to `now_s`, in seconds."""
        self.warn.advance(now_s)
        self.error.advance(now_s)
        self.invalid.advance(now_s)

    def allow(self, allowed: bool) -> None:
        """Says whether `only_if` holds; counts when the rules advance."""
        self.warn.allow(allowed)
        self.error.allow(allowed)

    def freeze_or_thaw(self, now_s: float, *, unknown: bool, undefined: bool) -> None:
        """Freezes what cannot be judged from `now_s` on, in seconds, and lets the rest continue.

        Args:
            now_s: the time in seconds.
            unknown: the level is unknown.
            undefined: the statistic has no value.
        """
        for rule in self.bounds:
            (rule.freeze if unknown or undefined else rule.thaw)(now_s)
        (self.invalid.freeze if unknown else self.invalid.thaw)(now_s)

    def restart(self, now_s: float) -> None:
        """Restarts running waits: time went back to `now_s`, in seconds."""
        for rule in (self.warn, self.error, self.invalid):
            rule.restart(now_s)

    def release_latch(self) -> None:
        """Clears the latch: the level is what the rules give now."""
        self._latched = _OK

    def level(self, *, stale: bool) -> Level:
        """Returns the true level, and latches it.

        Args:
            stale: the signal was silent for too long.
        """
        level = _ERROR if self.error.fires else _WARN if self.warn.fires else _OK
        if self._config.latch:
            if level > self._latched:
                self._latched = level
            level = self._latched
        if level is not _ERROR:
            if self.invalid.fires:
                return _ERROR
            if stale:
                return _STALE
        return level

    @property
    def state(self) -> str:
        """The state to show of a signal with samples: invalid, latched, or that of the rule."""
        if self.invalid.fires:
            return "invalid"
        warn, error = self.bounds
        fired = _ERROR if error.fires else _WARN if warn.fires else _OK
        if self._latched > fired:
            return "latched"
        return (warn if fired is _WARN or error.state is _INACTIVE else error).state.value

    @property
    def is_at_rest(self) -> bool:
        """Whether all are inactive and stay so as long as no value is beyond a bound."""
        return self.warn.is_at_rest and self.error.is_at_rest and self.invalid.state is _INACTIVE

    def explaining(self, level: Level, announced: Optional[Rule]) -> Optional[Rule]:
        """Returns the rule that explains a level; for OK the one that is pending, held back, or has just cleared.

        Args:
            level: the level.
            announced: the rule of an announced level that is not OK.
        """
        if level is not _OK:
            return self.error if level is _ERROR else self.warn
        for rule in (self.error, self.warn):
            if rule.state is State.PENDING or rule.held_back:
                return rule
        return announced if announced is not None and announced.bound in self._config.bounds.values() else None

    def snapshot(self, now_s: float) -> Dict[str, Any]:
        """Returns the state at `now_s`, in seconds, as JSON values."""
        state: Dict[str, Any] = {}
        for name in ("warn", "error", "invalid"):
            saved = getattr(self, name).snapshot(now_s)
            if saved:
                state[name] = saved
        if self._latched is not _OK:
            state["latched"] = self._latched.name
        return state

    def restore(self, saved: Saved, now_s: float) -> None:
        """Continues from a snapshot of the signal, frozen at `now_s`, in seconds.

        Raises:
            UnusableStateError: the snapshot is malformed.
        """
        for name in ("warn", "error", "invalid"):
            if name == "invalid" or self._has_bounds(name):
                getattr(self, name).restore(saved.section(name), now_s)
        latched = saved.level("latched")
        if self._config.latch and latched is not _STALE:
            self._latched = latched

    def _has_bounds(self, level: str) -> bool:
        return any(name.startswith(level) for name in self._config.bounds)
