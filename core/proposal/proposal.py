"""What is proposed to be watched: signals with their settings, and the topics that are not watched, with the reason."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import groupby
from typing import Iterator, Mapping

from ..config import BOUNDS, read_signal
from ..values import ConfigError, Level, duration_text, element_path, list_text
from .candidates import AGE_RULES, FRACTIONS, OF_MIDDLEWARE, Candidates, Fields, Names
from .measured import MOST_ELEMENTS, Measured
from .suggestion import LEAST_RANGE_S, MOST_IRREGULAR, Setting, Signal, staleness, suggest

ORDER = (*BOUNDS, "hysteresis", "for_s", "stale_after_s", "depends_on")
"""Keys that are proposed, in the order in which they are written."""
OLDEST_S = 1.0
"""Largest age of stamps, in s, that is taken for a delay: older ones are of another clock, or of other times."""

FORECAST_WINDOW_S, FORECAST_S = 600.0, 1800.0
"""Window of a forecast, of which alerts must last half, and how far ahead it looks."""

EARLIEST_S = 0.001
"""Times are rounded: a stamp may be this much younger than its arrival, in s."""

PUBLISHED_HERE = "published by this monitor"
"""Why the topics of this package's own nodes are not watched."""
_SILENT = {"rate": "no message", "statuses": "no status"}
"""Why a topic is not watched whose first signal has no sample, by its kind."""
LEAST_ERRORS = 5
"""Smallest bound of errors in the log within a minute."""
_MORE_ELEMENTS = f"more than {MOST_ELEMENTS} elements: the others are left out"

_OF_BOUNDS = ("hysteresis", "for_s")
"""Keys that refer to the bounds: they are not proposed for bounds that were given."""


@dataclass
class Proposed:
    """Everything that is proposed for a robot."""

    signals: list[Signal]
    """Sorted by topic; signals that were given are in their order."""
    not_watched: dict[str, str] = field(default_factory=dict)
    """Why topics and nodes are not watched, by their absolute names."""
    fields: Fields = field(default_factory=dict)

    @property
    def reasons(self) -> str:
        """The first reasons why topics are not watched, in one line; empty without any."""
        return list_text([f"{topic}: {reason}" for topic, reason in sorted(self.not_watched.items())], 5)


def propose(candidates: Candidates, longest_s: Mapping[str, float] | None = None) -> Proposed:
    """Returns what is proposed of candidates that were listened to.

    `longest_s` has the longest healthy excursion, as `suggest` takes it, of every signal that raised an alert in a
    replay. If it is None, nothing is replayed, so that no forecast is proposed.
    """
    proposed = Proposed([], dict(candidates.not_watched), dict(candidates.fields))
    every = sorted(candidates.signals.values(), key=lambda each: "" if each.kind == "given" else each.topic)
    silent: set[str] = set()
    lasted_s = max((each.measured.duration_s for each in every), default=0.0)
    for topic, group in groupby(every, key=lambda each: each.topic):
        of_topic = list(group)
        first = of_topic[0]
        reason = "" if first.measured.samples else _SILENT.get(first.kind, "")
        if topic in candidates.own_topics and first.kind != "given":
            reason = PUBLISHED_HERE
        if reason:
            proposed.not_watched[topic] = reason
            silent.add(topic)
        else:
            for signal in of_topic:
                for each in _signals(signal, candidates, longest_s or {}, lasted_s):
                    _sort_in(each, proposed)
                    proposed.signals += _derived(each, candidates.names, longest_s)
    proposed.fields = {key: why for key, why in proposed.fields.items() if key[0] not in silent}
    if all(signal.kind == "log" for signal in proposed.signals):
        proposed.not_watched.update((signal.topic, OF_MIDDLEWARE) for signal in proposed.signals)
        proposed.signals = []  # a log alone is no robot
    return proposed


