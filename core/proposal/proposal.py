"""What is proposed to be watched: signals with their settings, and the topics that are not watched, with the reason."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field
from typing import Any, Container, Dict, Iterable, List, Mapping, Optional, Set, Tuple

from ..config.signal_config import BOUNDS, read_signal
from ..port.middleware import Middleware
from ..values.elements import ARRAY_TYPE, OWN_TOPICS, is_own_status
from ..values.errors import ConfigError
from ..values.field_path import element_path
from ..values.formatting import duration_text, list_text
from ..values.model import Level
from .candidates import AGE_RULES, FRACTIONS, OF_MIDDLEWARE, Candidate, Names, Topic, list_candidates
from .measured import Measured
from .suggestion import LEAST_RANGE_S, MOST_IRREGULAR, Setting, Suggestion, rounded, suggest
from .survey import MOST_ELEMENTS, Survey

ORDER = (*BOUNDS, "hysteresis", "for_s", "stale_after_s", "depends_on")
"""Keys that are proposed, in the order in which they are written."""
OLDEST_S = 1.0
"""Largest age of stamps, in s, that is taken for a delay: older ones are of another clock, or of other times."""

FORECASTS = ((600.0, 1800.0, 300.0), (600.0, 600.0, 300.0), (1200.0, 1200.0, 600.0))
"""`window_s`, `forecast_s` and `for_s` of forecasts: the first that raises no alert in recordings is proposed."""

EARLIEST_S = 0.001
"""Times are rounded: a stamp may be this much younger than its arrival, in s."""

PUBLISHED_HERE = "published by this monitor"
"""Why the topics of this package's own nodes are not watched."""
LEAST_ERRORS = 5
"""Smallest bound of errors in the log within a minute."""
_MORE_ELEMENTS = f"more than {MOST_ELEMENTS} elements: the others are left out"

_OF_BOUNDS = ("hysteresis", "for_s")
"""Keys that refer to the bounds: they are not proposed for bounds that were given."""


@dataclass
class Signal:
    """One signal that is proposed."""

    name: str
    topic: str
    """The absolute name of its topic; of the graph such as `node /lidar`."""
    given: Dict[str, Any]
    """Settings apart from those that are proposed."""
    suggestion: Suggestion
    measured: Measured
    note: str = ""
    is_given: bool = False
    """Whether it was configured before, and stays."""

    @property
    def settings(self) -> Dict[str, Any]:
        """All settings."""
        return {**self.given, **{key: setting.value for key, setting in self.suggestion.settings.items()}}

    @property
    def is_shown_only(self) -> bool:
        """Whether it is no more than a comment: its range was not seen for long enough."""
        is_guess = bool(self.suggestion.seen) and not self.suggestion.has_bounds and not self.is_given
        return is_guess and "action" not in self.given


@dataclass
class Proposed:
    """Everything that is proposed for a robot."""

    signals: List[Signal]
    """Sorted by topic."""
    not_watched: Dict[str, str] = field(default_factory=dict)
    """Why topics and nodes are not watched, by their absolute names."""
    fields: Dict[str, Dict[str, List[str]]] = field(default_factory=dict)
    """Numbers that are not watched, by the topics and the reasons."""


