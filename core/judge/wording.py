"""The text about a signal: the reason for its level, its status with key-values, and the alert line.

`SignalMonitor` judges and describes the outcome as a `Judgement`; everything that people read is made from it here.
"""

from __future__ import annotations

import math
from typing import Mapping, NamedTuple, Sequence

from ..config import ACTIVE, CONDITIONS, LINK, SignalConfig, doubt_of
from ..values import (
    Age,
    BadDatum,
    DriverStatus,
    Element,
    Forecast,
    Level,
    LinkDown,
    Reduced,
    Status,
    bound_text,
    count_text,
    datum_text,
    duration_text,
    element_path,
    number_text,
    printable,
    with_unit,
)
from .quality import as_float, number_of, suspicion_of
from .rule import Rule, State
from .window import Window

STATES: Mapping[str, str] = {
    "waiting": "no sample yet; the level is unknown",
    "unreachable": "the link is down; the level is unknown",
    "stale": "no sample for longer than `stale_after_s`",
    "invalid": "the data is invalid",
    "latched": "no rule is firing, but an alert is latched until reset",
    State.INACTIVE.value: "no condition is true",
    State.PENDING.value: "a condition is true, but not yet for `for_s`",
    State.FIRING.value: "a condition has been true for `for_s`",
    State.KEEPING.value: "no condition is true, but not yet for `keep_firing_for_s`",
}
"""The states of a signal, with their meaning for docs/reference/api.md."""

_LONGEST_DATUM = 200  # characters of the reason why a datum is bad
_LONGEST_NAME = 120  # characters of the name of an element

_LIFECYCLE = {
    1: "unconfigured", 2: "inactive", 3: "active", 4: "finalized", 10: "configuring", 11: "cleaningup",
    12: "shuttingdown", 13: "activating", 14: "deactivating", 15: "errorprocessing",
}  # fmt: skip
"""Labels of lifecycle_msgs/State by id."""

_LEVELS: Mapping[float, str] = {float(level): level.name for level in Level}
_LONGEST_MESSAGE = 200
"""Most characters of a driver's message in a reason."""
_MOST_TOPICS = 3
"""Most topics that a reason names; one more takes no more room than the number of the rest."""
_NO_WINDOW = Window(0.0, 0)
"""That of a source."""
_KEEPING = "still firing until keep_firing_for_s has passed"


class Judgement(NamedTuple):
    """The state of a signal or source at one moment, as it was judged. A source has the first fields only."""

    config: SignalConfig
    robot: str
    fingerprint: str
    now_s: float
    """The moment, in seconds."""
    level: Level
    """The level to show; STALE where it is unknown."""
    state: str
    """One of `STATES`."""
    announced: Level
    """The level of the last transition."""
    since_s: float
    """Since when the level has lasted, in seconds."""
    seen: bool
    """Whether there has been a sample, good or bad."""
    is_stale: bool
    """Whether no sample has come for too long."""
    last_seen_s: float
    """When the latest sample came, in seconds."""
    silence_s: float
    """Time without samples, without the downtime of the link, in seconds."""
    without_link_s: float
    """Time without samples that is left out of `silence_s`, since the link was down, in seconds."""
    limit_s: float
    """Longest time without samples, in seconds."""
    hint: str
    """Why there are no samples; empty if that is unknown, or if there are samples."""
    flapping: bool
    state_change_percent: float
    cause: str
    """Name of the alert that it suffers from; empty without one."""
    latest: object = None
    """The latest datum as received; None before the first."""
    latest_good: float | None = None
    """The latest value; None while there is none, it is bad, or the signal is stale or unreachable."""
    judged: float | None = None
    """Value of the signal's statistic; None while it is undefined."""
    rule: Rule | None = None
    """The rule that explains the level; None where none does."""
    is_invalid: bool = False
    """Whether the level is ERROR for invalid data."""
    is_bad: bool = False
    """Whether the latest datum is invalid."""
    good_samples: int = 0
    bad_samples: int = 0
    window: Window = _NO_WINDOW
    """The samples, to be read before the next call."""
    forecast: Forecast | None = None
    """None if the statistic is not `forecast` or is undefined, or if the latest value is not known (`latest_good`)."""
    window_samples: int = 0
    storm: str = ""
    """Why it flaps, if that is for the number of its transitions; else empty."""
    source_signals: int = 0
    """Number of signals of a source; 0 for other signals."""
    with_topics: Sequence[str] = ()
    """The other topics of the alert of a source."""
    affects: int = 0
    """How many signals are worse than announced because of it."""

    @property
    def statistics(self) -> Mapping[str, float]:
        """What can be computed of the window, the judged statistic where it is defined, the trend of a forecast."""
        if self.window is _NO_WINDOW:
            return {}
        trend = None if self.forecast is None else self.forecast.slope_per_s * 60.0
        values = {**self.window.statistics(), self.config.statistic: self.judged, "trend_per_min": trend}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def datum(self) -> object:
        """The latest datum; of a driver's status its level as it was reported."""
        return self.latest.level if isinstance(self.latest, DriverStatus) else self.latest

    @property
    def reports_level(self) -> bool:
        """Whether the level is that which a driver reports, not one that follows from bounds."""
        return isinstance(self.latest, DriverStatus) and not self.config.bounds


