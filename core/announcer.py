"""Step 6 of docs/rules.md and what comes out: which changes of a signal's level become transitions."""

from __future__ import annotations

import math
from typing import Any, Dict, Optional, Sequence

from . import explanation
from .explanation import Judgement
from .flapping import FlapDetector, StormDetector
from .model import Level, Transition
from .rule import TIME_TOLERANCE_S, Rule
from .signal_config import SignalConfig
from .state_reader import Downtime, Saved, age_s


class Announcer:
    """Keeps the announced level of one signal. It is OK at first. Times are in seconds."""

    __slots__ = (
        "_announced_at_s", "_config", "_unknown_since_s", "_was_known", "flaps", "level", "rule", "since_s", "storm",
    )  # fmt: skip

    def __init__(self, config: SignalConfig, now_s: float) -> None:
        """Starts before the level is known."""
        self.level = Level.OK
        """The level of the last transition."""
        self.since_s = now_s
        """When it was announced first; for OK moved forward by the time in which the level was unknown."""
        self._unknown_since_s: Optional[float] = now_s
        """Since when the level has been unknown; None while it is known."""
        self._was_known = False
        """Whether the level has ever been known."""
        self.rule: Optional[Rule] = None
        """The rule that explained the last transition."""
        self._announced_at_s = now_s
        self.flaps = FlapDetector(math.inf, 0.0)
        """Follows the level after each good sample."""
        self.storm = StormDetector()
        """Follows the transitions."""
        self.configure(config, now_s)

    def configure(self, config: SignalConfig, now_s: float) -> None:
        """Applies a new configuration."""
        self._config = config
        self.flaps.configure(config.flap_high if config.flap_detection else math.inf, config.flap_low)
        self._end_flapping_unless_allowed(now_s)

    def _end_flapping_unless_allowed(self, now_s: float) -> None:
        if not self._config.flap_detection and not self.storm.is_storm(now_s):
            self.flaps.end()

    def note_sample(self, level: Level, now_s: float) -> None:
        """Notes the level after a good sample."""
        flaps = self.flaps
        flaps.add(level, is_storm=flaps.flapping and self.storm.is_storm_with_next(now_s))

    def note_unknown(self, now_s: float) -> None:
        """Notes that the level is unknown from now on."""
        if self._unknown_since_s is None:
            self._unknown_since_s = now_s

    def note_known(self, now_s: float) -> None:
        """Notes that the level is known. Time in which it was not never counts as OK."""
        if self._unknown_since_s is None:
            return
        if self.level is Level.OK:
            self.since_s = self.since_s + (now_s - self._unknown_since_s) if self._was_known else now_s
        self._unknown_since_s = None
        self._was_known = True

    def is_due(self, level: Level, *, is_invalid: bool) -> bool:
        """Whether a level is to be announced; `is_invalid`: it is ERROR for invalid data."""
        if level is self.level:
            return False
        return is_invalid or level is Level.STALE or not self.flaps.withholds(level)

    def is_repeat_due(self, now_s: float) -> bool:
        """Whether the level is to be announced again (`repeat_s`)."""
        if self._config.repeat_s <= 0.0 or self.level is Level.OK or self.flaps.flapping:
            return False
        return now_s - self._announced_at_s >= self._config.repeat_s - TIME_TOLERANCE_S

    def announce(self, judgement: Judgement, message: Optional[str] = None) -> Transition:
        """Announces the level of a signal; `message` replaces the reason for it."""
        if judgement.level is not self.level:
            self.storm.note_transition(judgement.now_s)
        if self.storm.is_storm(judgement.now_s):
            self.flaps.flapping = True
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

    def snapshot(self, rules: Sequence[Rule], now_s: float, wall_s: float) -> Dict[str, Any]:
        """Returns the state as JSON values; the rule that explains the level is saved by its index in `rules`.

        `wall_s` is `now_s` in seconds since 1970, as are the times in `since` and `storm`.
        """
        since = {"announced": wall_s - (now_s - self.since_s)}
        if self._unknown_since_s is not None:
            since["unknown"] = wall_s - (now_s - self._unknown_since_s)
        announced: Dict[str, Any] = {"level": self.level.name}
        if not self._was_known:
            announced["never_known"] = True
        if self.rule is not None:
            announced["rule"] = rules.index(self.rule)
        if self._config.repeat_s > 0.0 and self.level is not Level.OK:
            announced["repeat_waited_s"] = now_s - self._announced_at_s
        flaps = self.flaps.snapshot() if self._config.flap_detection or self.flaps.flapping else {}
        if flaps:
            announced["flaps"] = flaps
        storm = self.storm.snapshot(now_s, wall_s)
        return {"since": since, "announced": announced, **({"storm": storm} if storm else {})}

    def restore(self, state: Saved, rules: Sequence[Rule], now_s: float, downtime: Downtime) -> None:
        """Continues from a snapshot; raises UnusableStateError.

        The level is unknown since the end of the earlier run, or longer.
        """
        saved, since = state.section("announced"), state.section("since")
        self.flaps.restore(saved.section("flaps"))
        self.storm.restore(state.section("storm"), now_s, downtime)
        self._end_flapping_unless_allowed(now_s)
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
        """Time went back to `now_s` by `back_s`."""
        self.storm.restart_time(back_s)
        self.since_s = min(self.since_s, now_s)
        if self._unknown_since_s is not None:
            self._unknown_since_s = min(self._unknown_since_s, now_s)
        self._announced_at_s = min(self._announced_at_s, now_s)
