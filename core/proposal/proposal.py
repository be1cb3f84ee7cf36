"""What is proposed to be watched: signals with their settings, and the topics that are not watched, with the reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any, Container, Dict, Iterable, Iterator, List, Mapping, Set, Tuple

from ..config.signal_config import BOUNDS, read_signal
from ..judge.attachments import TICKS
from ..port.middleware import Middleware
from ..values.elements import ARRAY_TYPE, OWN_TOPICS, is_own_status
from ..values.errors import ConfigError
from ..values.field_path import element_path
from ..values.formatting import duration_text, list_text
from ..values.model import Level
from .candidates import AGE_RULES, FRACTIONS, OF_MIDDLEWARE, Candidates, Fields
from .measured import MOST_ELEMENTS, Measured
from .suggestion import LEAST_RANGE_S, MOST_IRREGULAR, Setting, Signal, rounded, suggest

ORDER = (*BOUNDS, "hysteresis", "for_s", "stale_after_s", "depends_on")
"""Keys that are proposed, in the order in which they are written."""
OLDEST_S = 1.0
"""Largest age of stamps, in s, that is taken for a delay: older ones are of another clock, or of other times."""

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
class Proposed:
    """Everything that is proposed for a robot."""

    signals: List[Signal]
    """Sorted by topic; signals that were given are in their order."""
    not_watched: Dict[str, str] = field(default_factory=dict)
    """Why topics and nodes are not watched, by their absolute names."""
    fields: Fields = field(default_factory=dict)


class Proposal:
    """Listens to signals, and proposes what to watch. Serves recordings and live robots alike."""

    def __init__(self, candidates: Candidates) -> None:
        """Hears nothing yet; candidates may be added later, and are signals of kind `given`, too."""
        self.candidates = candidates
        self.own_topics: Set[str] = {TICKS}
        """Topics that this package's nodes publish, as their statuses say: a monitor is not watched by itself."""

    def begin_recording(self) -> None:
        """Ends the previous recording: the time up to the next one is no gap."""
        for signal in self.candidates.signals.values():
            signal.measured.begin_recording()

    def listen(self, node: Middleware, topics: Container[str]) -> None:
        """Subscribes to topics of candidates, by their absolute names; one that cannot be subscribed is left out."""
        for name, signal in list(self.candidates.signals.items()):
            if signal.topic in topics and signal.kind != "action":
                try:
                    # A candidate is listened to by a node in any namespace.
                    place = {} if signal.kind == "given" else {"topic": signal.topic}
                    signal.measured.config = read_signal(name, {**signal.given, **place})
                    signal.measured.listen(node)
                    if signal.kind == "statuses":
                        node.subscribe(signal.topic, ARRAY_TYPE, self._note_own_topics)
                except ConfigError as error:
                    if signal.kind == "given":
                        raise
                    del self.candidates.signals[name]
                    self.candidates.fields[signal.topic, signal.given["field"]] = error.problem

    @property
    def samples(self) -> int:
        """Messages that were heard until now."""
        signals = self.candidates.signals.values()
        return sum(each.measured.samples for each in signals if each.kind in ("rate", "statuses"))

    def needed_s(self) -> float:
        """Returns how long to listen, in s, so that all numbers that came have enough samples for bounds; 0 if so."""
        signals = self.candidates.signals.values()
        measured = [each.measured for each in signals if each.kind in ("number", "elements")]
        parts = [part for each in measured for part in (each, *each.elements.values())]
        return max((each.needed_s for each in parts), default=0.0)

    def result(self, longest_s: Mapping[str, float] = {}) -> Proposed:
        """Returns what is proposed; `longest_s` has the longest healthy excursion of signals, as `suggest` takes it."""
        candidates = self.candidates
        proposed = Proposed([], dict(candidates.not_watched), dict(candidates.fields))
        every = sorted(candidates.signals.values(), key=lambda each: "" if each.kind == "given" else each.topic)
        for topic, group in groupby(every, key=lambda each: each.topic):
            of_topic = list(group)
            first = of_topic[0]
            reason = PUBLISHED_HERE if topic in self.own_topics and first.kind != "given" else ""
            if first.kind in ("rate", "statuses") and not first.measured.samples:
                reason = reason or ("no message" if first.kind == "rate" else "no status")
            if reason:
                proposed.not_watched[topic] = reason
                continue
            for signal in of_topic:
                for each in self._signals(signal, longest_s):
                    _sort_in(each, proposed)
        proposed.fields = {key: why for key, why in proposed.fields.items() if key[0] not in proposed.not_watched}
        if all(signal.kind == "log" for signal in proposed.signals):
            proposed.not_watched.update((signal.topic, OF_MIDDLEWARE) for signal in proposed.signals)
            proposed.signals = []  # a log alone is no robot
        return proposed

    @property
    def statuses(self) -> List[Tuple[str, str]]:
        """The drivers' statuses that are watched: the name of a signal, and the name of the status."""
        signals = [each for each in self.candidates.signals.values() if each.kind == "statuses"]
        return [(each.name, status) for each in signals for status in each.measured.elements]

    def _note_own_topics(self, message: Any, now_s: float) -> None:
        for status in message["status"]:
            values = {pair["key"]: pair["value"] for pair in status["values"]}
            if OWN_TOPICS in values and is_own_status(status["name"], values):
                self.own_topics.update(values[OWN_TOPICS].split(", "))

    def _signals(self, candidate: Signal, longest_s: Mapping[str, float]) -> Iterator[Signal]:
        """Yields a candidate, or one for each of its elements, with the settings that are proposed."""
        if (candidate.given.get("type"), candidate.given.get("field")) in FRACTIONS and candidate.kind == "number":
            _as_percentage(candidate)
        signal, measured = candidate.copy(), candidate.measured
        if signal.kind == "action":
            signal.note = "goals that ended"
            why = "a guess: more than half of the goals of the last 20 min were aborted"
            signal.seen["warn_above"] = Setting(0.5, why)
            yield signal
        elif signal.kind == "log":
            _add_errors(signal, max(each.measured.duration_s for each in self.candidates.signals.values()))
            yield signal
        elif signal.kind == "statuses":
            _add_statuses(signal)
            yield signal
        elif signal.kind in ("elements", "frames"):
            if measured.is_cut:
                yield candidate.copy(kind="elements", left_out=[_MORE_ELEMENTS])
            for element, found in measured.elements.items():
                given = {**signal.given, "field": element_path(signal.given["field"], element)}
                name = self.candidates.names.of(signal.name, element)
                yield _suggested(candidate.copy(name=name, given=given, measured=found), longest_s)
        elif measured.samples:
            yield _suggested(signal, longest_s)
        elif signal.kind == "given":
            yield candidate.copy(note="no message: unchanged")


