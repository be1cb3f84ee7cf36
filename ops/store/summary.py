"""Share of time per level, availability, alerts, outages and the course of the level of each signal.

A level is known while a monitor watched the robot and the robot's link was up. Everything else is unknown: before the
first run, gaps between runs, and link downtime (except for the signal `link` itself). OK lasts as long as the
transition that ends it says, or the saved state while it lasts: the rest, such as the time before the first sample, is
unknown too.
"""

from __future__ import annotations

import json
import math
import sqlite3
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

from ...core.config.signal_config import LINK, template_name
from ...core.judge.saved_state import Saved
from ...core.judge.sources import is_source
from ...core.values.model import Level
from ...core.values.patterns import matches_pattern
from .queries import pattern_condition
from .rows import checked, is_count, is_level, is_number, is_text, is_time

MOST_LEVELS = 5_000
"""Most changes in the course of a level; after them it is unknown."""

_PAGE = 5_000
_ROUNDING_S = 1e-6
_CHECKS = (is_count, is_time, is_text, is_text, is_level, is_level, is_number, is_count, is_text)


@dataclass(frozen=True)
class SignalSummary:
    """The past of one signal."""

    robot: str
    signal: str
    duration_s: float
    """Length of the time that is summarized, in s; the shares refer to it."""
    shares: Mapping[Level, float]
    """Share of time per announced level, 0 to 1; levels that did not occur are missing."""
    unknown: float
    """Share of time in which the level is not known, 0 to 1."""
    alerts: int
    """Alerts that began in this time; one that changes its level is one."""
    longest_outage_s: float
    """Longest time in which the level was not OK, in s. Unknown time neither ends an outage nor counts."""
    mean_time_to_recover_s: Optional[float]
    """Mean length of the outages that began and ended in this time, in s; as before, unknown time does not count.
    None: there was none."""
    levels: Sequence[Tuple[float, Optional[Level]]]
    """The course of the level: begin of each, in s since 1970; None: unknown."""
    cause: str = ""
    """Name of the latest alert of which it was an effect, if it had none of its own; empty: none."""

    @property
    def availability(self) -> Optional[float]:
        """Share of OK of the known time, 0 to 1; None: nothing is known."""
        known = sum(self.shares.values())
        return self.shares.get(Level.OK, 0.0) / known if known > 0.0 else None


def summarize(
    connection: sqlite3.Connection,
    now_s: float,
    *,
    since_s: Optional[float] = None,
    robot: Optional[str] = None,
    signal: Optional[str] = None,
) -> List[SignalSummary]:
    """Returns a summary per robot and signal, and per topic that was silent, sorted by their names.

    It reaches from `since_s` (None: when the robot was first watched) to `now_s`, in s since 1970. In `robot` and
    `signal`, `*` and `?` work as in file names.
    """
    robots = {
        name: _Robot(spans, max(spans[0][0], since_s or 0.0), now_s)
        for name, spans in _watched(connection, robot).items()
    }
    lasting_s: Dict[Tuple[str, str], float] = {}
    for name, signal_name, state in connection.execute("SELECT robot, signal, state FROM signal_states"):
        if name in robots and is_text(signal_name):
            robots[name].signals[signal_name] = _Signal(robots[name].begin_s)
            lasting_s[name, signal_name] = _known_s(state, now_s)
    for wall_s, name, signal_name, from_level, to_level, lasted_s, repeated, affected in _transitions(
        connection, robot
    ):
        if name in robots and not repeated:
            robots[name].apply(wall_s, signal_name, Level(from_level), Level(to_level), lasted_s)
            robots[name].causes.update(dict.fromkeys(affected.split("\n"), signal_name))
    return [
        summary
        for name in sorted(robots)
        for summary in robots[name].summaries(name, lasting_s)
        if signal is None or matches_pattern(summary.signal, signal)
    ]


