"""Step 6 of docs/rules.md and what comes out: which changes of a signal's level become transitions.

Flapping is detected as by Nagios. Source of the formula: Nagios Core documentation, "Detection and Handling of State
Flapping". The last 21 levels hold 20 possible changes; the oldest weighs 0.75, the newest 1.25, those between linearly,
and all 20 make 100 %.

Storms: a signal that announces more than one transition per second for a minute flaps, whatever its configuration. A
value that is noisy around its bound at 400 Hz must not be 400 alerts per second.
"""

from __future__ import annotations

import math
from typing import Sequence

from ..config import SignalConfig
from ..values import Level, Transition
from . import wording
from .rule import TIME_TOLERANCE_S, Rule
from .saved_state import SavedState
from .wording import Judgement

CHANGES = 20
"""Possible changes in the 21 levels."""
# In units of 1/76 the weights are whole numbers, so that a sum exactly at a limit is found to be.
_WEIGHTS = tuple(95 - 2 * place for place in range(CHANGES))
"""Newest change first."""
_TOTAL = sum(_WEIGHTS)
_KEPT = 2**CHANGES - 1

MOST = 60
"""Most transitions in `PERIOD_S` that are no storm."""
PERIOD_S = 60.0
_STORM = f"more than {MOST} transitions in {PERIOD_S:g} s"


class FlapDetector:
    """Follows the levels after good samples, decides whether the signal flaps, and what is not announced meanwhile."""

    __slots__ = ("_changes", "_high", "_last", "_low", "_worst", "flapping")

    def __init__(self, high: float, low: float) -> None:
        """Starts with a past of 21 times OK; see `configure`."""
        self._changes = 0
        """One bit per possible change, the newest in the lowest place."""
        self._last = Level.OK
        self._worst: Level | None = None
        self.flapping = False
        """Whether the signal flaps; a storm sets it, whatever the state change is."""
        self.configure(high, low)

    def configure(self, high: float, low: float) -> None:
        """Flapping begins at a state change of `high` %, if that is at most 100, and ends below `low` %."""
        self._high = high
        self._low = low

    @property
    def percent(self) -> float:
        """Weighted state change, 0 to 100 %."""
        changes = self._changes
        return 100.0 * sum(weight for place, weight in enumerate(_WEIGHTS) if changes >> place & 1) / _TOTAL

    @property
    def is_at_rest(self) -> bool:
        """Whether there was no change, so that the same level again makes no difference."""
        return not self._changes and not self.flapping

    def exchange(self, state: SavedState) -> None:
        """Writes the state, or continues from one; raises UnusableStateError."""
        state.fields(self, _changes=0.0, _last=Level.OK, flapping=False, _worst=Level)
        self._changes = int(self._changes) & _KEPT
        if not self.flapping:
            self._worst = None

    def add(self, level: Level, *, is_storm: bool = False) -> None:
        """Processes the level after a good sample. During a storm, flapping does not end."""
        self._changes = (self._changes << 1 | (level is not self._last)) & _KEPT
        self._last = level
        limit = self._low if self.flapping else self._high
        if limit <= 100.0 and not (is_storm and self.flapping):
            self.flapping = (self.percent if self._changes else 0.0) >= limit
            if not self.flapping:
                self._worst = None

    def end(self) -> None:
        """Ends flapping, whatever the state change is."""
        self.flapping = False
        self._worst = None

    def note_announced(self, level: Level) -> None:
        """Notes a level that is being announced: while flapping, only a worse one is announced again."""
        if self.flapping:
            self._worst = level if self._worst is None else Level.worst((level, self._worst))

    def withholds(self, level: Level) -> bool:
        """Whether a change to `level` is not announced: flapping was, and so was a level at least as bad since."""
        return self._worst is not None and level.severity <= self._worst.severity