def status(judgement: Judgement, message: str | None = None) -> Status:
    """Returns the status of a signal; `message` replaces the reason for its level."""
    config = judgement.config
    lasts_s = judgement.now_s - judgement.since_s
    values = {"value": latest_text(judgement), "unit": config.unit, "statistic": config.statistic}
    values.update((name, number_text(value)) for name, value in judgement.statistics.items())
    values.update(_reduction_values(judgement))
    forecast = judgement.forecast
    if forecast is not None and forecast.time_to_bound_s is not None:
        values["time_to_bound_s"] = number_text(forecast.time_to_bound_s)
    for name in ("window_samples", "good_samples", "bad_samples"):
        values[name] = str(getattr(judgement, name))
    if judgement.seen:
        values["age_s"] = number_text(judgement.now_s - judgement.last_seen_s)
    values.update(_settings(config))
    values.update(state=judgement.state, since=f"{judgement.since_s:.3f}", lasts_s=number_text(lasts_s))
    values["flapping"] = "true" if judgement.flapping else "false"
    if config.flap_detection or judgement.flapping:
        values["state_change_percent"] = number_text(judgement.state_change_percent)
    if judgement.cause:
        values["cause"] = judgement.cause
    if judgement.affects:
        values["affects"] = str(judgement.affects)
    if config.what_to_do:
        values["what_to_do"] = config.what_to_do
    values["fingerprint"] = judgement.fingerprint
    text = reason(judgement) if message is None else message
    return Status(
        config.name,
        judgement.level,
        text,
        judgement.robot,
        values,
        hint(judgement),
        judgement.state,
        lasts_s,
        forecast,
        outlook(judgement),
        cause=judgement.cause,
        affects=judgement.affects,
        what_to_do=config.what_to_do,
    )


def alert_line(
    judgement: Judgement,
    message: str,
    announced: Level,
    announced_since_s: float,
    unknown_s: float | None = None,
    caused: str = "",
) -> str:
    """Returns the text of a transition; `message` is the reason for its level.

    `announced` is the level that was announced before, since `announced_since_s`; the same level makes it a repetition.
    `unknown_s` is how long the level has been unknown, in seconds, if it was never known; else None. `caused` says what
    it was caused by, and for how long; empty if by nothing.
    """
    config = judgement.config
    lasted = duration_text(judgement.now_s - announced_since_s)
    before = f"for {lasted}" if announced is judgement.level else f"was {announced.name} for {lasted}"
    if unknown_s is not None:
        before = "was never up" if config.name == LINK else f"was unknown for {duration_text(unknown_s)}"
    before = caused or before
    text = f"{config.name} {judgement.level.name}: {message} ({before})"
    if not judgement.flapping:
        return text
    why, until = judgement.storm, "it settles"
    if not judgement.storm:
        percent = number_text(judgement.state_change_percent, config.flap_high)
        why, until = f"{percent} % state change", f"below {bound_text(config.flap_low)} %"
    return f"{text}, flapping: {why}, further changes not announced until {until}"


