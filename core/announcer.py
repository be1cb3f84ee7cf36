"""Step 6 of docs/rules.md and what comes out: which changes of a signal's level become transitions."""

from __future__ import annotations

import math
from typing import Any, Dict, Optional, Sequence

from . import explanation
from .explanation import Judgement
from .flapping import FlapDetector
from .model import Level, Transition
from .rule import TIME_TOLERANCE_S, Rule
from .signal_config import SignalConfig
from .state_reader import Downtime, Saved, age_s
from .storm import StormDetector


class Announcer:
    """Keeps the announced level of one signal. It is OK at first."""

    __slots__ = (
        "_announced_at_s", "_config", "_unknown_since_s", "_was_known", "flaps", "level", "rule", "since_s", "storm",
    )  # fmt: skip

    def __init__(self, config: SignalConfig, now_s: float) -> None:
        """Starts at `now_s`, in seconds."""
        self.level = Level.OK
        """The level of the last transition."""
        self.since_s = now_s
        """When it was announced first, in seconds; for OK moved forward by the time in which the level was unknown."""
        self._unknown_since_s: Optional[float] = now_s
        """Since when the level has been unknown, in seconds; None while it is known."""
        self._was_known = False
        """Whether the level has ever been known."""
        self.rule: Optional[Rule] = None
        """The rule that explained the last transition."""
        self._announced_at_s = now_s
        self.flaps = FlapDetector(_flap_high(config), config.flap_low)
        """Follows the level after each good sample."""
        self.storm = StormDetector()
        """Follows the transitions."""
        self._config = config

    def configure(self, config: SignalConfig, now_s: float) -> None:
        """Applies a new configuration at `now_s`, in seconds."""
        self._config = config
        self.flaps.configure(_flap_high(config), config.flap_low)
        if not config.flap_detection and not self.storm.is_storm(now_s):
            self.flaps.end()

    def note_sample(self, level: Level, now_s: float) -> None:
        """Notes the level after a good sample at `now_s`, in seconds."""
        flaps = self.flaps
        flaps.add(level, is_storm=flaps.flapping and self.storm.is_storm_with_next(now_s))

    def note_unknown(self, now_s: float) -> None:
        """Notes that the level is unknown from `now_s` on, in seconds."""
        if self._unknown_since_s is None:
            self._unknown_since_s = now_s

    def note_known(self, now_s: float) -> None:
        """Notes that the level is known at `now_s`, in seconds."""
        if self._unknown_since_s is not None:
            self.since_s = self._known_since_s(now_s)
            self._unknown_since_s = None
            self._was_known = True

    def _known_since_s(self, now_s: float) -> float:
        """Returns since when the announced level has lasted, in seconds. Time that was unknown never counts as OK."""
        if self._unknown_since_s is None or self.level is not Level.OK:
            return self.since_s
        return self.since_s + (now_s - self._unknown_since_s) if self._was_known else now_s

    def is_due(self, level: Level, *, is_invalid: bool) -> bool:
        """Whether a level is to be announced; `is_invalid`: it is ERROR for invalid data."""
        if level is self.level:
            return False
        return is_invalid or level is Level.STALE or not self.flaps.withholds(level)

    def is_repeat_due(self, now_s: float) -> bool:
        """Whether the level is to be announced again at `now_s`, in seconds (`repeat_s`)."""
        if self._config.repeat_s <= 0.0 or self.level is Level.OK or self.flaps.flapping:
            return False
        return now_s - self._announced_at_s >= self._config.repeat_s - TIME_TOLERANCE_S

    def announce(self, judgement: Judgement, message: Optional[str] = None) -> Transition:
        """Announces a level.

        Args:
            judgement: the state of the signal.
            message: in place of the reason for its level.
        """
        if judgement.level is not self.level:
            self.storm.note_transition(judgement.now_s)
        if self.storm.is_storm(judgement.now_s):
            self.flaps.begin()
            judgement = judgement._replace(flapping=True, is_storm=True)
        self.flaps.note_announced(judgement.level)
        status = explanation.status(judgement, message)
        unknown_s = None if self._was_known else judgement.now_s - self.since_s
        self.note_known(judgement.now_s)
        transition = Transition(
            signal=judgement.config.name,
            from_level=self.level,
            to_level=judgement.level,
            value=judgement.latest if judgement.is_invalid else judgement.judged,
            statistic=judgement.config.statistic,
            bound=None if judgement.rule is None else judgement.rule.bound,
            now_s=judgement.now_s,
            since_s=self.since_s,
            robot=judgement.robot,
            fingerprint=judgement.fingerprint,
            text=explanation.alert_line(judgement, status.message, self.level, self.since_s, unknown_s),
            status=status,
            statistics=judgement.statistics,
            repeat=judgement.level is self.level,
            hint=status.hint,
        )
        if not transition.repeat:
            self.level = judgement.level
            self.since_s = judgement.now_s
        self.rule = judgement.rule
        self._announced_at_s = judgement.now_s
        return transition

    def snapshot(self, rules: Sequence[Rule], now_s: float) -> Dict[str, Any]:
        """Returns the state at `now_s` as JSON values, without its times (`since`).

        Args:
            rules: the rules of the signal; the one that explains the announced level is saved by its index.
            now_s: the time in seconds.
        """
        state: Dict[str, Any] = {"level": self.level.name}
        if not self._was_known:
            state["never_known"] = True
        if self.rule is not None:
            state["rule"] = rules.index(self.rule)
        if self._config.repeat_s > 0.0 and self.level is not Level.OK:
            state["repeat_waited_s"] = now_s - self._announced_at_s
        flaps = self.flaps.snapshot() if self._config.flap_detection or self.flaps.flapping else {}
        return {**state, "flaps": flaps} if flaps else state

    def since(self, now_s: float, wall_s: float) -> Dict[str, float]:
        """Returns the times of the state, in seconds since 1970.

        Args:
            now_s: the time in seconds.
            wall_s: the same in seconds since 1970.
        """
        times = {"announced": wall_s - (now_s - self.since_s)}
        if self._unknown_since_s is not None:
            times["unknown"] = wall_s - (now_s - self._unknown_since_s)
        return times

    def restore(self, state: Saved, rules: Sequence[Rule], now_s: float, downtime: Downtime) -> None:
        """Continues from a snapshot. The level is unknown since the end of the earlier run, or longer.

        Args:
            state: that of the signal.
            rules: the rules of the signal.
            now_s: the time in seconds.
            downtime: between the earlier run and this one.

        Raises:
            UnusableStateError: the snapshot is malformed.
        """
        saved, since = state.section("announced"), state.section("since")
        self.flaps.restore(saved.section("flaps"))
        self.storm.restore(state.section("storm"), now_s, downtime)
        if not self._config.flap_detection and not self.storm.is_storm(now_s):
            self.flaps.end()
        rule = saved.number("rule")
        self.rule = rules[int(rule)] if rule is not None and rule in range(len(rules)) else None
        self.level = saved.level("level")
        self.since_s = now_s - age_s(since.number("announced"), downtime.end_s)
        unknown = since.number("unknown")
        known_until = downtime.begin_s if unknown is None else min(unknown, downtime.begin_s)
        self._unknown_since_s = max(self.since_s, now_s - age_s(known_until, downtime.end_s))
        self._was_known = not saved.flag("never_known")
        self._announced_at_s = now_s - saved.duration_s("repeat_waited_s")

    def restart(self, now_s: float, back_s: float) -> None:
        """Time went back to `now_s` by `back_s`, in seconds."""
        self.storm.restart_time(back_s)
        self.since_s = min(self.since_s, now_s)
        if self._unknown_since_s is not None:
            self._unknown_since_s = min(self._unknown_since_s, now_s)
        self._announced_at_s = min(self._announced_at_s, now_s)


def _flap_high(config: SignalConfig) -> float:
    return config.flap_high if config.flap_detection else math.inf