def _sort_in(signal: Signal, proposed: Proposed) -> None:
    """Adds a signal to those that are watched, or its field to those that are not."""
    is_frame = signal.kind == "frames" and bool(signal.proposed)
    is_watched = is_frame or signal.has_bounds or signal.kind in ("statuses", "log", "given", "action")
    if is_watched:
        proposed.not_watched.pop(signal.topic, "")  # where the rate, which comes first, is not
    if is_watched or signal.is_shown_only:
        proposed.signals += [signal, *_gap(signal)]
    elif signal.kind == "rate":
        proposed.not_watched[signal.topic] = signal.left_out[0].replace("no bounds: ", "")
    else:
        proposed.fields[signal.topic, signal.given["field"]] = (signal.left_out or ["no bounds"])[0]


def _suggested(signal: Signal, longest_s: Mapping[str, float]) -> Signal:
    """Returns a signal with what is proposed for it."""
    measured = signal.measured
    reason = _not_a_delay(measured) if signal.rules is AGE_RULES else ""
    if reason and signal.kind == "age":
        signal.left_out.append(reason)
        return signal
    suggest(signal, longest_s.get(signal.name))
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
    found, signal.proposed = signal.proposed, {}
    has_bounds = any(key in signal.given for key in BOUNDS)
    for key in filter(found.__contains__, ORDER):
        if key in signal.given or (key in _OF_BOUNDS and has_bounds):
            signal.seen[key] = found[key]
            continue
        try:
            read_signal(signal.name, {**signal.settings, key: found[key].value})
        except ConfigError as error:
            signal.left_out.append(f"no {key}: {error.problem}")
        else:
            signal.proposed[key] = found[key]
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
    stale_s, elements = 5.0, signal.measured.elements
    for each in elements.values():
        of_status = signal.copy(measured=each)
        suggest(of_status)
        stale_s = max(stale_s, of_status.settings.get("stale_after_s", 0.0))
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


def _gap(rate: Signal) -> Iterable[Signal]:
    """Returns the largest gap of a topic so fast that staleness and rate miss short gaps; none for other topics."""
    measured = rate.measured
    if rate.kind != "rate":
        return []
    longest_s, median_s = measured.gaps.max, measured.gaps.quantile(0.5)
    bound_s = rounded(max(2.0 * longest_s, 5.0 * median_s), math.ceil)
    stale = rate.proposed["stale_after_s"]
    if measured.duration_s < LEAST_RANGE_S * 0.999 or not 0.0 < bound_s < stale.value:
        return []
    gap = rate.copy(name=f"{rate.name[: -len('_rate')]}_gap", kind="gap")
    gap.given["statistic"] = "largest_gap_s"
    seen = f"longest gap {duration_text(longest_s)}, median {duration_text(median_s)}"
    gap.proposed = {"warn_above": Setting(bound_s, seen), "stale_after_s": stale}
    return [gap]