class Proposal:
    """Listens to the topics of a robot, and proposes what to watch. Serves recordings and live robots alike."""

    def __init__(self, namespace: str = "", *, ages_of_bulk: bool = True, taken: Iterable[str] = ()) -> None:
        """Starts without topics; `taken` are names of signals not to use, the others as of `list_candidates`."""
        self.topics: Dict[str, str] = {}
        """Types of the topics that are listened to, by their absolute names."""
        self.problems: List[str] = []
        self.namespace = namespace
        self._ages_of_bulk = ages_of_bulk
        self.names = Names(taken)
        self._names_used: Dict[Tuple[str, ...], str] = {}
        self._survey = Survey()
        self._candidates: Dict[str, Candidate] = {}
        self._left_out: Dict[str, str] = {}
        self._fields: Dict[str, Dict[str, List[str]]] = {}
        self.own_topics: Set[str] = set()
        """Topics that this package's nodes publish, as their statuses say: a monitor is not watched by itself."""

    def take(self, topics: Iterable[Topic]) -> None:
        """Adds topics, for `listen`; those that were added before are ignored."""
        new = [each for each in topics if each.topic not in self.topics]
        before = self._candidates.values()
        listing = list_candidates(new, self.namespace, self.names, ages_of_bulk=self._ages_of_bulk, before=before)
        self.problems += listing.problems
        self._left_out.update(listing.left_out)
        for topic, reasons in listing.fields.items():
            self._fields[topic] = {reason: list(fields) for reason, fields in reasons.items()}
        self.topics.update((each.topic, each.type_name) for each in reversed(new))
        self._candidates.update((each.name, each) for each in listing.candidates)

    def begin_recording(self) -> None:
        """As of `Survey`."""
        self._survey.begin_recording()

    def listen(self, node: Middleware, topics: Container[str]) -> None:
        """Subscribes to topics that were taken, by their absolute names; one that cannot be subscribed is left out."""
        for name, candidate in list(self._candidates.items()):
            if candidate.topic in topics and candidate.kind != "action":
                try:
                    settings = {**candidate.settings, "topic": candidate.topic}  # `node` is in any namespace
                    self._survey.listen(node, {name: read_signal(name, settings)})
                    if candidate.kind == "statuses":
                        node.subscribe(candidate.topic, ARRAY_TYPE, self._note_own_topics)
                except ConfigError as error:
                    del self._candidates[name]
                    reasons = self._fields.setdefault(candidate.topic, {})
                    reasons.setdefault(error.problem, []).append(candidate.settings["field"])

    @property
    def samples(self) -> int:
        """Messages that were heard until now."""
        arrivals = [name for name, each in self._candidates.items() if each.kind in ("rate", "statuses")]
        return sum(self._survey.measured[name].samples for name in arrivals if name in self._survey.measured)

    def result(
        self, longest_s: Optional[Mapping[str, float]] = None, forecasts: Optional[Mapping[str, int]] = None
    ) -> Proposed:
        """Returns what is proposed.

        `longest_s` has the longest healthy excursion of signals, as `suggest` takes it. `forecasts` has which of
        `FORECASTS` a forecast uses, 0 if it is not there; None: forecasts are only shown, since nothing was replayed.
        """
        proposed = Proposed([], dict(self._left_out), copy.deepcopy(self._fields))
        rates: Dict[str, Signal] = {}
        for name, candidate in sorted(self._candidates.items(), key=lambda each: each[1].topic):
            measured = self._survey.measured.get(name)
            if candidate.topic in self.own_topics:
                proposed.not_watched[candidate.topic] = PUBLISHED_HERE
                proposed.fields.pop(candidate.topic, None)
                continue
            if candidate.kind in ("action", "log"):
                make = _action if candidate.kind == "action" else self._log
                proposed.signals.append(make(candidate))
                continue
            if measured is None or not measured.samples:
                if candidate.kind in ("rate", "statuses"):
                    proposed.not_watched[candidate.topic] = "no message" if candidate.kind == "rate" else "no status"
                    proposed.fields.pop(candidate.topic, None)
                continue
            for signal in self._signals(candidate, measured, longest_s or {}):
                self._sort_in(candidate, signal, proposed, rates)
                if candidate.rules and candidate.kind == "number" and not signal.given.get("reduce"):
                    proposed.signals += _forecast(signal, forecasts)
        for topic, rate in rates.items():
            if rate.suggestion.has_bounds:
                proposed.signals[:0] = [rate, *_gap(rate)]
            elif all(signal.is_shown_only or signal.topic != topic for signal in proposed.signals):
                proposed.not_watched[topic] = rate.suggestion.left_out[0].replace("no bounds: ", "")
        proposed.signals.sort(key=lambda signal: signal.topic)  # the rate of a topic stays first
        if all(signal.given.get("statistic") == "count" for signal in proposed.signals):
            proposed.not_watched.update((signal.topic, OF_MIDDLEWARE) for signal in proposed.signals)
            proposed.signals = []  # a log alone is no robot
        return proposed

    @property
    def statuses(self) -> List[Tuple[str, str]]:
        """The drivers' statuses that are watched: the name of a signal, and the name of the status."""
        watched = [each for each in self._candidates.values() if each.kind == "statuses"]
        return [(each.name, status) for each in watched for status in self._survey.elements.get(each.name, ())]

    def needed_s(self, kinds: Container[str] = ("number", "elements")) -> float:
        """Returns how long to listen, in s, so that everything that came has enough samples for bounds; 0 if it has."""
        names = [each.name for each in self._candidates.values() if each.kind in kinds]
        measured = [self._survey.measured[name] for name in names if name in self._survey.measured]
        measured += [each for name in names for each in self._survey.elements.get(name, {}).values()]
        return max((each.needed_s for each in measured), default=0.0)

    def _note_own_topics(self, message: Any, now_s: float) -> None:
        for status in message["status"]:
            values = {pair["key"]: pair["value"] for pair in status["values"]}
            if OWN_TOPICS in values and is_own_status(status["name"], values):
                self.own_topics.update(values[OWN_TOPICS].split(", "))

    def _sort_in(self, candidate: Candidate, signal: Signal, proposed: Proposed, rates: Dict[str, Signal]) -> None:
        if candidate.kind == "rate":
            rates[signal.topic] = signal
            return
        suggestion = signal.suggestion
        is_watched = candidate.kind == "statuses" or (candidate.kind == "frames" and bool(suggestion.settings))
        if is_watched or suggestion.has_bounds or signal.is_shown_only:
            proposed.signals.append(signal)
            return
        reason = (suggestion.left_out or ["no bounds"])[0]
        fields = proposed.fields.setdefault(signal.topic, {}).setdefault(reason, [])
        if signal.given["field"] not in fields:  # minimum and maximum of an array
            fields.append(signal.given["field"])

    def _signals(self, candidate: Candidate, measured: Measured, longest_s: Mapping[str, float]) -> Iterable[Signal]:
        given = dict(candidate.settings)
        if candidate.kind == "statuses":
            yield self._statuses(candidate, measured, given)
            return
        if candidate.kind in ("elements", "frames"):
            elements = self._survey.elements.get(candidate.name, {})
            if candidate.name in self._survey.cut:
                yield Signal(candidate.name, candidate.topic, given, Suggestion({}, {}, [_MORE_ELEMENTS]), measured)
            for element, found in elements.items():
                path = element_path(given["field"], element)
                of_element = {**given, "field": path}
                yield self._signal(candidate, self._name_of(candidate.name, element), of_element, found, longest_s)
            return
        yield self._signal(candidate, candidate.name, given, measured, longest_s)

    def _signal(
        self, candidate: Candidate, name: str, given: Dict[str, Any], measured: Measured, longest_s: Mapping[str, float]
    ) -> Signal:
        note = ""
        if (given["type"], given["field"]) in FRACTIONS:
            note = _as_percentage(given, measured)
        reason = _not_a_delay(measured) if candidate.rules is AGE_RULES else ""
        if reason and candidate.kind == "age":
            return Signal(name, candidate.topic, given, Suggestion({}, {}, [reason]), measured)
        found = suggest(measured, longest_s.get(name), candidate.rules)
        if candidate.kind == "frames":
            found = _of_frame(measured, found, reason)
        return Signal(name, candidate.topic, given, checked(name, given, found), measured, note)

    def _log(self, candidate: Candidate) -> Signal:
        """Returns the signal of the errors in the log, with a bound of three times as many as were seen in a minute."""
        measured = self._survey.measured[candidate.name]
        lasted_s = max(each.duration_s for each in self._survey.measured.values())
        most = measured.values.max if measured.values.count else 0.0
        per_minute = round(most * max(1.0, 60.0 / max(1.0, lasted_s)))
        bound = max(LEAST_ERRORS, 3 * per_minute)
        seen = f"at most {per_minute} per minute seen; three times that, at least" if most else "none seen; at least"
        settings = {"warn_above": Setting(float(bound), f"{seen} {LEAST_ERRORS}")}
        given = dict(candidate.settings)
        return Signal(
            candidate.name, candidate.topic, given, Suggestion(settings, {}, []), measured, "errors in the log"
        )

    def _name_of(self, *words: str) -> str:
        """Returns the name of the signal of an element, each time the same."""
        if words not in self._names_used:
            self._names_used[words] = self.names.new(*words)
        return self._names_used[words]

    def _statuses(self, candidate: Candidate, measured: Measured, given: Dict[str, Any]) -> Signal:
        """Returns the signal of all statuses, with the longest time that one of them needs."""
        elements = self._survey.elements.get(candidate.name, {})
        stale_s = 5.0
        for each in elements.values():
            setting = suggest(each).settings.get("stale_after_s", Setting(0.0, ""))
            stale_s = max(stale_s, setting.value)
        seen = "1 status" if len(elements) == 1 else f"{len(elements):,} statuses"
        settings = {"stale_after_s": Setting(stale_s, f"{seen} seen, each with its own level and message")}
        alerting = [name for name, each in sorted(elements.items()) if each.values.count and each.values.max > Level.OK]
        note = f"these were not always OK, and raise alerts: {list_text(alerting, most=5)}" if alerting else ""
        return Signal(candidate.name, candidate.topic, given, Suggestion(settings, {}, []), measured, note)