def reason(judgement: Judgement) -> str:
    """Returns the reason for the level, in a few words."""
    config = judgement.config
    if judgement.state == "waiting":
        if judgement.seen:
            return "waiting for a sample: time went back"
        return f"waiting for the first sample{_last_announced(judgement)}"
    if judgement.state == "unreachable":
        if not judgement.seen:
            return "link down, no sample yet"
        value = _latest_with_unit(judgement) if config.statistic == "forecast" else shown_text(judgement)
        value = value or "undefined"
        if judgement.source_signals:
            return f"link down, last message {duration_text(judgement.now_s - judgement.last_seen_s)} ago"
        return f"link down, last value {value} {duration_text(judgement.now_s - judgement.last_seen_s)} ago"
    if config.name == LINK:
        return _link_reason(judgement)
    if judgement.source_signals:
        return _source_reason(judgement)
    is_stale = judgement.level is Level.STALE and judgement.is_stale
    if is_stale or not (judgement.seen or config.statistic == "count"):
        return _silence_reason(judgement, is_stale=is_stale)
    text = _invalid_reason(judgement) if judgement.is_invalid else _value_reason(judgement)
    suspicion = suspicion_of(config, judgement.latest, judgement.good_samples, judgement.bad_samples, judgement.window)
    if suspicion:
        text = f"{text}, suspicious data: {suspicion}"
    if isinstance(judgement.latest, (Age, Reduced)) and judgement.latest.remark:
        text = f"{text}, {judgement.latest.remark}"
    return f"{text}, no sample for {_silence_text(judgement)}" if judgement.is_stale else text


def hint(judgement: Judgement) -> str:
    """Returns why there are no samples, or why the statistic is questionable; empty if nothing is known."""
    return judgement.hint or doubt_of(judgement.config)


def judged_unit(config: SignalConfig) -> str:
    """Returns the unit of the statistic that the bounds apply to."""
    units = {"rate": f"{config.unit}/s", "frequency_hz": "Hz", "largest_gap_s": "s", "count": ""}
    return units.get(config.statistic, config.unit)


def judged_text(config: SignalConfig, judged: float, bound: float | None = None, *, is_named: bool = True) -> str:
    """Returns a value of the statistic with its unit, as a reason begins: `rate 5 Hz`; only `5 Hz` unless `is_named`.

    A forecast and a count always say over which time. A count is no more than the window holds.
    """
    number = number_text(judged, bound)
    if config.statistic == "count" and judged > config.window_samples:
        number = f"at least {config.window_samples}"
    value = with_unit(number, judged_unit(config))
    if config.statistic == "forecast" and config.forecast_s is not None:
        return f"forecast {value} in {duration_text(config.forecast_s)}"
    if config.statistic == "count":
        return f"{value} in {duration_text(config.window_s)}"
    name = {"last": "", "frequency_hz": "rate", "largest_gap_s": "largest gap"}.get(config.statistic, config.statistic)
    return f"{name} {value}".lstrip() if is_named else value


def bounds_text(config: SignalConfig) -> str:
    """Returns the bounds in words, with the unit of the statistic: `WARN below 20 %, ERROR below 10 %`.

    Empty if there are none.
    """
    if config.lifecycle:
        return "ERROR unless active"
    unit = judged_unit(config)
    words = (name.split("_") for name in config.bounds)
    numbers = (with_unit(bound_text(bound), unit) for bound in config.bounds.values())
    return ", ".join(f"{level.upper()} {side} {number}" for (level, side), number in zip(words, numbers))


def source_text(config: SignalConfig, topic: str) -> str:
    """Returns where a signal comes from and how it is judged: `scan on /scan: frequency_hz WARN below 8 Hz`.

    `topic` is the resolved one.
    """
    bounds = bounds_text(config)
    statistic = "" if config.statistic == "last" else f"{config.statistic} "
    if config.graph is not None:
        topic = " ".join(config.graph)
    return f"{config.name} on {topic}" + (f": {statistic}{bounds}" if bounds else "")


