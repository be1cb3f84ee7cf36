"""Share of time per level, availability, alerts, outages and the course of the level of each signal.

A level is known while a monitor watched the robot and the robot's link was up. Everything else is unknown: before the
first run, gaps between runs, and link downtime (except for the signal `link` itself). OK lasts as long as the
transition that ends it says, or the saved state while it lasts: the rest, such as the time before the first sample, is
unknown too.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from sqlite3 import Connection
from typing import Iterator, List, Mapping, Sequence, Tuple

from ...core.config import LINK, template_name
from ...core.judge import Downtime, SavedState, is_source
from ...core.values import Level, matches_pattern, read_json
from .queries import pattern_condition, transitions
from .rows import StoredTransition, select

MOST_LEVELS = 5_000
"""Most changes in the course of a level; after them it is unknown."""

_ROUNDING_S, _ROUNDING = 1e-6, 1e-9

_Spans = List[Tuple[float, float]]
"""Times from begin to end that are sorted and do not overlap."""


@dataclass
class SignalSummary:
    """The past of one signal, from its transitions in their order. Durations are in s, times in s since 1970."""

    robot: str
    signal: str
    spans: Sequence[_Spans]
    """When its level is known: the times that are in all of them."""
    begin_s: float
    """Begin of the time that is summarized."""
    end_s: float
    lasting_s: float | None = None
    """For how long its present level has been known by its state; None if it has none."""
    level: Level | None = None
    """The level now; None before the first transition, where it is OK if there is none."""
    times: dict[Level, float] = field(default_factory=dict)
    """Duration of each level as far as it is known."""
    alerts: int = 0
    """Alerts that began in this time; one that changes its level is one."""
    outage_s: float = 0.0
    """Duration of the present outage."""
    began_in_time: bool = False
    """Whether it began in this time."""
    longest_outage_s: float = 0.0
    """Longest time in which the level was not OK. Unknown time neither ends an outage nor counts."""
    recoveries_s: list[float] = field(default_factory=list)
    """Duration of each outage that began and ended in this time; as before, unknown time does not count."""
    levels: list[tuple[float, Level | None]] = field(default_factory=list)
    """The course of the level: begin of each; None where it is unknown."""
    cause: str = ""
    """Name of the latest alert of which it was an effect, if it was not announced itself; else empty."""
    advanced_to_s: float = 0.0
    """Until when the figures reach."""

    @property
    def duration_s(self) -> float:
        """Length of the time that is summarized, in s; the shares refer to it."""
        return self.end_s - self.begin_s

    @property
    def shares(self) -> Mapping[Level, float]:
        """Share of time per announced level, 0 to 1; levels that did not occur are missing."""
        return {level: seconds / self.duration_s for level, seconds in self.times.items()}

    @property
    def unknown(self) -> float:
        """Share of time in which the level is not known, 0 to 1."""
        unknown = 1.0 - sum(self.shares.values())
        return unknown if unknown > _ROUNDING else 0.0

    @property
    def availability(self) -> float | None:
        """Share of OK of the known time, 0 to 1; None if nothing is known."""
        known_s = sum(self.times.values())
        return self.times.get(Level.OK, 0.0) / known_s if known_s > 0.0 else None

    @property
    def mean_time_to_recover_s(self) -> float | None:
        """Mean of `recoveries_s`; None if there was none."""
        return sum(self.recoveries_s) / len(self.recoveries_s) if self.recoveries_s else None

    def apply(self, transition: StoredTransition) -> None:
        """Applies a transition, but a repetition: its earlier level was announced and known since its `since_s`."""
        if self.level is None:
            self.level = transition.from_level
        self.advance(transition.wall_s, transition.now_s - transition.since_s)
        is_in_time = self.begin_s <= transition.wall_s <= self.end_s
        if is_in_time and transition.from_level is Level.OK:
            self.alerts += 1
        if transition.to_level is Level.OK:
            if self.began_in_time and is_in_time:
                self.recoveries_s.append(self.outage_s)
            self.outage_s = 0.0
        elif self.level is Level.OK:
            self.began_in_time = is_in_time
        self.level = transition.to_level

    def advance(self, until_s: float, lasted_s: float) -> None:
        """Adds the time since the last call to the level, as far as it is known: of an OK at most the last seconds."""
        level, from_s, until_s = self.level or Level.OK, max(self.advanced_to_s, self.begin_s), min(until_s, self.end_s)
        if until_s <= from_s:
            return  # the wall clock was set back
        self.advanced_to_s = until_s
        pieces = [*_within(self.spans, from_s, until_s)]
        unknown_s = 0.0
        if level is Level.OK:
            unknown_s = sum(end_s - begin_s for begin_s, end_s in pieces) - max(lasted_s, 0.0)
        self._note_level(from_s, None)
        for begin_s, end_s in pieces:
            if unknown_s > _ROUNDING_S:
                length_s = end_s - begin_s
                begin_s, unknown_s = min(begin_s + unknown_s, end_s), unknown_s - length_s
            if begin_s < end_s:
                self._note_level(begin_s, level)
                self._note_level(end_s, None)
                self.times[level] = self.times.get(level, 0.0) + end_s - begin_s
                if level is not Level.OK:
                    self.outage_s += end_s - begin_s
                    self.longest_outage_s = max(self.longest_outage_s, self.outage_s)

    def _note_level(self, wall_s: float, level: Level | None) -> None:
        """Adds a begin to the course of the level."""
        levels = self.levels
        if len(levels) > MOST_LEVELS:
            return
        if levels and levels[-1][0] >= wall_s:
            levels.pop()
        if not levels or levels[-1][1] is not level:
            levels.append((wall_s, level if len(levels) < MOST_LEVELS else None))


def summarize(
    connection: Connection,
    now_s: float,
    *,
    since_s: float | None = None,
    robot: str | None = None,
    signal: str | None = None,
) -> list[SignalSummary]:
    """Returns a summary per robot and signal, and per topic that was silent, sorted by their names.

    It reaches from `since_s` to `now_s`, in s since 1970; if `since_s` is None, from when the robot was first watched.
    In `robot` and `signal`, `*` and `?` work as in file names.
    """
    watched = _watched(connection, robot)
    links_up: dict[str, _Spans] = {name: [(-math.inf, math.inf)] for name in watched}
    signals: dict[tuple[str, str], SignalSummary] = {}

    def signal_of(name: str, signal_name: str) -> SignalSummary:
        spans = [watched[name]] if signal_name == LINK else [watched[name], links_up[name]]
        begin_s = max(watched[name][0][0], since_s or 0.0)
        made = SignalSummary(name, signal_name, spans, begin_s, now_s)
        return signals.setdefault((name, signal_name), made)

    for name, signal_name, state in connection.execute("SELECT robot, signal, state FROM signal_states"):
        if name in watched and isinstance(signal_name, str):
            signal_of(name, signal_name).lasting_s = _known_s(state, now_s)
    causes: dict[tuple[str, str], str] = {}  # the alert of which each signal was an effect at last
    for each in transitions(connection, robot=robot):
        if each.robot in watched and not each.repeat:
            if each.signal == LINK:
                _note_link(links_up[each.robot], each.wall_s, each.to_level)
            causes.update(((each.robot, effect), each.signal) for effect in each.effects)
            signal_of(each.robot, each.signal).apply(each)
    summaries = []
    for (name, signal_name), summary in sorted(signals.items()):
        if summary.duration_s > 0.0 and (signal is None or matches_pattern(signal_name, signal)):
            # An element without a state has ended (forget_after_s): what came after is not known.
            without_state_s = math.inf if signal_name == template_name(signal_name) else 0.0
            summary.advance(now_s, without_state_s if summary.lasting_s is None else summary.lasting_s)
            summary.levels = [each for each in summary.levels if each[0] < now_s]
            was_ok = summary.times.keys() <= {Level.OK}
            if was_ok:
                summary.cause = causes.get((name, signal_name), "")
            if not (was_ok and is_source(signal_name)):  # topics are shown while they are silent
                summaries.append(summary)
    return summaries


def _within(spans: Sequence[_Spans], from_s: float, to_s: float) -> Iterator[tuple[float, float]]:
    """Yields the parts between two times that are in all of the spans."""
    if not spans:
        yield from_s, to_s
        return
    for begin_s, end_s in spans[0][max(bisect_right(spans[0], (from_s, math.inf)) - 1, 0) :]:
        if begin_s >= to_s:
            return
        if max(begin_s, from_s) < min(end_s, to_s):
            yield from _within(spans[1:], max(begin_s, from_s), min(end_s, to_s))


def _note_link(ups: _Spans, wall_s: float, level: Level) -> None:
    """Notes in the times in which a link was up that it went down or came up."""
    begin_s, end_s = ups[-1]
    wall_s = max(wall_s, begin_s)
    if end_s == math.inf:
        ups[-1] = begin_s, wall_s
    if level is Level.OK:
        ups.append((wall_s, math.inf))


def _known_s(state: object, now_s: float) -> float:
    """Returns how long the announced level in a saved state has been known, in s; infinity if it does not say."""
    try:
        saved = SavedState(now_s, read_json(state), Downtime(now_s, now_s))
        if saved.section("announced").value("never_known", False, False):
            return 0.0
        since = saved.section("since")
        announced, unknown = since.value("announced", None, float), since.value("unknown", None, float)
    except (TypeError, ValueError):  # also UnusableStateError
        return math.inf
    return math.inf if announced is None else max(0.0, (now_s if unknown is None else unknown) - announced)


def _watched(connection: Connection, robot: str | None) -> dict[str, _Spans]:
    """Returns the times in which each robot was watched, merged and sorted."""
    query = f"""
        SELECT watches.id, robot, watches.started_s, coalesce(watches.stopped_s, runs.stopped_s, alive_s) AS end_s
        FROM watches JOIN runs ON runs.id = run_id WHERE {pattern_condition(connection, "robot")}
        ORDER BY watches.started_s, watches.id
    """
    merged: dict[str, _Spans] = {}
    for _, name, begin_s, end_s in select(connection, "watches", (int, str, float, float), query, {"robot": robot}):
        spans = merged.setdefault(name, [])
        if spans and begin_s <= spans[-1][1]:
            begin_s, earlier_end_s = spans.pop()
            end_s = max(end_s, earlier_end_s)
        spans.append((begin_s, max(begin_s, end_s)))
    return merged