class Announcer:
    """The announced level of a signal or a source. It is OK at first. Times are in seconds."""

    __slots__ = (
        "_announced_at_s", "_times", "_unknown_since_s", "_was_known", "announced", "announced_rule",
        "announced_since_s", "config", "flaps",
    )  # fmt: skip

    def __init__(self, config: SignalConfig, now_s: float) -> None:
        """Starts before the level is known."""
        self.announced = Level.OK
        """The level of the last transition."""
        self.announced_since_s = now_s
        """When it was announced first; for OK moved forward by the time in which the level was unknown."""
        self._unknown_since_s: float | None = now_s
        """Since when the level has been unknown; None while it is known."""
        self._was_known = False
        """Whether the level has ever been known."""
        self.announced_rule: Rule | None = None
        """The rule that explained the last transition."""
        self._announced_at_s = now_s
        self.flaps = FlapDetector(math.inf, 0.0)
        """Follows the level after each good sample."""
        self._times: list[float] = []  # most signals have none, and an empty deque takes 760 bytes
        """When the latest transitions were announced: at most one more than are no storm."""
        self._configure(config, now_s)

    def _configure(self, config: SignalConfig, now_s: float) -> None:
        """Applies a new configuration."""
        self.config = config
        self.flaps.configure(config.flap_high if config.flap_detection else math.inf, config.flap_low)
        self._end_flapping_unless_allowed(now_s)

    def _end_flapping_unless_allowed(self, now_s: float) -> None:
        if not self.config.flap_detection and not self.is_storm(now_s):
            self.flaps.end()

    def is_storm(self, now_s: float, more: int = 0) -> bool:
        """Whether more than `MOST` transitions lie within the last `PERIOD_S`, with that many more."""
        return len(self._recent(now_s)) + more > MOST

    def _recent(self, now_s: float) -> list[float]:
        return [time_s for time_s in self._times if now_s - time_s < PERIOD_S - TIME_TOLERANCE_S]

    def note_sample(self, level: Level, now_s: float) -> None:
        """Notes the level after a good sample."""
        flaps = self.flaps
        flaps.add(level, is_storm=flaps.flapping and self.is_storm(now_s, more=1))

    def note_unknown(self, now_s: float) -> None:
        """Notes that the level is unknown from now on."""
        if self._unknown_since_s is None:
            self._unknown_since_s = now_s

    def note_known(self, now_s: float) -> None:
        """Notes that the level is known. Time in which it was not never counts as OK."""
        if self._unknown_since_s is None:
            return
        if self.announced is Level.OK:
            self.announced_since_s = (
                self.announced_since_s + (now_s - self._unknown_since_s) if self._was_known else now_s
            )
        self._unknown_since_s = None
        self._was_known = True

    def is_due(self, level: Level, *, is_news: bool) -> bool:
        """Whether a level is to be announced; `is_news`: flapping never hides it (silence, invalid data)."""
        if level is self.announced:
            return False
        return is_news or not self.flaps.withholds(level)

    def is_repeat_due(self, now_s: float) -> bool:
        """Whether the level is to be announced again (`repeat_s`)."""
        if self.config.repeat_s <= 0.0 or self.announced is Level.OK or self.flaps.flapping:
            return False
        return now_s - self._announced_at_s >= self.config.repeat_s - TIME_TOLERANCE_S

    def announce(self, judgement: Judgement, message: str | None = None, *, caused: str = "") -> Transition:
        """Announces the level of a signal; `message` replaces the reason, `caused` the level and time before it."""
        if judgement.level is not self.announced:
            self._times = [*self._recent(judgement.now_s)[-MOST:], judgement.now_s]
        if self.is_storm(judgement.now_s):
            self.flaps.flapping = True
            judgement = judgement._replace(flapping=True, storm=_STORM)
        self.flaps.note_announced(judgement.level)
        status = wording.status(judgement, message)
        unknown_s = None if self._was_known else judgement.now_s - self.announced_since_s
        self.note_known(judgement.now_s)
        transition = Transition(
            signal=judgement.config.name,
            from_level=self.announced,
            to_level=judgement.level,
            value=judgement.datum if judgement.is_invalid else judgement.judged,
            statistic=judgement.config.statistic,
            bound=None if judgement.rule is None else judgement.rule.bound,
            now_s=judgement.now_s,
            since_s=self.announced_since_s,
            robot=judgement.robot,
            fingerprint=judgement.fingerprint,
            text=wording.alert_line(
                judgement, status.message, self.announced, self.announced_since_s, unknown_s, caused
            ),
            status=status,
            statistics=judgement.statistics,
            repeat=judgement.level is self.announced,
            hint=judgement.hint,
            cause=judgement.cause,
        )
        if not transition.repeat:
            self.announced = judgement.level
            self.announced_since_s = judgement.now_s
        self.announced_rule = judgement.rule
        self._announced_at_s = judgement.now_s
        return transition

    def exchange(self, state: SavedState) -> None:
        """Writes the state, or continues from one, unknown at least since nothing watched.

        May raise UnusableStateError.
        """
        rules = self._explaining_rules
        announced = state.section("announced")
        rule = announced.value("rule", None if self.announced_rule is None else rules.index(self.announced_rule), float)
        self.announced_rule = rules[int(rule)] if rule in range(len(rules)) else None
        self.announced = announced.value("level", self.announced, Level.OK)
        self._was_known = not announced.value("never_known", not self._was_known, False)
        self.announced_since_s = state.since_s("announced", self.announced_since_s)
        unknown_since_s = state.since_s("unknown", self._unknown_since_s)
        repeats = self.config.repeat_s > 0.0 and self.announced is not Level.OK
        waited_s = announced.waited_s("repeat_waited_s", state.now_s - self._announced_at_s if repeats else 0.0)
        self._times = state.times_s("storm", self._times, MOST + 1)
        if state.is_saved:
            self._unknown_since_s = max(self.announced_since_s, min(unknown_since_s, state.unwatched_since_s))
            self._announced_at_s = state.now_s - waited_s
        if state.is_saved or self.config.flap_detection or self.flaps.flapping:
            self.flaps.exchange(announced.section("flaps"))
            self._end_flapping_unless_allowed(state.now_s)

    def restart_time(self, now_s: float, back_s: float) -> None:
        """Time went back to `now_s` by `back_s`."""
        self._times = [time_s - back_s for time_s in self._times]
        self.announced_since_s = min(self.announced_since_s, now_s)
        if self._unknown_since_s is not None:
            self._unknown_since_s = min(self._unknown_since_s, now_s)
        self._announced_at_s = min(self._announced_at_s, now_s)

    @property
    def _explaining_rules(self) -> Sequence[Rule]:
        """The rules that can explain a level; the one that does is saved by its index."""
        return ()
