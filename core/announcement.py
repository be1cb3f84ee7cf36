"""Step 6 of docs/rules.md and what comes out: which changes of a signal's level become transitions."""

from __future__ import annotations

from typing import Optional

from . import explanation
from .config import SignalConfig
from .explanation import Judgement
from .flapping import FlapDetector
from .model import Level, Transition
from .rule import TIME_TOLERANCE_S, Rule


class Announcer:
    """Keeps the announced level of one signal. It is OK at first."""

    __slots__ = ("_announced_at_s", "_repeat_s", "flaps", "level", "rule", "since_s")

    def __init__(self, config: SignalConfig, now_s: float) -> None:
        """Starts at `now_s`, in seconds."""
        self.level = Level.OK
        """The level of the last transition."""
        self.since_s = now_s
        """When it was announced first, in seconds."""
        self.rule: Optional[Rule] = None
        """The rule that explained the last transition."""
        self._announced_at_s = now_s
        self.flaps = FlapDetector(config.flap_high, config.flap_low)
        """Follows the level after each good sample, where flap detection is enabled."""
        self._repeat_s = config.repeat_s

    def configure(self, config: SignalConfig) -> None:
        """Applies a new configuration."""
        self._repeat_s = config.repeat_s
        if not config.flap_detection:
            self.flaps = FlapDetector(config.flap_high, config.flap_low)
        self.flaps.configure(config.flap_high, config.flap_low)

    def is_due(self, level: Level, *, is_invalid: bool) -> bool:
        """Whether a level is to be announced; `is_invalid`: it is ERROR for invalid data."""
        if level is self.level:
            return False
        return is_invalid or level is Level.STALE or not self.flaps.withholds(level)

    def is_repeat_due(self, now_s: float) -> bool:
        """Whether the level is to be announced again at `now_s`, in seconds (`repeat_s`)."""
        if self._repeat_s <= 0.0 or self.level is Level.OK or self.flaps.flapping:
            return False
        return now_s - self._announced_at_s >= self._repeat_s - TIME_TOLERANCE_S

    def announce(self, judgement: Judgement, message: Optional[str] = None) -> Transition:
        """Announces a level.

        Args:
            judgement: the state of the signal.
            message: in place of the reason for its level.
        """
        self.flaps.note_announced(judgement.level)
        status = explanation.status(judgement, message)
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
            text=explanation.alert_line(judgement, status.message, self.level, self.since_s),
            status=status,
            statistics=judgement.statistics,
            repeat=judgement.level is self.level,
        )
        if not transition.repeat:
            self.level = judgement.level
            self.since_s = judgement.now_s
        self.rule = judgement.rule
        self._announced_at_s = judgement.now_s
        return transition

    def restart(self, now_s: float) -> None:
        """Time went back to `now_s`, in seconds."""
        self.since_s = min(self.since_s, now_s)
        self._announced_at_s = min(self._announced_at_s, now_s)
