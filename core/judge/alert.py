"""What a signal and a source have in common: a level that is known or not, and announced or held back.

Three levels are kept apart:

* the true level (`_level`) follows from the samples and rules;
* the announced level is that of the last transition. It differs from the true one while the signal flaps, is unknown,
  or is held (docs/rules.md, "One cause, one alert");
* the shown level is the true one, or STALE while it is unknown: before the first sample and while the link is down.

While an alert is held, a transition to a level that is worse than the announced one is not announced; a transition to a
better one always is: creation is suppressed, resolution never. A signal is held by its own source while that is silent,
and by what it depends on (causes.py).

Storms: a signal that announces more than one transition per second for a minute flaps, whatever its configuration. A
value that is noisy around its bound at 400 Hz must not be 400 alerts per second.
"""

from __future__ import annotations

import math
from typing import Mapping

from ..config import SignalConfig
from ..values import Level, Transition, duration_text, fingerprint
from . import wording
from .flapping import FlapDetector
from .rule import TIME_TOLERANCE_S, Rule
from .saved_state import SavedState
from .staleness import LONG_DOWNTIME_S, Staleness
from .wording import Judgement

_OK, _STALE = Level.OK, Level.STALE

MOST = 60
"""Most transitions in `PERIOD_S` that are no storm."""
PERIOD_S = 60.0
_STORM = f"more than {MOST} transitions in {PERIOD_S:g} s"


class Held:
    """Why worse levels are not announced now. Times are in seconds."""

    def __init__(self) -> None:
        """Holds nothing yet."""
        self.silence = ""
        """The alert of its silent source; empty while it is not silent."""
        self.awaits_until_s = -math.inf
        """Messages came again: until when its own sample may come. Minus infinity if it came, or they did not."""
        self.cause = ""
        """The nearest of its causes by `depends_on`; empty without one."""
        self.last_cause = ""
        """The same, or that of the latest moment with one."""
        self.caused_s: float | None = None
        """Since when it has had a cause by `depends_on`; None if it had none."""
        self.ended_s = 0.0
        """When the last one ended."""
        self.settles_until_s = -math.inf
        """Until when it settles after that."""

    def begin(self, cause: str, since_s: float) -> None:
        """Notes the nearest cause; `since_s` counts if it had none before."""
        self.cause = self.last_cause = cause
        if self.caused_s is None:
            self.caused_s = since_s

    def end(self, now_s: float, settles_s: float) -> None:
        """Notes that no cause by `depends_on` is left."""
        self.cause, self.ended_s, self.settles_until_s = "", now_s, now_s + settles_s

    @property
    def text(self) -> str:
        """What it was caused by, and for how long; empty if by nothing that it depends on."""
        if self.caused_s is None:
            return ""
        return f"was caused by {self.last_cause} for {duration_text(self.ended_s - self.caused_s)}"

    def holds(self, now_s: float) -> bool:
        """Whether worse levels are not announced."""
        if self.silence or self.cause or now_s <= self.awaits_until_s + TIME_TOLERANCE_S:
            return True
        return now_s < self.settles_until_s - TIME_TOLERANCE_S

    def leave_out(self, downtime_s: float) -> None:
        """Lets a time count for nothing: the robot could not be reached, or was not watched."""
        self.settles_until_s += downtime_s
        self.awaits_until_s += downtime_s

    def restart(self, now_s: float, settles_s: float) -> None:
        """Time went back to `now_s`: running waits restart."""
        self.awaits_until_s = -math.inf
        if self.caused_s is not None:
            self.settles_until_s = now_s + settles_s
            self.caused_s, self.ended_s = min(self.caused_s, now_s), min(self.ended_s, now_s)


