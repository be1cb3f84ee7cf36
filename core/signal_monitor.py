"""One signal: a sample's way from quality to staleness, in the order of SEMANTICS.md, and what is announced of it.

`observe`, `tick`, `reset` and `configure` return the one transition that they cause, or None. The level that is
announced and the true level differ only while the signal flaps.
"""

from __future__ import annotations

import hashlib
import math
import numbers
from typing import Callable, Dict, List, Optional

from .config import CONDITIONS, SignalConfig
from .flapping import FlapDetector
from .formatting import bound_text, datum_text, duration_text, number_text, with_unit
from .model import Level, Status, Transition
from .plausibility import Suspicion
from .rule import TIME_TOLERANCE_S, Rule, RuleConfig, State
from .window import STATISTIC_OF_WINDOW, Window

LINK = "link"
"""Name of the signal that says whether a robot can be reached: 1 is up, 0 is down."""

_MOST_NOTED = 200  # numbers, two for each sample
_LARGEST = 1.7976931348623157e308
# Globals are found faster than members of an enumeration, above all in Python 3.11; these are looked at per sample.
_OK, _WARN, _ERROR, _STALE = Level
_INACTIVE = State.INACTIVE
_LEVEL_OF_RULE = (_WARN, _ERROR)
_WITHOUT_BOUNDS = RuleConfig(below=None, above=None, hysteresis=0.0, for_s=0.0, keep_firing_for_s=0.0)


