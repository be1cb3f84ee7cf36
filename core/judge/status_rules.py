"""The rules of a DiagnosticStatus as a whole: the level that its driver reports takes the place of bounds.

There is a rule for each level but OK. Its condition is that the driver reports this level or a worse one; what follows
from it is steps 4 and 5 of docs/rules.md, as for bounds.
"""

from __future__ import annotations

from typing import Any, Dict, Optional

from ..config.signal_config import SignalConfig
from ..values.model import Level
from .rule import Rule, RuleConfig, SignalRules, State, rule_configs
from .saved_state import Saved

_SEVERITIES = {float(level): level.severity for level in Level}


class StatusRules(SignalRules):
    """The rules of one signal that is judged by the level that a driver reports."""

    __slots__ = ("_worst_first", "reported_stale")

    def __init__(self, config: SignalConfig) -> None:
        """Starts with inactive rules."""
        super().__init__(config)
        self.reported_stale = Rule(RuleConfig())
        self.bounds = (self.warn, self.error, self.reported_stale)
        self._worst_first = ((Level.ERROR, self.error), (Level.STALE, self.reported_stale), (Level.WARN, self.warn))
        self.configure(config)

    def configure(self, config: SignalConfig) -> None:
        """Applies a new configuration; states stay."""
        self._config = config
        warn, error, invalid = rule_configs(config)
        for rule, rule_config in zip(self.bounds, (warn, error, warn)):
            rule.configure(rule_config)
            if config.only_if is None:
                rule.allow(True)
        self.invalid.configure(invalid)
        if not config.latch:
            self._latched = Level.OK

    def judge(self, value: float, now_s: float) -> None:
        """Judges a level that was reported, by its wire value."""
        severity = _SEVERITIES.get(value, 0)
        for level, rule in self._worst_first:
            rule.judge_condition(severity >= level.severity, now_s)

    def advance(self, now_s: float) -> None:
        """Advances the time."""
        for rule in (*self.bounds, self.invalid):
            rule.advance(now_s)

    def level(self, *, stale: bool) -> Level:
        """Returns the true level, and latches it; `stale`: the signal was silent for too long."""
        level = self._fired
        if self._config.latch:
            level = self._latched = Level.worst((level, self._latched))
        if level is not Level.ERROR:
            if self.invalid.fires:
                return Level.ERROR
            if stale:
                return Level.STALE
        return level

    @property
    def state(self) -> str:
        """The state to show of a signal with samples: invalid, latched, or that of the rule."""
        fired = self._fired
        if self.invalid.fires:
            return "invalid"
        if self._latched.severity > fired.severity:
            return "latched"
        rules = [rule for level, rule in self._worst_first if fired in (Level.OK, level)]
        return next((rule for rule in rules if rule.state is not State.INACTIVE), rules[-1]).state.value

    @property
    def is_at_rest(self) -> bool:
        """Whether all are inactive and stay so as long as the driver reports OK."""
        return all(rule.is_at_rest for rule in self.bounds) and self.invalid.state is State.INACTIVE

    def explaining(self, level: Level, announced: Optional[Rule]) -> Optional[Rule]:
        """Returns the rule that explains a level; for OK the one that is pending or held back."""
        for its_level, rule in self._worst_first:
            if its_level is level or (level is Level.OK and (rule.state is State.PENDING or rule.held_back)):
                return rule
        return None

    def snapshot(self, now_s: float) -> Dict[str, Any]:
        """Returns the state as JSON values."""
        state = {**super().snapshot(now_s), "reports_level": True}
        stale = self.reported_stale.snapshot(now_s)
        return {**state, "reported_stale": stale} if stale else state

    def restore(self, saved: Saved, now_s: float) -> None:
        """Continues from a snapshot of the signal, frozen at `now_s`; raises UnusableStateError."""
        for name in ("warn", "error", "invalid", "reported_stale"):
            getattr(self, name).restore(saved.section(name), now_s)
        if self._config.latch:
            self._latched = saved.level("latched")

    @property
    def _fired(self) -> Level:
        return next((level for level, rule in self._worst_first if rule.fires), Level.OK)


def rules_for(saved: Saved, config: SignalConfig) -> SignalRules:
    """Returns new rules of the kind that a snapshot was made of."""
    return StatusRules(config) if saved.flag("reports_level") and not config.bounds else SignalRules(config)