@dataclass
class _Signal:
    """One signal, while its transitions are read in their order."""

    advanced_to_s: float
    level: Level = Level.OK
    ok_s: float = 0.0
    """How long the present OK has lasted, if it was known all the time."""
    times: Dict[Level, float] = field(default_factory=dict)
    alerts: int = 0
    outage_s: float = 0.0
    longest_outage_s: float = 0.0
    began_in_time: bool = False
    """Whether the present outage began in the time that is summarized."""
    recoveries: int = 0
    recovery_s: float = 0.0
    """Sum of the outages that began and ended in the time."""
    has_transition: bool = False
    levels: List[Tuple[float, Optional[Level]]] = field(default_factory=list)
    ok_place: int = 0
    """Index in `levels` at which the present OK began."""

    def add(self, seconds: float) -> None:
        if self.level is Level.OK:
            self.ok_s += seconds
        else:
            self.times[self.level] = self.times.get(self.level, 0.0) + seconds
            self.outage_s += seconds
            self.longest_outage_s = max(self.longest_outage_s, self.outage_s)

    def end_ok(self, known_s: float) -> float:
        """Adds the present OK, of which at most `known_s` seconds were known; returns how much was not, in s."""
        known_s = min(self.ok_s, max(known_s, 0.0))
        unknown_s = self.ok_s - known_s
        self.times[Level.OK] = self.times.get(Level.OK, 0.0) + known_s
        self.ok_s = 0.0
        return unknown_s

    def set_level(self, level: Level, is_in_time: bool) -> None:
        if level is Level.OK:
            if self.began_in_time and is_in_time:
                self.recoveries += 1
                self.recovery_s += self.outage_s
            self.outage_s = 0.0
            self.ok_place = len(self.levels)
        elif self.level is Level.OK:
            self.began_in_time = is_in_time
        self.level = level

    def note_level(self, wall_s: float, level: Optional[Level]) -> None:
        """Adds a begin to the course of the level."""
        if not self.levels or self.levels[-1][1] is not level:
            if len(self.levels) == MOST_LEVELS:
                level = None
            if len(self.levels) <= MOST_LEVELS:
                self.levels.append((wall_s, level))


class _Robot:
    """The signals of one robot."""

    def __init__(self, spans: List[Tuple[float, float]], begin_s: float, end_s: float) -> None:
        self._spans = _Spans(spans)
        self.begin_s = begin_s
        self._end_s = end_s
        self._is_link_down = False
        self.signals: Dict[str, _Signal] = {}
        self.causes: Dict[str, str] = {}
        """The alert of which each signal was an effect at last, by their names."""

    def apply(self, wall_s: float, name: str, from_level: Level, to_level: Level, lasted_s: float) -> None:
        """Applies a transition; `from_level` was announced and known for `lasted_s`."""
        signal = self.signals.setdefault(name, _Signal(self.begin_s))
        if not signal.has_transition:
            signal.has_transition = True
            signal.level = from_level
        for advanced in self.signals if name == LINK else (name,):
            self._advance(advanced, wall_s)
        if name == LINK:
            self._is_link_down = to_level is not Level.OK
        if from_level is Level.OK:
            self._end_ok(signal, lasted_s)
        is_in_time = self.begin_s <= wall_s <= self._end_s
        signal.set_level(to_level, is_in_time)
        if is_in_time and from_level is Level.OK:
            signal.alerts += 1

    def summaries(self, robot: str, lasting_s: Mapping[Tuple[str, str], float]) -> Iterator[SignalSummary]:
        """Yields the summary of each signal.

        `lasting_s`: for how long the present level has been known, in s, by robot and signal; others: always.
        """
        duration_s = self._end_s - self.begin_s
        if duration_s <= 0.0:
            return
        for name in sorted(self.signals):
            self._advance(name, self._end_s)
            signal = self.signals[name]
            # An element without a state has ended (forget_after_s): what came after is not known.
            has_ended = name != template_name(name) and (robot, name) not in lasting_s
            self._end_ok(signal, 0.0 if has_ended else lasting_s.get((robot, name), math.inf))
            shares = {level: seconds / duration_s for level, seconds in sorted(signal.times.items()) if seconds > 0.0}
            if is_source(name) and shares.keys() <= {Level.OK}:
                continue  # topics are shown while they are silent
            unknown = max(0.0, 1.0 - sum(shares.values()))
            yield SignalSummary(
                robot, name, duration_s, shares, unknown if unknown > 1e-9 else 0.0, signal.alerts,
                signal.longest_outage_s, signal.recovery_s / signal.recoveries if signal.recoveries else None,
                self._spans.cut(signal.levels, self._end_s),
                self.causes.get(name, "") if shares.keys() <= {Level.OK} else "",
            )  # fmt: skip

    def _end_ok(self, signal: _Signal, known_s: float) -> None:
        """Ends an OK of which the last `known_s` seconds were known; takes the rest out of the course."""
        unknown_s = signal.end_ok(known_s)
        for place in range(signal.ok_place, len(signal.levels)):
            begin_s, level = signal.levels[place]
            if unknown_s <= _ROUNDING_S:
                break
            if level is not Level.OK:
                continue
            is_last = place + 1 == len(signal.levels)
            end_s = signal.advanced_to_s if is_last else signal.levels[place + 1][0]
            known_from_s = self._spans.after_s(begin_s, unknown_s)
            signal.levels[place] = (begin_s, None)
            if known_from_s < end_s:
                signal.levels.insert(place + 1, (known_from_s, Level.OK))
                break
            unknown_s -= self._spans.overlap_s(begin_s, end_s)

    def _advance(self, name: str, until_s: float) -> None:
        """Adds the time since the last call to the signal's level, as far as it is known."""
        signal = self.signals[name]
        until_s = min(until_s, self._end_s)
        if until_s <= signal.advanced_to_s:
            return  # the wall clock was set back
        is_known = name == LINK or not self._is_link_down
        if is_known:
            signal.add(self._spans.overlap_s(signal.advanced_to_s, until_s))
        signal.note_level(signal.advanced_to_s, signal.level if is_known else None)
        signal.advanced_to_s = until_s