def _signals(
    candidate: Signal, candidates: Candidates, longest_s: Mapping[str, float], lasted_s: float
) -> Iterator[Signal]:
    """Yields a candidate, or one for each of its elements, with the settings that are proposed."""
    if (candidate.given.get("type"), candidate.given.get("field")) in FRACTIONS and candidate.kind == "number":
        _as_percentage(candidate)
    signal, measured = candidate.copy(), candidate.measured
    if signal.kind == "action":
        signal.note = "goals that ended"
        why = "a guess: more than half of the goals of the last 20 min were aborted"
        signal.seen["warn_above"] = Setting(0.5, why)
    elif signal.kind == "log":
        _add_errors(signal, lasted_s)
    elif signal.kind == "statuses":
        _add_statuses(signal)
    elif signal.kind in ("elements", "frames"):
        if measured.is_cut:
            yield candidate.copy(kind="elements", left_out=[_MORE_ELEMENTS])
        for element, element_measured in measured.elements.items():
            given = {**signal.given, "field": element_path(signal.given["field"], element)}
            name = candidates.names.of(signal.name, element)
            yield _suggested(candidate.copy(name=name, given=given, measured=element_measured), longest_s)
        return
    elif measured.samples:
        _suggested(signal, longest_s)
    elif signal.kind == "given":
        signal.note = "no message: unchanged"
    else:
        return
    yield signal


def _sort_in(signal: Signal, proposed: Proposed) -> None:
    """Adds a signal to those that are watched, or its field to those that are not."""
    is_frame = signal.kind == "frames" and bool(signal.proposed)
    is_watched = is_frame or signal.has_bounds or signal.kind in ("statuses", "log", "given", "action")
    if is_watched:
        proposed.not_watched.pop(signal.topic, "")  # where the rate, which comes first, is not
    if is_watched or signal.is_shown_only:
        proposed.signals.append(signal)
    elif signal.kind == "rate":
        proposed.not_watched[signal.topic] = signal.left_out[0].replace("no bounds: ", "")
    else:
        proposed.fields[signal.topic, signal.given["field"]] = (signal.left_out or ["no bounds"])[0]


def _derived(signal: Signal, names: Names, longest_s: Mapping[str, float] | None) -> Iterator[Signal]:
    """Yields what else the topic or the value of a signal is watched by.

    The largest gap of a topic so fast that its rate and its silence miss short gaps, and the forecast of a charge or a
    temperature towards the bound of its WARN: a comment if it raised an alert, or was not measured for long enough.
    """
    duration_s, stale = signal.measured.duration_s, signal.proposed.get("stale_after_s")
    bound = next((key for key in signal.proposed if key.startswith("warn")), "")
    if not bound or stale is None:
        return
    if signal.kind == "rate":
        gap = staleness(signal.measured.gaps, 0.0)
        if duration_s >= LEAST_RANGE_S * 0.999 and gap.value < stale.value:
            given = {**signal.given, "statistic": "largest_gap_s"}
            settings = {"warn_above": gap, "stale_after_s": stale}
            yield signal.copy(name=names.of(given["topic"], "gap"), given=given, proposed=settings)
    elif longest_s is not None and signal.rules and signal.given.get("unit") in ("%", "degC"):
        name = names.of(signal.name, "soon")
        given = {**signal.given, "statistic": "forecast", "window_s": FORECAST_WINDOW_S, "forecast_s": FORECAST_S}
        settings = {
            bound: signal.proposed[bound]._replace(evidence=f"the value in {duration_text(FORECAST_S)}"),
            "for_s": Setting(FORECAST_WINDOW_S / 2.0, "half of the window: noise that looks like a trend is no alert"),
            "stale_after_s": stale,
        }
        is_watched = name not in longest_s and duration_s > 2.0 * FORECAST_WINDOW_S
        yield signal.copy(name=name, given=given, **{"proposed" if is_watched else "seen": settings})