class SignalMonitor:
    """State and judgement of one signal."""

    __slots__ = (
        "_active_rules",
        "_announced",
        "_announced_at_s",
        "_announced_rule",
        "_announced_since_s",
        "_bad_samples",
        "_calm_max",
        "_calm_min",
        "_converts",
        "_detect_flaps",
        "_fingerprint",
        "_flaps",
        "_frozen_since_s",
        "_good_samples",
        "_healthy_max",
        "_invalid",
        "_judged",
        "_last_seen_s",
        "_latched",
        "_latest",
        "_level_since_s",
        "_noted",
        "_ordinary_max",
        "_ordinary_min",
        "_robot",
        "_rules",
        "_settings",
        "_stale",
        "_statistic",
        "_statistic_unit",
        "_suspicion",
        "_valid_max",
        "_valid_min",
        "_window",
        "cause",
        "config",
        "level",
    )

    def __init__(self, config: SignalConfig, robot: str, now_s: float) -> None:
        """Starts with level OK.

        Args:
            config: how to judge it.
            robot: the robot's name, for transitions and statuses.
            now_s: when it began to be watched, in seconds: the startup grace counts from here.
        """
        self._robot = robot
        self._fingerprint = hashlib.sha256(f"{robot}\0{config.name}".encode("utf-8", "replace")).hexdigest()[:16]
        self._window = Window(config.window_s, config.window_samples)
        self._rules = [Rule(RuleConfig.of(config, level)) for level in _LEVEL_OF_RULE]
        self._invalid = Rule(_WITHOUT_BOUNDS._replace(for_s=config.invalid_for_s))
        self._flaps = FlapDetector(config.flap_high, config.flap_low)
        self._latched = Level.OK
        self._noted: List[float] = []
        self._good_samples = 0
        self._bad_samples = 0
        self._latest: object = None
        self._judged: Optional[float] = None
        self._last_seen_s = now_s
        self._stale = False
        self._frozen_since_s: Optional[float] = None
        self._level_since_s = now_s
        self._announced = Level.OK
        self._announced_since_s = now_s
        self._announced_at_s = now_s
        self._announced_rule: Optional[Rule] = None
        self.level = Level.OK
        """The true level."""
        self.cause = ""
        """Why the link is down, if known."""
        self._take_config(config)

    @property
    def fresh_value(self) -> Optional[float]:
        """The value of the latest sample; None before the first one, while it is bad, and while it is stale."""
        self._work_in()
        return None if self._stale or self._invalid.condition else self._window.last()

    def observe(self, value: object, now_s: float) -> Optional[Transition]:
        """Takes a sample that arrived at `now_s` (seconds, not before the call before)."""
        if type(value) is float and self._calm_min < value <= self._calm_max:
            # Nothing follows from it: see _take_healthy_values. On a robot other programs run between two samples and
            # leave none of this code and its data in the processor's caches, so that every step of it takes ten times
            # as long as in a loop. What can be done for many samples at once is done later, by _work_in.
            noted = self._noted
            noted.append(value)
            noted.append(now_s)
            if len(noted) >= _MOST_NOTED:
                self._work_in()
            return None
        self._work_in()
        return self._judge(value, now_s)

    def _work_in(self) -> None:
        """Catches up on the samples that were only noted; whatever looks at the state does so first."""
        noted = self._noted
        if noted:
            add = self._window.add
            pairs = iter(noted)
            for value, now_s in zip(pairs, pairs):
                add(value, now_s)
            self._good_samples += len(noted) // 2
            self._latest = self._judged = noted[-2]
            self._last_seen_s = noted[-1]
            self._noted = []

    def _judge(self, value: object, now_s: float) -> Optional[Transition]:
        self._calm_max = -math.inf
        number = value if type(value) is float else _as_float(value)
        came = number
        if self._converts:
            number = self._convert(number)
        self._latest = value
        self._last_seen_s = now_s
        if self._frozen_since_s is not None:
            self._thaw(now_s)
        self._stale = False
        # NaN compares false, the infinities lie outside
        good = self._valid_min <= number <= self._valid_max
        if good:
            self._good_samples += 1
            if not self._ordinary_min < number <= self._ordinary_max or self._suspicion.watching:
                self._suspicion.see_good(came, number)
            self._window.add(number, now_s)
            judged: Optional[float]
            if self._statistic is None:
                judged = self._judged = number
            else:
                judged = self._judged = self._statistic(self._window)
            if judged is not None:
                for rule in self._active_rules:
                    rule.judge(judged, now_s)
            else:
                self._advance(now_s)
        else:
            self._bad_samples += 1
            self._suspicion.see_bad(came, number)
            self._advance(now_s)
        if good is self._invalid.condition or self._invalid.state is not _INACTIVE:
            self._invalid.set_condition(not good, now_s)
        level = self._true_level()
        if good and self._detect_flaps:
            self._flaps.add(level)
        if level is self.level and level is self._announced:
            if level is _OK and self._calm_min < number <= self._healthy_max and self._is_at_rest:
                self._calm_max = self._healthy_max
            return None
        return self._settle(level, now_s)

    def tick(self, now_s: float) -> Optional[Transition]:
        """Lets time pass until `now_s`, in seconds."""
        self._work_in()
        config = self.config
        if self._frozen_since_s is None:
            if self._is_silent(now_s):
                due_s = self._last_seen_s + self._allowed_silence_s
                self._advance(due_s)
                self._stale = True
                self._freeze(due_s)
            else:
                self._advance(now_s)
        level = self._true_level()
        if level is not self.level or level is not self._announced:
            return self._settle(level, now_s)
        if (
            config.repeat_s > 0.0
            and level is not Level.OK
            and not self._flaps.flapping
            and now_s - self._announced_at_s >= config.repeat_s - TIME_TOLERANCE_S
        ):
            return self._announce(level, now_s)
        return None

    def follow(self, fresh_value: Callable[[str], Optional[float]], now_s: float) -> Optional[Transition]:
        """Looks at the conditions on other signals.

        Args:
            fresh_value: tells another signal's latest value, None while it is not known.
            now_s: the time in seconds.
        """
        self._work_in()
        only_if, release_if = self.config.only_if, self.config.latch_release_if
        if only_if is not None:
            value = fresh_value(only_if.signal)
            for rule in self._rules:
                rule.allow(value is None or only_if.holds(value))
        if release_if is not None:
            value = fresh_value(release_if.signal)
            if value is not None and release_if.holds(value):
                self._latched = Level.OK
        if self._frozen_since_s is None:
            self._advance(now_s)
        return self._settle(self._true_level(), now_s)

    def inhibit(self, now_s: float) -> None:
        """Stands still from `now_s` on: the robot cannot be reached."""
        self._work_in()
        if self._frozen_since_s is None:
            self._freeze(now_s)

    def release(self, now_s: float) -> None:
        """Goes on after `inhibit`: the robot can be reached again, and its silence counts from now."""
        self._work_in()
        if self._frozen_since_s is not None and not self._stale:
            self._thaw(now_s)
            self._last_seen_s = now_s

    def restart_time(self, now_s: float) -> None:
        """Time went back to `now_s`: windows, pending timers and staleness start again, latches stay."""
        self._work_in()
        self._window.clear()
        self._last_seen_s = now_s
        self._level_since_s = min(self._level_since_s, now_s)
        self._announced_since_s = min(self._announced_since_s, now_s)
        self._announced_at_s = min(self._announced_at_s, now_s)
        for rule in (*self._rules, self._invalid):
            rule.since_s = now_s
        if self._stale:
            self._stale = False
            self._frozen_since_s = None
        elif self._frozen_since_s is not None:
            self._frozen_since_s = now_s

    def reset(self, now_s: float) -> Optional[Transition]:
        """Clears the latch: from now on the level is what the rules say."""
        self._work_in()
        self._latched = Level.OK
        return self._settle(self._true_level(), now_s)

    def configure(self, config: SignalConfig, now_s: float) -> Optional[Transition]:
        """Takes a new configuration of the same signal and judges by it at once; what has been seen stays."""
        self._work_in()
        self._take_config(config)
        if (config.window_s, config.window_samples) != (self._window.window_s, self._window.window_samples):
            self._window.resize(config.window_s, config.window_samples)
        if config.flap_detection:
            self._flaps.configure(config.flap_high, config.flap_low)
        else:
            self._flaps = FlapDetector(config.flap_high, config.flap_low)
        for rule, level in zip(self._rules, _LEVEL_OF_RULE):
            rule.configure(RuleConfig.of(config, level))
            if rule not in self._active_rules:
                rule.clear()
        self._invalid.configure(_WITHOUT_BOUNDS._replace(for_s=config.invalid_for_s))
        self._judged = STATISTIC_OF_WINDOW[config.statistic](self._window)
        if self._stale and not self._is_silent(now_s):
            self._stale = False
            self._thaw(now_s)
        if self._frozen_since_s is None:
            if self._judged is not None:
                for rule in self._active_rules:
                    rule.judge(self._judged, now_s)
            self._advance(now_s)
        return self._settle(self._true_level(), now_s)

    def status(self, now_s: float) -> Status:
        """Returns the state at `now_s`, in seconds, as of the last observe or tick."""
        self._work_in()
        config = self.config
        values: Dict[str, str] = {
            "value": self._latest_text(),
            "unit": config.unit,
            "statistic": config.statistic,
        }
        values.update((name, number_text(value)) for name, value in self._window.statistics().items())
        values["window_samples"] = str(len(self._window))
        values["good_samples"] = str(self._good_samples)
        values["bad_samples"] = str(self._bad_samples)
        if self._seen:
            values["age_s"] = number_text(now_s - self._last_seen_s)
        values.update(self._settings)
        values["state"] = self._state()
        values["since"] = f"{self._level_since_s:.3f}"
        values["lasts_s"] = number_text(now_s - self._level_since_s)
        values["flapping"] = "true" if self._flaps.flapping else "false"
        if self._detect_flaps:
            values["state_change_percent"] = number_text(self._flaps.percent)
        values["fingerprint"] = self._fingerprint
        return Status(config.name, self.level, self._reason(self.level, now_s), self._robot, values)

    def _take_config(self, config: SignalConfig) -> None:
        self.config = config
        self._settings = _settings_texts(config)
        self._valid_min = -_LARGEST if config.valid_min is None else config.valid_min
        self._valid_max = _LARGEST if config.valid_max is None else config.valid_max
        self._statistic = None if config.statistic == "last" else STATISTIC_OF_WINDOW[config.statistic]
        self._statistic_unit = {"rate": f"{config.unit}/s", "frequency_hz": "Hz"}.get(config.statistic, config.unit)
        self._converts = config.scale != 1.0 or bool(config.placeholders)
        self._suspicion = Suspicion(config)
        self._ordinary_min = self._suspicion.ordinary_min
        self._ordinary_max = self._suspicion.ordinary_max
        self._detect_flaps = config.flap_detection
        self._take_healthy_values(config)
        if not config.latch:
            self._latched = Level.OK
        if config.only_if is None:
            for rule in self._rules:
                rule.allow(True)
        self._active_rules = [
            rule
            for rule, level in zip(self._rules, _LEVEL_OF_RULE)
            if any(name.startswith(level.name.lower()) for name in config.bounds)
        ]

    @property
    def _seen(self) -> bool:
        """Whether there has been a sample, good or bad."""
        return self._good_samples + self._bad_samples > 0

    def _take_healthy_values(self, config: SignalConfig) -> None:
        """Finds the values from which nothing can follow while everything is at rest: most samples of a healthy robot.

        They are good, ordinary, and beyond no bound. `observe` has a short way for them, which begins with the first of
        them that finds everything at rest, and ends with anything else than such a sample.
        """
        lows = (self._valid_min, self._ordinary_min, config.warn_below, config.error_below)
        highs = (self._valid_max, self._ordinary_max, config.warn_above, config.error_above)
        self._calm_min = max(low for low in lows if low is not None)
        self._healthy_max = min(high for high in highs if high is not None)
        if self._statistic is not None or self._converts:
            self._healthy_max = -math.inf
        self._calm_max = -math.inf

    @property
    def _is_at_rest(self) -> bool:
        warn, error = self._rules
        return warn.is_at_rest and error.is_at_rest and self._flaps.is_at_rest and not self._suspicion.watching

    @property
    def _allowed_silence_s(self) -> float:
        return self.config.stale_after_s if self._seen else self.config.startup_grace_s

    def _is_silent(self, now_s: float) -> bool:
        """Says whether there has been no sample for too long."""
        silence_s = now_s - self._last_seen_s
        return self.config.stale_after_s > 0.0 and silence_s > self._allowed_silence_s + TIME_TOLERANCE_S

    def _advance(self, now_s: float) -> None:
        for rule in self._rules:
            rule.advance(now_s)
        self._invalid.advance(now_s)

    def _freeze(self, since_s: float) -> None:
        self._frozen_since_s = since_s
        self._calm_max = -math.inf

    def _thaw(self, now_s: float) -> None:
        assert self._frozen_since_s is not None
        stood_still_s = now_s - self._frozen_since_s
        for rule in (*self._rules, self._invalid):
            rule.since_s += stood_still_s
        self._frozen_since_s = None

    def _true_level(self) -> Level:
        warn, error = self._rules
        level = _ERROR if error.fires else _WARN if warn.fires else _OK
        if self.config.latch:
            if level > self._latched:
                self._latched = level
            level = self._latched
        if level is not _ERROR:
            if self._invalid.fires:
                return _ERROR
            if self._stale:
                return _STALE
        return level

    def _settle(self, level: Level, now_s: float) -> Optional[Transition]:
        if level is not self.level:
            self.level = level
            self._level_since_s = now_s
        if level is self._announced or self._flaps.told:
            return None
        return self._announce(level, now_s)

    def _announce(self, level: Level, now_s: float) -> Transition:
        repeat = level is self._announced
        rule = self._rule_behind(level)
        if level is Level.OK or level is Level.STALE:
            value: object = self._judged
        else:
            value = self._latest if self._is_invalid(level) else self._judged
        lasted = duration_text(now_s - self._announced_since_s)
        text = (
            f"{self.config.name} {level.name}: {self._reason(level, now_s)}"
            f" ({'for' if repeat else f'was {self._announced.name} for'} {lasted})"
        )
        if self._flaps.flapping:
            self._flaps.told = True
            text += (
                f", flapping: {number_text(self._flaps.percent)} % state change,"
                f" silent until below {bound_text(self.config.flap_low)} %"
            )
        transition = Transition(
            signal=self.config.name,
            from_level=self._announced,
            to_level=level,
            value=value,
            statistic=self.config.statistic,
            bound=None if rule is None else rule.bound,
            now_s=now_s,
            since_s=self._announced_since_s,
            robot=self._robot,
            fingerprint=self._fingerprint,
            text=text,
            status=self.status(now_s),
            statistics=self._window.statistics(),
            repeat=repeat,
        )
        if not repeat:
            self._announced = level
            self._announced_since_s = now_s
        self._announced_rule = rule
        self._announced_at_s = now_s
        return transition

    def _is_invalid(self, level: Level) -> bool:
        return level is Level.ERROR and self._invalid.fires

    def _rule_behind(self, level: Level) -> Optional[Rule]:
        """The rule that a level tells of: the one that fires or is latched; for OK pending, held back or cleared."""
        warn, error = self._rules
        if level is Level.STALE or self._is_invalid(level):
            return None
        if level is Level.ERROR:
            return error
        if level is Level.WARN:
            return warn
        for rule in (error, warn):
            if rule.state is State.PENDING or rule.held_back:
                return rule
        announced = self._announced_rule if self._announced is not Level.OK else None
        return announced if announced is not None and announced.bound in self.config.bounds.values() else None

    def _reason(self, level: Level, now_s: float) -> str:
        if self.config.name == LINK and level is not Level.STALE:
            if level is Level.OK:
                return "up"
            return f"down: {self.cause}" if self.cause else "down"
        silence = duration_text(now_s - self._last_seen_s)
        if level is Level.STALE:
            if self._seen:
                return f"no sample for {silence}, allowed are {duration_text(self.config.stale_after_s)}"
            return f"no sample since the start {silence} ago"
        reason = self._invalid_reason() if self._is_invalid(level) else self._value_reason(level, now_s)
        if self._suspicion.text:
            reason = f"{reason}, {self._suspicion.text}"
        return f"{reason}, no sample for {silence}" if self._stale else reason

    def _convert(self, came: float) -> float:
        """Returns a number in the signal's unit, NaN for a placeholder."""
        for number in self.config.placeholders:
            if math.isclose(came, number, rel_tol=1e-6):  # Float32 brings -0.01 as -0.009999999776
                return math.nan
        return came * self.config.scale

    def _is_placeholder(self, came: float) -> bool:
        return math.isnan(self._convert(came)) and not math.isnan(came)

    def _latest_text(self) -> str:
        if not self._seen:
            return ""
        came = _as_float(self._latest)
        number = self._convert(came) if self._converts else came
        return number_text(number) if math.isfinite(number) else datum_text(self._latest)

    def _invalid_reason(self) -> str:
        config, seen = self.config, self._latest
        came = _as_float(seen)
        if self._is_placeholder(came):
            return f"invalid data: {datum_text(seen)} is a placeholder for 'not measured'"
        text = f"invalid data: {self._latest_text()}"
        number = self._convert(came)
        if number < self._valid_min and config.valid_min is not None:
            return f"{with_unit(text, config.unit)} is below valid_min {bound_text(config.valid_min)}"
        if number > self._valid_max and config.valid_max is not None:
            return f"{with_unit(text, config.unit)} is above valid_max {bound_text(config.valid_max)}"
        return text

    def _value_reason(self, level: Level, now_s: float) -> str:
        config, unit, judged = self.config, self._statistic_unit, self._judged
        if not self._seen:
            return "waiting for the first sample"
        if not self._good_samples:
            return f"no valid sample yet: {self._latest_text()}"
        if judged is None:
            return f"{config.statistic} is not defined by so few samples"
        rule = self._rule_behind(level)
        bound = None if rule is None else rule.bound
        value = with_unit(number_text(judged, bound), unit)
        if config.statistic != "last":
            value = f"{config.statistic} {value}"
        if rule is None or bound is None:
            return value
        side = f"{'below' if rule.is_below else 'above'} {with_unit(bound_text(bound), unit)}"
        if judged < bound if rule.is_below else judged > bound:
            reason = f"{value} is {side}"
        elif rule.condition or rule.held_back:
            clears_at = bound + config.hysteresis if rule.is_below else bound - config.hysteresis
            reason = f"{value} was {side}, clears at {with_unit(number_text(clears_at, judged), unit)}"
        else:
            reason = f"{value} is no longer {side}"
        if rule.held_back:
            reason += f", which counts only if {config.only_if}"
        if rule.state is State.PENDING and level is Level.OK:
            return f"{reason}, pending for {duration_text(now_s - rule.since_s)}"
        if rule.condition or level is Level.OK:
            return reason
        if rule.fires:
            return f"{reason}, kept firing for a while"
        release = f" or {config.latch_release_if}" if config.latch_release_if else ""
        return f"{reason}, latched until reset{release}"

    def _state(self) -> str:
        warn, error = self._rules
        if self._stale:
            return "stale"
        if self._invalid.fires:
            return "invalid"
        fired = Level.ERROR if error.fires else Level.WARN if warn.fires else Level.OK
        if self._latched > fired:
            return "latched"
        rule = warn if fired is Level.WARN or error.state is State.INACTIVE else error
        return rule.state.value


def _settings_texts(config: SignalConfig) -> Dict[str, str]:
    """Returns what a status tells of the configuration."""
    values = {name: bound_text(bound) for name, bound in config.bounds.items()}
    for name in ("valid_min", "valid_max", "hysteresis", "for_s", "keep_firing_for_s", "stale_after_s"):
        setting = getattr(config, name)
        if setting is not None:
            values[name] = bound_text(setting)
    if config.scale != 1.0:
        values["scale"] = bound_text(config.scale)
    for name in CONDITIONS:
        condition = getattr(config, name)
        if condition is not None:
            values[name] = str(condition)
    return values


def _as_float(value: object) -> float:
    """Returns the number that `value` is, NaN when it is none or too large for a double."""
    try:
        return float(value) if isinstance(value, numbers.Real) else math.nan
    except Exception:  # a foreign object's own conversion
        return math.nan