class _Spans:
    """Times that are sorted and do not overlap."""

    def __init__(self, spans: Sequence[Tuple[float, float]]) -> None:
        self._begins_s = [begin_s for begin_s, _ in spans]
        self._lengths_s = [end_s - begin_s for begin_s, end_s in spans]
        self._sums_s = [0.0, *accumulate(self._lengths_s)]

    def overlap_s(self, from_s: float, to_s: float) -> float:
        """Returns how much of a time lies in the spans."""
        return self._before_s(to_s) - self._before_s(from_s)

    def after_s(self, from_s: float, seconds: float) -> float:
        """Returns the time until which so many seconds lie in the spans, counted from `from_s`."""
        wanted_s = self._before_s(from_s) + seconds
        number = max(bisect_right(self._sums_s, wanted_s) - 1, 0)
        if number >= len(self._begins_s):
            return math.inf
        return max(from_s, self._begins_s[number] + wanted_s - self._sums_s[number])

    def cut(self, levels: Sequence[Tuple[float, Optional[Level]]], end_s: float) -> List[Tuple[float, Optional[Level]]]:
        """Returns the course of a level until `end_s`, unknown outside of the spans."""
        found: List[Tuple[float, Optional[Level]]] = []
        for (begin_s, level), (until_s, _) in zip(levels, [*levels[1:], (end_s, None)]):
            first = max(bisect_right(self._begins_s, begin_s) - 1, 0)
            pieces: List[Tuple[float, Optional[Level]]] = [(begin_s, None)]
            if level is not None:
                for place in range(first, bisect_left(self._begins_s, until_s)):
                    from_s, to_s = self._begins_s[place], self._begins_s[place] + self._lengths_s[place]
                    if to_s > begin_s:
                        pieces += [(max(from_s, begin_s), level), (to_s, None)]
            for at_s, piece in pieces:
                if at_s < until_s and found and found[-1][0] >= at_s:
                    found.pop()
                if at_s < until_s and (not found or found[-1][1] is not piece):
                    found.append((at_s, piece))
        return found

    def _before_s(self, time_s: float) -> float:
        number = bisect_right(self._begins_s, time_s) - 1
        if number < 0:
            return 0.0
        return self._sums_s[number] + min(time_s - self._begins_s[number], self._lengths_s[number])


def _known_s(state: object, now_s: float) -> float:
    """Returns how long the announced level in a saved state has been known, in s; infinity if it does not say."""
    try:
        saved = Saved(json.loads(state))  # type: ignore[arg-type]
        if saved.section("announced").flag("never_known"):
            return 0.0
        since = saved.section("since")
        announced, unknown = since.number("announced"), since.number("unknown")
    except (TypeError, ValueError, RecursionError):  # also UnusableStateError
        return math.inf
    return math.inf if announced is None else max(0.0, (now_s if unknown is None else unknown) - announced)


def _watched(connection: sqlite3.Connection, robot: Optional[str]) -> Dict[str, List[Tuple[float, float]]]:
    """Returns the times in which each robot was watched, merged and sorted."""
    condition, values = pattern_condition(connection, "robot", robot)
    query = f"""
        SELECT watches.id, robot, watches.started_s, coalesce(watches.stopped_s, runs.stopped_s, runs.alive_s)
        FROM watches JOIN runs ON runs.id = run_id WHERE {condition} ORDER BY watches.started_s, watches.id
    """
    merged: Dict[str, List[Tuple[float, float]]] = {}
    rows = connection.execute(query, values).fetchall()
    for _, name, begin_s, end_s in checked(connection, "watches", rows, (is_count, is_text, is_time, is_time)):
        spans = merged.setdefault(name, [])
        if spans and begin_s <= spans[-1][1]:
            begin_s, earlier_end_s = spans.pop()
            end_s = max(end_s, earlier_end_s)
        spans.append((begin_s, max(begin_s, end_s)))
    return merged


def _transitions(connection: sqlite3.Connection, robot: Optional[str]) -> Iterator[Tuple[Any, ...]]:
    """Yields wall time, robot, signal, levels, duration of the earlier level, whether it is a repetition, effects."""
    condition, values = pattern_condition(connection, "robot", robot)
    query = f"""
        SELECT id, wall_s, robot, signal, from_level, to_level, now_s - since_s, repeated, affected FROM transitions
        WHERE id > ? AND {condition} ORDER BY id LIMIT {_PAGE}
    """
    number = 0
    while True:
        rows = connection.execute(query, [number, *values]).fetchall()
        for row in checked(connection, "transitions", rows, _CHECKS):
            yield row[1:]
        if len(rows) < _PAGE:
            return
        number = rows[-1][0]