def shown_text(judgement: Judgement) -> str:
    """Returns the value of a signal as it is shown everywhere, with its unit; empty if there is none yet.

    A signal leads with its statistic: `29.9 Hz`, not the latest datum. The latest one may be invalid.
    """
    config, judged = judgement.config, judgement.judged
    if config.is_template and judged is not None:
        return count_text(int(judged), "element")
    if config.statistic == "last":
        return _latest_with_unit(judgement)
    return "" if judged is None else judged_text(config, judged, is_named=False)


def outlook(judgement: Judgement) -> str:
    """Returns when a forecast reaches the nearest bound ahead: `reaches 20 % in 24 min`.

    Empty without a forecast or such a bound, and while the latest value is not known.
    """
    forecast = judgement.forecast
    if forecast is None or forecast.time_to_bound_s is None or forecast.bound is None:
        return ""
    time_s = forecast.time_to_bound_s
    # From 10 min on, seconds would only flicker.
    time_s = round(time_s / 60.0) * 60.0 if time_s >= 599.5 else max(1.0, round(time_s))
    bound = with_unit(bound_text(forecast.bound), judged_unit(judgement.config))
    return f"reaches {bound} in {duration_text(time_s)}"


def latest_text(judgement: Judgement) -> str:
    """Returns the latest datum, in the unit but without it; empty before the first."""
    latest = judgement.latest
    if not judgement.seen:
        return ""
    if isinstance(latest, DriverStatus):
        return _LEVELS.get(latest.number, f"level {datum_text(latest.level)}")
    if isinstance(latest, BadDatum):
        return printable(latest)[:_LONGEST_DATUM]
    if isinstance(latest, Reduced) and latest.problem:
        return latest.problem
    number = number_of(judgement.config, latest)
    return number_text(number) if math.isfinite(number) else datum_text(latest)


def decided_text(judgement: Judgement) -> str:
    """Returns the elements that decided the value of a reduction, in round brackets after a space.

    Empty if none did.
    """
    config, latest = judgement.config, judgement.latest
    if not isinstance(latest, Reduced) or not latest.decided:
        return ""
    paths = " to ".join(dict.fromkeys(_element_text(config, element) for element in latest.decided))
    return f" ({paths})" if config.statistic == "last" else f" (latest {paths})"


def _element_text(config: SignalConfig, element: Element) -> str:
    return element_path(config.field, printable(element.name)[:_LONGEST_NAME])


def _reduction_values(judgement: Judgement) -> dict[str, str]:
    """Returns the key-values of a signal with `reduce`."""
    latest = judgement.latest
    if not isinstance(latest, Reduced):
        return {}
    values = {"elements": str(latest.measured), "elements_skipped": str(latest.skipped)}
    names = ("element",) if len(latest.decided) == 1 else ("lowest", "highest")
    for name, element in zip(names, latest.decided):
        values[name] = _element_text(judgement.config, element)
        if name != "element":
            values[f"{name}_value"] = number_text(element.value)
    return values


def _latest_with_unit(judgement: Judgement) -> str:
    text = latest_text(judgement)
    return with_unit(text, judgement.config.unit) if text else ""


def _last_announced(judgement: Judgement) -> str:
    return "" if judgement.announced is Level.OK else f", last announced {judgement.announced.name}"


def _silence_text(judgement: Judgement) -> str:
    """Returns for how long there was no sample; before the first one, how long ago that began."""
    total = duration_text(judgement.silence_s + judgement.without_link_s)
    text = total if judgement.seen else f"{total} ago"
    if judgement.without_link_s <= 0.0:
        return text
    return f"{text}, {duration_text(judgement.without_link_s)} of them without link"


def _silence_reason(judgement: Judgement, *, is_stale: bool) -> str:
    silence, limit = _silence_text(judgement), f" (limit {duration_text(judgement.limit_s)})"
    if judgement.seen:
        return f"no sample for {silence}{limit}"
    if is_stale and judgement.silence_s > judgement.config.startup_grace_s:
        return f"no sample since the start {silence}{limit}"
    return f"no sample since the start {silence}{_last_announced(judgement)}"  # continues after a restart