class Alert:
    """The levels of a signal or a source. Methods return the one transition that they cause, or None.

    By itself it is OK, and STALE while it is silent for too long. Times (`now_s`) are in seconds.
    """

    __slots__ = (
        "_announced_at_s", "_fingerprint", "_level", "_level_since_s", "_robot", "_times", "_unknown_since_s",
        "_was_known", "announced", "announced_rule", "announced_since_s", "config", "flaps", "held", "staleness",
    )  # fmt: skip

    def __init__(self, config: SignalConfig, robot: str, now_s: float) -> None:
        """Starts before the first sample: the startup grace counts from `now_s`."""
        self.staleness = Staleness(config, now_s)
        self.announced = _OK
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
        self._robot = robot
        self._fingerprint = fingerprint(robot, config.name)
        self._level = _OK
        self._level_since_s = now_s
        self.held: Held | None = None
        """Why worse levels are not announced; None if nothing holds them back."""
        self._configure(config, now_s)

    @property
    def level(self) -> Level:
        """The level to show: the true one, STALE while it is unknown."""
        if self.staleness.unreachable_since_s is not None:
            return _STALE
        return Level.worst((self._level, _STALE)) if self.staleness.waiting else self._level

    @property
    def _shown_since_s(self) -> float:
        """Since when the level to show has lasted, in seconds."""
        staleness = self.staleness
        if staleness.unreachable_since_s is not None:
            return staleness.unreachable_since_s
        # Before the first sample after a restart, the true level may be older than the monitor.
        return self._level_since_s if self.level is self._level else staleness.last_seen_s

    @property
    def state(self) -> str:
        """The state to show: waiting, unreachable, stale, or inactive."""
        staleness = self.staleness
        if staleness.unreachable_since_s is not None:
            return "unreachable"
        if staleness.waiting:
            return "waiting"
        return "stale" if staleness.stale else "inactive"

    @property
    def cause(self) -> str:
        """Name of the alert that this one suffers from; empty without one."""
        return "" if self.held is None else self.held.silence or self.held.cause

    @property
    def is_announced(self) -> bool:
        """Whether an alert of it is open."""
        return self.announced is not _OK

    @property
    def is_withheld(self) -> bool:
        """Whether it has a cause, and its level is worse than the announced one."""
        return bool(self.cause) and self.level.severity > self.announced.severity

    def hold(self, alert: str) -> None:
        """Holds worse levels back: its source is silent, which is an alert of this name; if empty, no longer."""
        if alert:
            self._get_held().silence = alert
        elif self.held is not None:
            self.held.silence, self.held.awaits_until_s = "", -math.inf

    def await_sample(self, until_s: float) -> None:
        """Ends `hold`, but waits until then for its own sample: messages came again, or may come."""
        held = self.held
        if held is not None and (held.silence or held.awaits_until_s > -math.inf):
            held.silence, held.awaits_until_s = "", until_s

    def note_cause(self, cause: str, now_s: float) -> Transition | None:
        """Notes the nearest of its causes by `depends_on`; empty if there is none, or none any more."""
        if cause:
            self._get_held().begin(cause, now_s)
        elif self.held is not None and self.held.cause:
            self.held.end(now_s, self._settles_s)
            return self._settle(now_s)
        return None

    def _get_held(self) -> Held:
        self.held = self.held or Held()
        return self.held

    @property
    def _settles_s(self) -> float:
        """How long it settles when its last cause has ended."""
        return max(self.config.for_s, self.config.stale_after_s)

    def inhibit(self, now_s: float) -> None:
        """Freezes it: from `now_s` on, the robot cannot be reached."""
        if self.staleness.unreachable_since_s is None:
            self.staleness.unreachable_since_s = now_s
            if self._unknown_since_s is None:
                self._unknown_since_s = now_s

    def _end_downtime(self, now_s: float, *, is_link: bool) -> float:
        """Ends `inhibit`; returns how long that was. `is_link`: the link was down; else nothing watched the robot."""
        downtime_s = self.staleness.end_downtime(now_s, is_link=is_link)
        if self.held is not None:
            self.held.leave_out(downtime_s)
            if is_link and downtime_s > LONG_DOWNTIME_S and self.held.awaits_until_s > -math.inf:
                self.held.awaits_until_s = max(self.held.awaits_until_s, now_s + self.config.startup_grace_s)
        return downtime_s

    def restart_time(self, now_s: float, back_s: float) -> None:
        """Restarts what waits: time went back to `now_s` by `back_s`."""
        self._times = [time_s - back_s for time_s in self._times]
        self._level_since_s = min(self._level_since_s, now_s)
        self.announced_since_s = min(self.announced_since_s, now_s)
        if self._unknown_since_s is not None:
            self._unknown_since_s = min(self._unknown_since_s, now_s)
        self._announced_at_s = min(self._announced_at_s, now_s)
        self.staleness.restart(now_s)
        if self.held is not None:
            self.held.restart(now_s, self._settles_s)

    def _configure(self, config: SignalConfig, now_s: float) -> None:
        """Applies a new configuration of the same name; durations stay."""
        self.config = config
        self.flaps.high, self.flaps.low = config.flap_high if config.flap_detection else math.inf, config.flap_low
        self._end_flapping_unless_allowed(now_s)
        self.staleness.configure(config, now_s)

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

    def note_known(self, now_s: float) -> None:
        """Notes that the level is known. Time in which it was not never counts as OK."""
        if self._unknown_since_s is None:
            return
        if self.announced is _OK:
            self.announced_since_s = (
                self.announced_since_s + (now_s - self._unknown_since_s) if self._was_known else now_s
            )
        self._unknown_since_s = None
        self._was_known = True

    def is_repeat_due(self, now_s: float) -> bool:
        """Whether the level is to be announced again (`repeat_s`)."""
        if self.config.repeat_s <= 0.0 or self.announced is _OK or self.flaps.flapping:
            return False
        return now_s - self._announced_at_s >= self.config.repeat_s - TIME_TOLERANCE_S

    def judgement(self, now_s: float) -> Judgement:
        """Returns the state after the last call, as of `now_s`. Reads only."""
        staleness, flaps = self.staleness, self.flaps
        return Judgement(
            config=self.config,
            robot=self._robot,
            fingerprint=self._fingerprint,
            now_s=now_s,
            level=self.level,
            state=self.state,
            announced=self.announced,
            since_s=self._shown_since_s,
            seen=staleness.seen,
            is_stale=staleness.stale,
            last_seen_s=staleness.last_seen_s,
            silence_s=staleness.silence_s(now_s),
            without_link_s=staleness.without_link_s,
            limit_s=staleness.counted_limit_s,
            hint=staleness.hint,
            flapping=flaps.flapping,
            state_change_percent=flaps.percent,
            cause=self.cause,
        )

    def exchange(self, state: SavedState) -> None:
        """Writes the state, or continues from one, before the first sample, unknown at least since nothing watched.

        After an UnusableStateError it must not be used.
        """
        announced = state.section("announced")
        rules = self._explaining_rules
        of_rule = next((level for level, rule in rules.items() if rule is self.announced_rule), None)
        self.announced_rule = rules.get(announced.value("rule", of_rule, Level))
        self.announced = announced.value("level", self.announced, _OK)
        self._was_known = not announced.value("never_known", not self._was_known, False)
        self.announced_since_s = state.since_s("announced", self.announced_since_s)
        unknown_since_s = state.since_s("unknown", self._unknown_since_s)
        repeats = self.config.repeat_s > 0.0 and self.announced is not _OK
        waited_s = announced.waited_s("repeat_waited_s", state.now_s - self._announced_at_s if repeats else 0.0)
        self._times = state.times_s("storm", self._times, MOST + 1)
        if state.is_saved:
            self._unknown_since_s = max(self.announced_since_s, min(unknown_since_s, state.unwatched_since_s))
            self._announced_at_s = state.now_s - waited_s
        if state.is_saved or self.config.flap_detection or self.flaps.flapping:
            self.flaps.exchange(announced.section("flaps"))
            self._end_flapping_unless_allowed(state.now_s)
        # A silence that is announced as its source's is known again after a restart, by itself or with its source.
        is_open = self.announced.severity >= _STALE.severity
        is_stale = state.value("stale", self.staleness.stale and is_open, False)
        if state.is_saved:
            if is_stale:
                self.staleness.fall_silent()
            self._level = self._true_level()
        self._level_since_s = state.since_s("level", self._level_since_s)
        held = self.held or Held()
        cause = state.value("cause", "" if held.caused_s is None else held.last_cause, "")
        caused_s = state.since_s("caused", held.caused_s)
        if cause and state.is_saved:
            self._get_held().begin(cause, caused_s)

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

    def end(self, now_s: float) -> Transition | None:
        """Returns the transition with which an alert that is open leaves the configuration."""
        if not self.is_announced:
            return None
        ended = self.judgement(now_s)._replace(level=_OK, rule=None, is_invalid=False, flapping=False, hint="")
        return self.announce(ended, "no longer watched")

    @property
    def _explaining_rules(self) -> Mapping[Level, Rule]:
        """The rules that can explain a level, by the levels that they give."""
        return {}

    def _true_level(self) -> Level:
        return _STALE if self.staleness.stale else _OK

    def _is_news(self, level: Level) -> bool:
        """Whether flapping never hides a level: silence, or invalid data."""
        return self.staleness.stale and level is _STALE

    def _settle(self, now_s: float) -> Transition | None:
        return self._enter(self._true_level(), now_s)

    def _enter(self, level: Level, now_s: float) -> Transition | None:
        """Announces the true level unless it is announced already, unknown, held, or withheld by flapping."""
        if level is not self._level:
            self._level = level
            self._level_since_s = now_s
        if self.staleness.unknown:
            return None
        held, caused = self.held, ""
        if held is not None:
            is_worse = level.severity > self.announced.severity
            if not held.holds(now_s):
                self.held, caused = None, held.text if is_worse else ""
            elif is_worse:
                self.note_known(now_s)
                return None
        if level is self.announced or (self.flaps.withholds(level) and not self._is_news(level)):
            self.note_known(now_s)
            return None
        return self.announce(self.judgement(now_s), caused=caused)