def checked(name: str, given: Mapping[str, Any], found: Suggestion) -> Suggestion:
    """Returns a suggestion beside settings that were given: these stay, and nothing contradicts them."""
    all_keys = dict(given)
    has_bounds = any(key in given for key in BOUNDS)
    settings: Dict[str, Setting] = {}
    seen, left_out = dict(found.seen), list(found.left_out)
    for key in ORDER:
        if key not in found.settings:
            continue
        try:
            if key in given or (key in _OF_BOUNDS and has_bounds):
                seen[key] = found.settings[key]
                continue
            read_signal(name, {**all_keys, key: found.settings[key].value})
        except ConfigError as error:
            left_out.append(f"no {key}: {error.problem}")
        else:
            all_keys[key] = found.settings[key].value
            settings[key] = found.settings[key]
    if has_bounds and all(reason.startswith("no bounds") for reason in left_out):
        left_out = []  # there are bounds
    return Suggestion(settings, seen, left_out)


def _as_percentage(given: Dict[str, Any], measured: Measured) -> str:
    """Gives a field that is 0 to 1 by definition the unit %, whichever range the driver uses; returns a note."""
    values = measured.values
    if measured.config.unit == "%":
        scale = measured.config.scale
    elif not values.count or values.min < 0.0 or values.max > 100.0:
        return ""
    else:
        scale = 100.0 if values.max <= 1.0 else 1.0
    given.update({"scale": scale, "unit": "%", "valid_min": 0.0, "valid_max": 100.0})
    if measured.config.unit != "%":
        measured.scale(scale, read_signal(measured.config.name, given))
    seen = "are 0 to 1" if scale == 100.0 else "exceed 1, although the definition says 0 to 1"
    return f"scale: the values {seen}"