def _source_reason(judgement: Judgement) -> str:
    number, topics = judgement.source_signals, judgement.with_topics
    signals = f": {number} signals" if number > 1 else ""
    if not judgement.is_stale:
        return f"messages again{signals}"
    since = "for" if judgement.seen else "since the start"
    text = f"no message {since} {_silence_text(judgement)} (limit {duration_text(judgement.limit_s)})"
    if not topics:
        return f"{text}{signals}"
    shown = list(topics)
    if len(topics) > _MOST_TOPICS + 1:
        shown[_MOST_TOPICS:] = [f"{len(topics) - _MOST_TOPICS} more"]
    names = " and ".join(filter(None, [", ".join(shown[:-1]), shown[-1]]))
    return f"{text}, nor on {count_text(len(topics), 'other topic')}: {names}"


def _link_reason(judgement: Judgement) -> str:
    if judgement.level is Level.OK:
        return "up"
    if judgement.rule is not None and judgement.rule.state is State.KEEPING:
        return f"up, {_KEEPING}"
    cause = printable(judgement.latest.cause) if isinstance(judgement.latest, LinkDown) else ""
    return f"down: {cause}" if cause else "down"


def _invalid_reason(judgement: Judgement) -> str:
    config, raw = judgement.config, as_float(judgement.latest)
    number = number_of(config, judgement.latest)
    if math.isnan(number) and not math.isnan(raw) and config.placeholders:
        return f"invalid data: {datum_text(judgement.latest)} is a placeholder for 'not measured'"
    if config.valid_min is not None and number < config.valid_min:
        side, limit = "below valid_min", config.valid_min
    elif config.valid_max is not None and number > config.valid_max:
        side, limit = "above valid_max", config.valid_max
    else:
        return f"invalid data: {latest_text(judgement)}"
    shown = number_text(number, limit) if math.isfinite(number) else datum_text(judgement.latest)
    return f"invalid data: {with_unit(shown, config.unit)}{decided_text(judgement)} is {side} {bound_text(limit)}"


def _value_reason(judgement: Judgement) -> str:
    config, rule, judged = judgement.config, judgement.rule, judgement.judged
    if judged is None and judgement.announced is Level.STALE:
        return "samples again"
    if not judgement.good_samples and config.statistic != "count":
        return f"no valid sample yet: {latest_text(judgement)}"
    if judged is None:
        return _undefined_reason(judgement)
    if config.is_template:
        return shown_text(judgement)
    if judgement.reports_level:
        return _with_state(_reported_text(judgement), judgement)
    if config.graph is not None and config.statistic == "last":
        return _with_state(_graph_text(judgement, int(judged), *config.graph), judgement)
    bound = None if rule is None else rule.bound
    decided = decided_text(judgement)
    if rule is None or bound is None:
        return judged_text(config, judged, is_named=False) + decided
    value = judged_text(config, judged, bound) + decided
    side = f"{'below' if rule.is_below else 'above'} {with_unit(bound_text(bound), judged_unit(config))}"
    if judged < bound if rule.is_below else judged > bound:
        text = f"{value} is {side}{_goals_text(judgement)}"
    elif rule.condition or rule.held_back:
        text = f"{value} was {side}, {_clears_text(config, rule, bound, judged)}"
    else:
        text = f"{value} is no longer {side}"
    return _with_state(text, judgement)


def _clears_text(config: SignalConfig, rule: Rule, bound: float, judged: float) -> str:
    clears_at = bound + config.hysteresis if rule.is_below else bound - config.hysteresis
    return f"clears at {with_unit(number_text(clears_at, judged), judged_unit(config))}"


