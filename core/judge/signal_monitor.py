"""One signal, judged in the order of docs/rules.md: quality, window, condition, duration, latch, flapping, staleness.

`observe`, `tick`, `follow`, `release`, `reset` and `configure` return the one transition that they cause, or None. The
levels, and what is announced of them, are those of alert.py.
"""

from __future__ import annotations

import math
import sys
from typing import Callable, Mapping

from ..config import SignalConfig
from ..values import DriverStatus, Level, Transition
from .alert import Alert, Held
from .forecast import ForecastWindow, window_for
from .quality import number_of, received
from .rule import Rule, SignalRules
from .sample_summary import SampleCollector
from .saved_state import SavedState
from .window import CountWindow, GapWindow, Samples, Window
from .wording import Judgement

# Globals are faster than members of an enumeration, above all in Python 3.11, and these are used per sample.
_OK, _WARN, _ERROR, _STALE = Level

_LARGEST = sys.float_info.max
MOST_STATISTICS = 300
"""Most values of a statistic that are kept to be shown."""


_WINDOW_KEYS = ("statistic", "window_s", "window_samples", "window_min_s", "forecast_s", "bounds")
"""Properties of a configuration that its window depends on."""


class SignalMonitor(Alert):
    """State and judgement of one signal. Times (`now_s`) are in seconds."""

    __slots__ = (
        "_bad_samples", "_calm_max", "_calm_min", "_good_samples", "_healthy_max", "_latest", "_rules",
        "_settled", "_statistics", "_valid_max", "_valid_min", "_zero_s", "collector", "judged", "window",
    )  # fmt: skip

    _settled: bool
    """Whether nothing follows from a sample at which the rules stay at rest."""

    def __init__(self, config: SignalConfig, robot: str, now_s: float) -> None:
        """Starts before the first sample: the startup grace counts from `now_s`."""
        super().__init__(config, robot, now_s)
        self._good_samples = self._bad_samples = 0
        self._latest: object = None
        """The latest datum as received."""
        self.window = window_for(config)
        self.judged = self.window.statistic(config.statistic)
        """The value of the statistic that the bounds apply to; None while it is undefined."""
        self._statistics: Window | None = None
        """The values of the judged statistic at ticks, to show; None if the window is shown."""
        self.collector: SampleCollector | None = None
        """Collects the values of the judged statistic for a history; None if nothing stores them."""
        self._rules = SignalRules(config)
        self._zero_s: float | None = None
        """When nothing was found in the graph, in the startup grace; None if something was, or at another time."""
        self._use_config(config)
        self._know_count(now_s)

    @property
    def state(self) -> str:
        """The state to show: waiting, unreachable, stale, invalid, latched, or that of the rule."""
        return super().state if self.staleness.frozen else self._rules.state

    @property
    def latest_good(self) -> float | None:
        """Value of the latest sample; None while there is none, it is bad, or the signal is stale or unreachable."""
        return None if self.staleness.frozen or self._rules.invalid.condition else self.window.last()

    def observe(self, value: object, now_s: float) -> Transition | None:
        """Processes a sample that arrived at `now_s`, not before the previous call."""
        number = value if type(value) is float else _calm_number(value)
        if self._calm_min < number <= self._calm_max:
            staleness = self.staleness
            if now_s - staleness.silent_since_s <= staleness.limit_s:
                # Most samples of a healthy robot: they change no rule and no level (_use_config).
                self.window.add(number, now_s)
                self.judged = number
                staleness.last_seen_s = staleness.silent_since_s = now_s
                self._latest = value
                self._good_samples += 1
                if self.collector is not None:
                    self.collector.note(number, now_s)
                return None
        return self._judge(value, now_s)

    def tick(self, now_s: float) -> Transition | None:
        """Advances the time."""
        staleness = self.staleness
        if self._calm_max > -math.inf and now_s - staleness.silent_since_s <= staleness.limit_s:
            if self.collector is not None:
                self.collector.note_level(_OK, now_s)
            return None  # everything is at rest, and stays so until a sample comes
        if self._zero_s is not None and not staleness.is_in_grace(now_s):
            if now_s - self._zero_s <= max(self.config.stale_after_s, 5.0):
                return self._judge(0.0, now_s)
            self._zero_s = None
        if staleness.is_due(now_s):
            self._freeze_or_thaw(self._fall_silent())
        if self.config.statistic == "count" and not staleness.frozen:
            self._judge_rules(now_s)
        self._rules.advance(now_s)
        if self._statistics is not None:
            self._note_statistic(self._statistics, now_s)
        transition = self._settle(now_s)
        if transition is not None or self._level is not self.announced or staleness.unknown:
            return transition
        return self.announce(self.judgement(now_s)) if self.is_repeat_due(now_s) else None

    def follow(self, latest_good: Callable[[str], float | None], now_s: float) -> Transition | None:
        """Judges the conditions on other signals; `latest_good` returns the value of one, None while it is unknown."""
        only_if, release_if = self.config.only_if, self.config.latch_release_if
        if only_if is release_if is None or self.staleness.unreachable_since_s is not None:
            return None
        if only_if is not None:
            value = latest_good(only_if.signal)
            self._rules.allow(value is None or only_if.holds(value))
        if release_if is not None:
            value = latest_good(release_if.signal)
            if value is not None and release_if.holds(value):
                self._rules.release_latch()
        self._rules.advance(now_s)
        return self._settle(now_s)

    def _get_held(self) -> Held:
        self._unsettle()
        return super()._get_held()

    def inhibit(self, now_s: float) -> None:
        """Freezes the signal: from `now_s` on, the robot cannot be reached."""
        super().inhibit(now_s)
        self._freeze_or_thaw(now_s)

    def release(self, now_s: float, *, is_link: bool = True) -> Transition | None:
        """Ends `inhibit`: durations and the time without samples continue where they stopped.

        `is_link`: the link was down; otherwise nothing watched the robot.
        """
        self.window.leave_out(self._end_downtime(now_s, is_link=is_link))
        self._freeze_or_thaw(now_s)
        self._judge_rules(now_s)  # samples that arrived while the link was down
        return self._settle(now_s)

    def restart_time(self, now_s: float, back_s: float) -> None:
        """Restarts window, pending timers and staleness: time went back to `now_s` by `back_s`. Latches stay."""
        super().restart_time(now_s, back_s)
        self.window.clear()
        if self._statistics is not None:
            self._statistics.clear()
        if self.config.statistic != "last":
            self.judged = None
        self._rules.restart(now_s)
        self._begin_count(now_s)
        self._freeze_or_thaw(now_s)

    def reset(self, now_s: float) -> Transition | None:
        """Clears the latch: the level is what the rules give now."""
        self._rules.release_latch()
        return self._settle(now_s)

    def configure(self, config: SignalConfig, now_s: float) -> Transition | None:
        """Applies a new configuration of the same signal and judges by it at once; samples and durations stay."""
        if any(getattr(config, key) != getattr(self.config, key) for key in _WINDOW_KEYS):
            window = window_for(config)
            window.take_over(self.window)
            self.window = window
        if not self._rules.of_bounds and _source(config) != _source(self.config):
            self._rules = SignalRules(config)
        else:
            self._rules.configure(config)
        self._use_config(config)
        self._configure(config, now_s)
        self._know_count(now_s)
        self.judged = self.window.statistic(config.statistic)
        self._freeze_or_thaw(now_s)
        if not self.staleness.frozen:
            self._judge_rules(now_s)
            self._rules.advance(now_s)
        return self._settle(now_s)

    def judgement(self, now_s: float) -> Judgement:
        """Returns the state after the last call, as of `now_s`. Reads only."""
        level, rules, window, latest_good = self.level, self._rules, self.window, self.latest_good
        is_invalid = level is _ERROR and rules.invalid.fires
        is_silent = level is _STALE and self.staleness.frozen  # else its driver reports that it is stale
        announced = self.announced_rule if self.announced is not _OK else None
        return (
            super()
            .judgement(now_s)
            ._replace(
                latest=self._latest,
                latest_good=latest_good,
                judged=self.judged,
                rule=None if is_silent or is_invalid else rules.explaining(level, announced),
                is_invalid=is_invalid,
                is_bad=rules.invalid.condition,
                good_samples=self._good_samples,
                bad_samples=self._bad_samples,
                window=window,
                forecast=(window.outlook() if isinstance(window, ForecastWindow) and latest_good is not None else None),
                window_samples=min(len(window), self.config.window_samples),
            )
        )

    @property
    def at_rest_since_s(self) -> float | None:
        """Since when the signal is OK; None unless its state depends on nothing else."""
        return self.announced_since_s if self._level is _OK and (self._settled or self._is_at_rest) else None

    def shown_samples(self, limit: int, since_s: float) -> Samples:
        """Returns the values of the statistic that the bounds apply to; see `Monitor.shown_samples`."""
        return (self.window if self._statistics is None else self._statistics).samples(limit, since_s)

    def exchange(self, state: SavedState) -> None:
        """Writes the state, or continues from one, as `Alert.exchange`."""
        self._rules.exchange(state)
        super().exchange(state)
        if state.is_saved:
            self._begin_count(state.now_s)
            if self.config.statistic == "count":
                self._freeze_or_thaw(state.now_s)

    @property
    def _explaining_rules(self) -> Mapping[Level, Rule]:
        return self._rules.rules

    def _judge(self, value: object, now_s: float) -> Transition | None:
        staleness, window, config, rules = self.staleness, self.window, self.config, self._rules
        if self._settled and now_s - staleness.silent_since_s <= staleness.limit_s:
            thaws = False
            staleness.last_seen_s = staleness.silent_since_s = now_s
        else:
            # What is not there at the start may not have been discovered yet.
            is_zero = isinstance(value, (int, float)) and value == 0
            if is_zero and config.graph is not None and staleness.is_in_grace(now_s):
                self._zero_s = now_s
                return None
            self._zero_s = None
            thaws = self._arrive(now_s)
        latest = self._latest = received(config, value) if config.reduce else value
        number = number_of(config, latest)
        if type(value) is DriverStatus and rules.of_bounds and not config.bounds:
            rules.expect_levels()
            self._freeze_or_thaw(now_s)
        good = self._valid_min <= number <= self._valid_max  # False for NaN; infinities lie outside
        judged = None
        if good:
            self._good_samples += 1
            window.add(number, now_s)
            judged = number if config.statistic == "last" else window.statistic(config.statistic)
            thaws = thaws or (judged is None) is not (self.judged is None)
            self.judged = judged
        else:
            self._bad_samples += 1
        if thaws:
            self._freeze_or_thaw(now_s)
        if self.collector is not None:
            self.collector.note(judged, now_s, good=good)
        if judged is None:
            rules.advance(now_s)
        elif rules.judge(judged, now_s) and self._settled:
            if self.collector is not None:
                self.collector.note_level(self._level, now_s)
            return None
        rules.note_quality(good=good, now_s=now_s)
        level = rules.level(stale=staleness.stale)
        if good:
            self.note_sample(level, now_s)
        transition = self._enter(level, now_s)
        self._settled = self._is_at_rest and not isinstance(window, GapWindow)  # for which every arrival counts
        is_calm = self._settled and level is _OK and self._calm_min < number <= self._healthy_max
        self._calm_max = self._healthy_max if is_calm else -math.inf
        return transition

    def _arrive(self, now_s: float) -> bool:
        """Notes the arrival of a sample, good or bad; returns whether it ends a silence."""
        staleness, window = self.staleness, self.window
        if staleness.is_due(now_s):
            self._freeze_or_thaw(self._fall_silent())  # no tick noticed
        ends_silence = staleness.stale or staleness.waiting
        if ends_silence:
            window.begin_anew()
            if self.config.statistic not in ("last", "count"):
                self.judged = None
        if isinstance(window, GapWindow):
            window.arrive(staleness.silence_s(now_s), now_s)
        staleness.arrive(now_s)
        if self.held is not None:
            self.held.awaits_until_s = -math.inf
        return ends_silence

    def _begin_count(self, now_s: float) -> None:
        """Begins to count at `now_s`; an alert stays open until the window has passed: its samples are not known."""
        if isinstance(self.window, CountWindow):
            if self._level is not _OK:
                self.window.count_from(now_s)
            self.judged = self.window.statistic("count")
            self._know_count(now_s)

    def _know_count(self, now_s: float) -> None:
        """Lets the level of a count be known without a sample: 0 is a count."""
        if self.config.statistic == "count":
            self.staleness.waiting = False
            if self.staleness.unreachable_since_s is None:
                self.note_known(now_s)

    def _use_config(self, config: SignalConfig) -> None:
        """Takes a configuration, and from it the values from which nothing can follow while it is settled at OK.

        They are valid and beyond no bound. `_calm_max` is `_healthy_max` while it is, and below every value otherwise.
        """
        before, self.config = self.config, config
        if config.statistic in ("last", "forecast"):
            self._statistics = None
        elif self._statistics is None or (config.statistic, config.window_s) != (before.statistic, before.window_s):
            self._statistics = Window(config.window_s, MOST_STATISTICS)
        self._valid_min = -_LARGEST if config.valid_min is None else config.valid_min
        self._valid_max = _LARGEST if config.valid_max is None else config.valid_max
        lows = (config.valid_min, config.warn_below, config.error_below)
        highs = (self._valid_max, config.warn_above, config.error_above)
        self._calm_min = max((low for low in lows if low is not None), default=-math.inf)
        self._healthy_max = min(high for high in highs if high is not None)
        if config.statistic != "last" or config.scale != 1.0 or config.placeholders:
            self._healthy_max = -math.inf
        self._unsettle()

    def _unsettle(self) -> None:
        """Makes the next sample be judged in every step: something but a sample has changed the state."""
        self._settled = False
        self._calm_max = -math.inf

    def _note_statistic(self, statistics: Window, now_s: float) -> None:
        spacing_s = self.config.window_s / MOST_STATISTICS
        if self.judged is not None and not self.staleness.frozen and not now_s - statistics.last_s() < spacing_s:
            statistics.add(self.judged, now_s)

    @property
    def _is_at_rest(self) -> bool:
        return (
            self._level is self.announced
            and self.held is None
            and not self.staleness.unknown
            and self._rules.is_at_rest
            and self.flaps.is_at_rest
        )

    def _fall_silent(self) -> float:
        """Marks the signal stale as of the moment at which the limit was reached; returns that moment."""
        due_s = self.staleness.fall_silent()
        self._rules.advance(due_s)
        return due_s

    def _freeze_or_thaw(self, now_s: float) -> None:
        """Freezes what cannot be judged now, and lets the rest continue."""
        self._rules.freeze_or_thaw(now_s, unknown=self.staleness.frozen, undefined=self.judged is None)
        self._unsettle()

    def _judge_rules(self, now_s: float) -> None:
        """Judges the statistic as of now: a count falls with the time."""
        if isinstance(self.window, CountWindow):
            self.window.advance(now_s)
            before, self.judged = self.judged, self.window.statistic("count")
            if (before is None) is not (self.judged is None):
                self._freeze_or_thaw(now_s)
        if self.judged is not None:
            self._rules.judge(self.judged, now_s)

    def _true_level(self) -> Level:
        return self._rules.level(stale=self.staleness.stale)

    def _is_news(self, level: Level) -> bool:
        return super()._is_news(level) or (level is _ERROR and self._rules.invalid.fires)

    def _enter(self, level: Level, now_s: float) -> Transition | None:
        if level is not self._level:
            self._unsettle()
        if self.collector is not None and not self.staleness.unknown:
            self.collector.note_level(level, now_s)
        return super()._enter(level, now_s)


def _calm_number(value: object) -> float:
    """Returns 0 for the status of a driver that is OK; NaN, which is never calm, for all else that is no float."""
    return 0.0 if type(value) is DriverStatus and type(value.level) is int and value.level == 0 else math.nan


def _source(config: SignalConfig) -> tuple[object, ...]:
    """Returns what decides which kind of value a signal receives, and whether it has bounds."""
    return config.topic, config.graph, config.type, config.field, config.reduce, bool(config.bounds)
