"""Past alerts, notes and silences as JSON values: what requests ask for, and what they get. Functions may block."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import islice
from sqlite3 import Connection
from typing import Any, Dict, List, Optional, Sequence, Union

from ...core.config import REQUIRED, Time, declared, read_kept, settings_of, template_name
from ...core.values import ConfigError, Level
from ...runtime.http_answers import ApiError
from ...runtime.times import iso_time
from ..store import queries, samples
from ..store.active_silences import Silences
from ..store.history import History
from ..store.matchers import Matcher
from ..store.notes import MOST_TEXT, Note, add_note, notes_of
from ..store.rows import StoredTransition
from ..store.samples import StoredSamples, samples_fields
from ..store.silences import LONGEST_S, read_silences, silence_json

LARGEST_ID = 2**63 - 1
_MOST = 1000
_MOST_SAMPLES = 20_000
_MOST_OTHERS = 50
ALERT_FIELDS = (
    "id", "time", "robot", "signal", "from_level", "to_level", "value", "statistic", "bound", "since", "text", "hint",
    "black_box", "alert_id", "cause", "effects", "repeat", "notes",
)  # fmt: skip
"""The keys of an alert; but for a few, which are converted, the fields of `StoredTransition` of the same name."""
_CELLS = 96
"""Cells of 15 minutes: 24 hours."""

Json = Dict[str, Any]


@dataclass(frozen=True)
class Query:
    """Which alerts a request asks for."""

    robot: Optional[str] = declared(None, any_text=True)
    signal: Optional[str] = declared(None, any_text=True)
    level: Optional[Level] = declared(None)
    since: Optional[Time] = declared(None)
    before: Optional[int] = declared(None, "", 1, LARGEST_ID)
    limit: int = declared(100, "", 1, _MOST)
    open: bool = declared(False)


@dataclass(frozen=True)
class SamplesQuery:
    """Which samples a request asks for."""

    robot: str = declared(REQUIRED, "", 1, any_text=True)
    signal: str = declared(REQUIRED, "", 1, any_text=True)
    from_: Optional[Time] = declared(None)
    to: Optional[Time] = declared(None)
    seconds: Optional[int] = declared(None, "", 1, 86_400)


@dataclass(frozen=True)
class AlertQuery:
    """Which alert a request asks for."""

    id: int = declared(REQUIRED, "", 1, LARGEST_ID)


@dataclass(frozen=True)
class LevelsQuery:
    """A request for the levels of all robots has no parameters."""


def _line(default: Any = "", least: Optional[int] = None) -> Any:
    return declared(default, "", least, 200, any_text=True)


@dataclass(frozen=True)
class NewNote:
    """The body of a request for a note."""

    id: Union[str, int] = declared(REQUIRED)
    text: str = declared("", "", None, MOST_TEXT, any_text=True)
    author: str = _line()


@dataclass(frozen=True)
class NewSilence:
    """The body of a request for a silence."""

    robot: str = _line(REQUIRED, 1)
    signal: str = _line()
    for_s: Optional[float] = declared(None, "", 0.001, LONGEST_S)
    until_resolved: bool = declared(False)
    reason: str = _line()
    author: str = _line()


@dataclass(frozen=True)
class Reset:
    """The body of a request that resets a robot."""

    robot: str = declared("", any_text=True)


@dataclass(frozen=True)
class EndOfSilence:
    """The body of a request that ends a silence."""

    id: Union[str, int] = declared(REQUIRED)
    reason: str = declared("", "", None, 200)
    author: str = declared("", "", None, 200)


def past_alerts(connection: Connection, wall_s: float, query: Query) -> Json:
    """Returns the answer of `/api/history`."""
    since_s = _seconds(query.since)
    transitions = queries.transitions(
        connection,
        robot=query.robot,
        signal=query.signal,
        level=query.level,
        since_s=since_s,
        before_id=query.before,
        newest=query.limit + 1,
        open_only=query.open,
    )
    alerts = [_alert(connection, transition) for transition in transitions]
    gaps = queries.gaps(connection, since_s or 0.0)[-_MOST:]
    return {
        "alerts": alerts[: query.limit],
        "more": len(alerts) > query.limit,
        "gaps": [{"from": iso_time(from_s), "to": iso_time(to_s)} for from_s, to_s in gaps],
    }


def past_alert(connection: Connection, wall_s: float, query: AlertQuery) -> Json:
    """Returns the answer of `/api/history/ID`, but for what its signal's configuration has; raises ApiError."""
    transition = _transition(connection, query.id)
    samples = queries.evidence(connection, query.id)
    begun = queries.transition(connection, transition.alert_id) or transition
    return {
        "alert": {**_alert(connection, transition), "effects": begun.effects},
        "samples": [(round(t, 3), value) for t, value in samples],
        "trend_per_min": transition.statistics.get("trend_per_min"),
        "others": [_alert(connection, each) for each in queries.not_ok_at(connection, transition, _MOST_OTHERS)],
        "silences": _silences_at(connection, transition, wall_s),
        "thresholds": _thresholds_at(connection, transition),
    }