def _graph_text(judgement: Judgement, number: int, key: str, name: str) -> str:
    """Returns what was found in the robot's graph, and the bound that it is beyond."""
    config, rule = judgement.config, judgement.rule
    if key == "lifecycle":
        if not number:
            return f"{name} is not there"
        text = f"{name} is {_LIFECYCLE.get(number, f'in state {number}')}"
        return text if number == ACTIVE else f"{text}, expected active"
    if key != "node":
        text = f"{number or 'no'} {key if number > 1 else key[:-1]} on {name}"
    elif "*" in name or "?" in name:
        text = f"{number or 'no'} {'nodes match' if number > 1 else 'node matches'} {name}"
    elif number == 0 or (number == 1 and (rule is None or judgement.level is Level.OK)):
        text = f"node {name} is {'there' if number else 'not there'}"
    else:
        text = f"{number} {'nodes are' if number > 1 else 'node is'} named {name}"
    if rule is None or rule.bound is None or not number or not rule.condition:
        return text
    side, bound = "below" if rule.is_below else "above", rule.bound
    if number < bound if rule.is_below else number > bound:
        return f"{text}, {side} {bound_text(bound)}"
    return f"{text}, was {side} {bound_text(bound)}, {_clears_text(config, rule, bound, number)}"


def _goals_text(judgement: Judgement) -> str:
    """Returns how many goals of an action were aborted, in round brackets after a space; empty for other signals."""
    config, mean, goals = judgement.config, judgement.judged, judgement.window_samples
    if not config.action or config.statistic != "mean" or mean is None:
        return ""
    return f" ({round(mean * goals)} of {count_text(goals, 'goal')} aborted)"


def _reported_text(judgement: Judgement) -> str:
    """Returns what a driver says about itself; a message that only names the level says nothing."""
    latest = judgement.latest
    if not isinstance(latest, DriverStatus) or math.isnan(latest.number):
        return latest_text(judgement)
    level = _LEVELS[latest.number]
    reported = f"reported as {level.lower()}"
    message = latest.message if isinstance(latest.message, str) else ""
    text = " ".join(printable(message[: _LONGEST_MESSAGE + 1]).split())
    if text.rstrip(".!").upper() == level:
        return reported
    if len(text) > _LONGEST_MESSAGE:
        text = f"{text[: _LONGEST_MESSAGE - 3]}..."
    if latest.number == Level.STALE:
        return f"{reported}: {text}" if text else reported
    return text or reported


def _with_state(text: str, judgement: Judgement) -> str:
    """Appends what keeps a rule from firing, or from clearing."""
    config, rule = judgement.config, judgement.rule
    if rule is None:
        return text
    if rule.held_back and config.only_if is not None:
        text += f" (ignored: {config.only_if.text(holds=False)})"
    if rule.state is State.PENDING and judgement.level is Level.OK:
        return f"{text}, pending for {duration_text(rule.waited_s(judgement.now_s))}"
    if rule.condition or judgement.level is Level.OK:
        return text
    if rule.fires:
        return f"{text}, {_KEEPING}"
    release = f" or {config.latch_release_if}" if config.latch_release_if else ""
    return f"{text}, latched until reset{release}"


def _undefined_reason(judgement: Judgement) -> str:
    config = judgement.config
    if config.statistic == "count":
        return f"count is undefined until window_s ({duration_text(config.window_s)}) has passed"
    if judgement.window_samples == 0:
        return "no valid sample since time went back"
    if not judgement.window.is_long_enough:
        return f"{config.statistic} is undefined until window_min_s ({duration_text(config.window_min_s)}) has passed"
    return f"{config.statistic} is undefined: too few samples"


def _settings(config: SignalConfig) -> dict[str, str]:
    """Returns the key-values that come from the configuration."""
    names = ["valid_min", "valid_max", "hysteresis", "for_s", "keep_firing_for_s", "stale_after_s"]
    if config.statistic != "last":
        names.append("window_min_s")
    if config.scale != 1.0:
        names.append("scale")
    settings = {**config.bounds, **{name: getattr(config, name) for name in (*names, *CONDITIONS)}}
    return {
        name: str(setting) if name in CONDITIONS else bound_text(setting)
        for name, setting in settings.items()
        if setting is not None
    }