def _suggested(signal: Signal, longest_s: Mapping[str, float]) -> Signal:
    """Returns a signal with what is proposed for it."""
    measured = signal.measured
    reason = _not_a_delay(measured) if signal.rules is AGE_RULES else ""
    if reason and signal.kind == "age":
        signal.left_out.append(reason)
        return signal
    suggest(signal, longest_s.get(signal.name, 0.0))
    if signal.kind == "frames":
        if not measured.irregularity < MOST_IRREGULAR:
            signal.proposed["stale_after_s"] = Setting(0.0, "0: never; its transforms are not periodic")
        if reason:  # it is watched by its silence only
            stale = signal.proposed.get("stale_after_s", Setting(0.0, ""))
            signal.proposed = {"stale_after_s": stale} if stale.value else {}
            signal.seen, signal.left_out = {}, [f"no bounds: {reason}"]
    _check(signal)
    return signal


def _check(signal: Signal) -> None:
    """Drops proposed keys that contradict others; keys that were given stay."""
    proposed, signal.proposed = signal.proposed, {}
    has_bounds = any(key in signal.given for key in BOUNDS)
    for key in filter(proposed.__contains__, ORDER):
        if key in signal.given or (key in _OF_BOUNDS and has_bounds):
            signal.seen[key] = proposed[key]
            continue
        try:
            read_signal(signal.name, {**signal.settings, key: proposed[key].value})
        except ConfigError as error:
            signal.left_out.append(f"no {key}: {error.problem}")
        else:
            signal.proposed[key] = proposed[key]
    if has_bounds and all(reason.startswith("no bounds") for reason in signal.left_out):
        signal.left_out = []  # there are bounds


def _add_errors(signal: Signal, lasted_s: float) -> None:
    """Adds a bound of the errors in the log: three times as many as were seen in a minute."""
    most = max(0.0, signal.measured.values.max)
    per_minute = round(most * max(1.0, 60.0 / max(1.0, lasted_s)))
    bound = max(LEAST_ERRORS, 3 * per_minute)
    seen = f"at most {per_minute} per minute seen; three times that, at least" if most else "none seen; at least"
    signal.proposed["warn_above"] = Setting(float(bound), f"{seen} {LEAST_ERRORS}")
    signal.note = "errors in the log"


def _add_statuses(signal: Signal) -> None:
    """Adds what all statuses of drivers have in common: the longest time that one of them needs."""
    elements = signal.measured.elements
    stale_s = max([5.0, *(staleness(each.gaps).value for each in elements.values())])
    seen = "1 status" if len(elements) == 1 else f"{len(elements):,} statuses"
    signal.proposed["stale_after_s"] = Setting(stale_s, f"{seen} seen, each with its own level and message")
    alerting = [name for name, each in sorted(elements.items()) if each.values.max > Level.OK]
    if alerting:
        signal.note = f"these were not always OK, and raise alerts: {list_text(alerting, most=5)}"


def _as_percentage(signal: Signal) -> None:
    """Gives a field that is 0 to 1 by definition the unit %, once, whichever range the driver uses."""
    values = signal.measured.values
    if "unit" in signal.given or not values.count or values.min < 0.0 or values.max > 100.0:
        return
    scale = 100.0 if values.max <= 1.0 else 1.0
    signal.given.update({"scale": scale, "unit": "%", "valid_min": 0.0, "valid_max": 100.0})
    signal.measured.scale(scale, read_signal(signal.name, signal.given))
    seen = "are 0 to 1" if scale == 100.0 else "exceed 1, although the definition says 0 to 1"
    signal.note = f"scale: the values {seen}"


def _not_a_delay(measured: Measured) -> str:
    """Returns why the ages of stamps show no delay; empty if they do."""
    values = measured.values
    if not values.count:
        return "no stamps"
    if values.min < -EARLIEST_S or values.max > OLDEST_S:
        ages = f"{duration_text(values.min)} to {duration_text(values.max)}"
        return f"stamps are {ages} old, expected 0 to {duration_text(OLDEST_S)}"
    return ""