def _transition(connection: Connection, number: int) -> StoredTransition:
    transition = queries.transition(connection, number)
    if transition is None:
        raise ApiError(404, f"there is no alert {number}; the history deletes old ones")
    return transition


def _silences_at(connection: Connection, alert: StoredTransition, now_s: float) -> List[Json]:
    """Returns the silences that were active at some time of an alert, its acknowledgement among them."""
    until_s = queries.ended_s(connection, alert) or math.inf
    return [
        silence_json(each, now_s)
        for each in read_silences(connection)
        if each.matches(alert.robot, alert.signal) and each.created_s < until_s and each.end_s(now_s) > alert.wall_s
    ]


def _thresholds_at(connection: Connection, alert: StoredTransition) -> Json:
    kept = queries.configuration(connection, alert.robot, alert.wall_s) or {}
    name = alert.signal if alert.signal in kept else template_name(alert.signal)
    try:
        return settings_of(read_kept({name: kept.get(name, {})})[name])
    except ConfigError:  # of another version, or changed by another program
        return {}


def past_samples(connection: Connection, wall_s: float, query: SamplesQuery) -> Json:
    """Returns the answer of `/api/history/samples`."""
    since_s, until_s, seconds = _seconds(query.from_), _seconds(query.to), query.seconds
    stored: Sequence[StoredSamples]
    if seconds is None:
        every = samples.read(connection, robot=query.robot, signal=query.signal, since_s=since_s, until_s=until_s)
        stored, most = [*islice(every, _MOST_SAMPLES + 1)], _MOST_SAMPLES + 1
    else:
        most = samples.MOST_COARSE
        end_s = wall_s if until_s is None else until_s
        begin_s = end_s - seconds * most if since_s is None else since_s
        stored = samples.read_coarse(connection, query.robot, query.signal, begin_s, end_s, float(seconds))
    return {"samples": [samples_fields(each) for each in stored[:_MOST_SAMPLES]], "more": len(stored) >= most}


def past_levels(connection: Connection, wall_s: float, query: LevelsQuery) -> Json:
    """Returns the answer of `/api/history/levels`."""
    begin_s = (wall_s // samples.CELL_S - _CELLS + 1) * samples.CELL_S
    cells: Dict[str, List[str]] = {}
    for robot, start_s, level in samples.read_levels(connection, begin_s):
        number = int((start_s - begin_s) / samples.CELL_S)
        if number < _CELLS:
            cells.setdefault(robot, ["-"] * _CELLS)[number] = level.name[0]
    robots = {robot: "".join(levels) for robot, levels in cells.items()}
    return {"from": iso_time(begin_s), "seconds": samples.CELL_S, "robots": robots}


def _alert(connection: Connection, transition: StoredTransition) -> Json:
    converted = {
        "time": iso_time(transition.wall_s),
        "from_level": transition.from_level.name,
        "to_level": transition.to_level.name,
        "since": iso_time(transition.wall_s - (transition.now_s - transition.since_s)),
        "cause": transition.cause or None,
        "notes": [_note_json(note) for note in notes_of(connection, transition.id)],
    }
    return {name: converted[name] if name in converted else getattr(transition, name) for name in ALERT_FIELDS}


def _note_json(note: Note) -> Json:
    return {"time": iso_time(note.wall_s), "author": note.author, "text": note.text}


def _seconds(time: Optional[Time]) -> Optional[float]:
    return None if time is None else time.timestamp()


def _id(given: Union[str, int], of: str) -> int:
    """Returns the number of what a request names; `of` says what is numbered."""
    try:
        return min(int(str(given)[:20]), LARGEST_ID)
    except ValueError:
        raise ApiError(400, f"id: expected the id of {of}") from None


def new_note(history: History, new: NewNote) -> Json:
    """Adds the note that a request asks for, and returns it; raises MessageError if a value is invalid."""
    number, wall_s = _id(new.id, "an alert"), history.wall_s()

    def add(connection: Connection) -> Note:
        _transition(connection, number)
        return add_note(connection, number, new.text, new.author, wall_s)

    return {"note": _note_json(history.run(add))}


def new_silence(history: History, silences: Silences, new: NewSilence) -> Json:
    """Adds the silence that a request asks for, and returns it; raises MessageError if a value is invalid."""
    matchers = [Matcher("robot", True, new.robot)] + ([Matcher("signal", True, new.signal)] if new.signal else [])
    silence = silences.add(
        matchers, for_s=new.for_s, until_resolved=new.until_resolved, reason=new.reason, author=new.author
    )
    return {"silence": silence_json(silence, history.wall_s())}


def expire_silence(silences: Silences, end: EndOfSilence) -> Json:
    """Ends the silence that a request names; raises MessageError if it names none, or one that has ended."""
    number = _id(end.id, "a silence")
    try:
        silences.expire(number, reason=end.reason, author=end.author)
    except ConfigError as error:
        raise ApiError(404, error.problem) from None
    return {"ok": True}