def _not_a_delay(measured: Measured) -> str:
    """Returns why the ages of stamps show no delay; empty if they do."""
    values = measured.values
    if not values.count:
        return "no stamps"
    if values.min < -EARLIEST_S or values.max > OLDEST_S:
        ages = f"{duration_text(values.min)} to {duration_text(values.max)}"
        return f"stamps are {ages} old, expected 0 to {duration_text(OLDEST_S)}"
    return ""


def _of_frame(measured: Measured, found: Suggestion, reason: str) -> Suggestion:
    """Returns how the transform of a frame is watched: by its silence, and by the age of its stamps if that is one."""
    settings = dict(found.settings)
    if not measured.irregularity < MOST_IRREGULAR:
        settings["stale_after_s"] = Setting(0.0, "0: never; its transforms are not periodic")
    if not reason:
        return found._replace(settings=settings)
    stale = settings["stale_after_s"]
    return Suggestion({"stale_after_s": stale} if stale.value else {}, {}, [f"no bounds: {reason}"])


def _forecast(signal: Signal, forecasts: Optional[Mapping[str, int]]) -> List[Signal]:
    """Returns the forecast of a charge or a temperature, towards the bound of its WARN; none if there is no such."""
    name = f"{signal.name}_soon"
    option = (forecasts or {}).get(name, 0)
    key = next((key for key in ("warn_below", "warn_above") if key in signal.suggestion.settings), None)
    if key is None:
        return []
    window_s, forecast_s, for_s = FORECASTS[min(option, len(FORECASTS) - 1)]
    given = {**signal.given, "statistic": "forecast", "window_s": window_s, "forecast_s": forecast_s}
    settings = {
        key: signal.suggestion.settings[key]._replace(evidence=f"the value in {duration_text(forecast_s)}"),
        "for_s": Setting(for_s, "half of the window: noise that looks like a trend is no alert"),
        "stale_after_s": signal.suggestion.settings["stale_after_s"],
    }
    is_tried = forecasts is not None and option < len(FORECASTS) and signal.measured.duration_s > 2.0 * window_s
    found = Suggestion(settings, {}, []) if is_tried else Suggestion({}, settings, [])
    return [Signal(name, signal.topic, given, found, signal.measured)]


def _gap(rate: Signal) -> List[Signal]:
    """Returns the largest gap of a topic so fast that staleness and rate miss short gaps; none for other topics."""
    measured, stale_s = rate.measured, rate.suggestion.settings["stale_after_s"].value
    bound_s = rounded(max(2.0 * measured.gaps.max, 5.0 * measured.gaps.quantile(0.5)), math.ceil)
    if measured.duration_s < LEAST_RANGE_S * 0.999 or not 0.0 < bound_s < stale_s:
        return []
    seen = f"longest gap {duration_text(measured.gaps.max)}, median {duration_text(measured.gaps.quantile(0.5))}"
    settings = {"warn_above": Setting(bound_s, seen), "stale_after_s": rate.suggestion.settings["stale_after_s"]}
    given = {**rate.given, "statistic": "largest_gap_s"}
    name = f"{rate.name[: -len('_rate')]}_gap"
    return [Signal(name, rate.topic, given, Suggestion(settings, {}, []), measured)]


def _action(candidate: Candidate) -> Signal:
    """Returns the signal of an action, which is shown; how many of its goals are usually aborted is not known."""
    given = dict(candidate.settings)
    seen = {"warn_above": Setting(0.5, "a guess: more than half of the goals of the last 20 min were aborted")}
    measured = Measured(read_signal(candidate.name, given))
    return Signal(candidate.name, candidate.topic, given, Suggestion({}, seen, []), measured, "goals that ended")
