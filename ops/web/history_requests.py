"""Past alerts, notes and silences as JSON values: what requests ask for, and what they get. Functions may block."""

from __future__ import annotations

import sqlite3
from datetime import datetime, timezone
from itertools import islice
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple, TypeVar

from robot_health_monitor.core.errors import ConfigError, ServiceError
from robot_health_monitor.core.kept_settings import read_kept, settings_of
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.signal_config import template_name
from robot_health_monitor.runtime.times import iso_time

from ..active_silences import Silences
from ..history import queries, samples
from ..history.history import History
from ..history.notes import MOST_TEXT, Note, add_note, notes_of
from ..history.rows import StoredTransition
from ..history.samples import StoredSamples, samples_fields
from ..matchers import Matcher, matchers_text
from ..silences import Silence, read_silences
from .requests import LARGEST_ID, ApiError, json_bytes, read_id, read_text

_MOST = 1000
_USUAL = 100
_MOST_SAMPLES = 20_000
_MOST_OTHERS = 50
_CELLS = 96
"""Cells of 15 minutes: 24 hours."""

Result = TypeVar("Result")
Json = Dict[str, Any]


class PastAlert(NamedTuple):
    """One alert, and what else was known at that moment."""

    alert: Json
    samples: List[Tuple[float, Optional[float]]]
    """Of its window: time in s since 1970 and value, None if that is not finite."""
    trend_per_min: Optional[float]
    """That of its forecast."""
    others: List[Json]
    """The alerts of the robot's other signals that were open."""
    silences: List[Json]
    """Silences of the alert that were in force."""
    thresholds: Json
    """The settings of its signal that differed from the defaults."""


class Query(NamedTuple):
    """Which alerts to return; as for `queries.transitions`."""

    robot: Optional[str]
    signal: Optional[str]
    level: Optional[Level]
    since_s: Optional[float]
    before_id: Optional[int]
    limit: int
    open_only: bool


def query_of(parameters: Mapping[str, str]) -> Query:
    """Reads the parameters of a request; raises ApiError if one is invalid."""
    level = parameters.get("level") or None
    if level is not None and level not in Level.__members__:
        raise ApiError(400, f"level: expected {', '.join(Level.__members__)}, got {level[:20]}")
    before = _number(parameters, "before", LARGEST_ID)
    limit = _number(parameters, "limit", _MOST)
    return Query(
        parameters.get("robot") or None,
        parameters.get("signal") or None,
        None if level is None else Level[level],
        _time(parameters, "since"),
        before,
        _USUAL if limit is None else limit,
        parameters.get("open", "0") == "1",
    )


def past_alerts(history: History, query: Query) -> Json:
    """Returns the answer of `/api/history`; raises ServiceError if the history failed or did not answer."""

    def read(connection: sqlite3.Connection) -> Json:
        one_more = query._replace(limit=query.limit + 1)
        found = list(queries.transitions(connection, **one_more._asdict(), newest_first=True))
        gaps = queries.gaps(connection, query.since_s or 0.0)[-_MOST:]
        return {
            "alerts": [_alert(connection, transition) for transition in found[: query.limit]],
            "more": len(found) > query.limit,
            "gaps": [{"from": iso_time(gap.from_s), "to": iso_time(gap.to_s)} for gap in gaps],
        }

    return _read(history, read)


def past_alert(history: History, number: int) -> Optional[PastAlert]:
    """Returns an alert by its id, None if there is none; raises ServiceError as `past_alerts`."""

    def read(connection: sqlite3.Connection) -> Optional[PastAlert]:
        transition = queries.transition(connection, number)
        if transition is None:
            return None
        samples = queries.evidence(connection, number)
        shown = [(round(t, 3), value if value - value == 0.0 else None) for t, value in samples]
        others = queries.not_ok_at(connection, transition, _MOST_OTHERS)
        return PastAlert(
            _alert(connection, transition),
            shown,
            transition.statistics.get("trend_per_min"),
            [_alert(connection, other) for other in others],
            _silences_at(connection, transition, history.wall_s()),
            _thresholds_at(connection, transition),
        )

    return _read(history, read)


def _silences_at(connection: sqlite3.Connection, alert: StoredTransition, now_s: float) -> List[Json]:
    return [
        silence_json(silence)
        for silence in read_silences(connection)
        if silence.created_s <= alert.wall_s < silence.end_s(now_s) and silence.matches(alert.robot, alert.signal)
    ]


def _thresholds_at(connection: sqlite3.Connection, alert: StoredTransition) -> Json:
    kept = queries.configuration(connection, alert.robot, alert.wall_s) or {}
    name = alert.signal if alert.signal in kept else template_name(alert.signal)
    try:
        return settings_of(read_kept({name: kept.get(name, {})})[name])
    except ConfigError:  # of another version, or changed by another program
        return {}


def past_samples(history: History, parameters: Mapping[str, str]) -> bytes:
    """Returns the answer of `/api/history/samples`; raises ApiError for an invalid parameter, else as `past_alerts`."""
    found, is_more = _stored_samples(history, parameters)
    # One by one: encoding all at once would hold the interpreter's lock, for which the monitor waits.
    body = b",".join([json_bytes(samples_fields(each)) for each in found])
    return b'{"samples":[' + body + b'],"more":' + json_bytes(is_more) + b"}"


def _stored_samples(history: History, parameters: Mapping[str, str]) -> Tuple[List[StoredSamples], bool]:
    """Returns the samples that a request asks for, and whether there are more."""
    robot, signal = parameters.get("robot", ""), parameters.get("signal", "")
    if not robot or not signal:
        raise ApiError(400, "robot and signal: expected a name each")
    since_s, until_s = _time(parameters, "from"), _time(parameters, "to")
    seconds = _number(parameters, "seconds", 86_400)

    def read(connection: sqlite3.Connection) -> Tuple[List[StoredSamples], bool]:
        if seconds is not None:
            end_s = history.wall_s() if until_s is None else until_s
            begin_s = end_s - seconds * samples.MOST_COARSE if since_s is None else since_s
            coarse = samples.read_coarse(connection, robot, signal, begin_s, end_s, float(seconds))
            return coarse, len(coarse) >= samples.MOST_COARSE
        found = samples.read(connection, robot=robot, signal=signal, since_s=since_s, until_s=until_s)
        some = [*islice(found, _MOST_SAMPLES + 1)]
        return some[:_MOST_SAMPLES], len(some) > _MOST_SAMPLES

    return _read(history, read)


def past_levels(history: History) -> bytes:
    """Returns the answer of `/api/history/levels`; raises as `past_alerts`."""
    wall_s = history.wall_s()
    begin_s = (wall_s // samples.CELL_S - _CELLS + 1) * samples.CELL_S
    cells: Dict[str, List[str]] = {}

    def read(connection: sqlite3.Connection) -> None:
        for robot, start_s, level in samples.read_levels(connection, begin_s):
            number = int((start_s - begin_s) / samples.CELL_S)
            if number < _CELLS:
                cells.setdefault(robot, ["-"] * _CELLS)[number] = level.name[0]

    _read(history, read)
    robots = {robot: "".join(found) for robot, found in cells.items()}
    return json_bytes({"from": iso_time(begin_s), "seconds": samples.CELL_S, "robots": robots})


def _read(history: History, function: Callable[[sqlite3.Connection], Result]) -> Result:
    try:
        return history.read(function)
    except ConfigError as error:  # the file was replaced or damaged: not the fault of the request
        raise ServiceError(error.problem) from None


def _alert(connection: sqlite3.Connection, transition: StoredTransition) -> Json:
    return {
        "id": transition.id,
        "time": iso_time(transition.wall_s),
        "robot": transition.robot,
        "signal": transition.signal,
        "from_level": transition.from_level.name,
        "to_level": transition.to_level.name,
        "value": transition.value,
        "statistic": transition.statistic,
        "bound": transition.bound,
        "since": iso_time(transition.wall_s - (transition.now_s - transition.since_s)),
        "text": transition.text,
        "hint": transition.hint,
        "black_box": transition.black_box,
        "repeat": transition.repeat,
        "notes": [_note_json(note) for note in notes_of(connection, transition.id)],
    }


def _note_json(note: Note) -> Json:
    return {"time": iso_time(note.wall_s), "author": note.author, "text": note.text}


def _time(parameters: Mapping[str, str], name: str) -> Optional[float]:
    text = parameters.get(name, "")
    if not text:
        return None
    try:
        time = datetime.fromisoformat(text.replace("Z", "+00:00"))
        return (time if time.tzinfo else time.replace(tzinfo=timezone.utc)).timestamp()
    except (ValueError, OverflowError):
        raise ApiError(400, f"{name}: expected a time such as 2026-11-22T05:00:00Z, got {text[:40]}") from None


def _number(parameters: Mapping[str, str], name: str, most: int) -> Optional[int]:
    text = parameters.get(name, "")
    if not text:
        return None
    if not (text.isascii() and text.isdigit()) or len(text) > 19 or not 1 <= int(text) <= most:
        raise ApiError(400, f"{name}: expected a whole number from 1 to {most}, got {text[:20]}")
    return int(text)


def new_note(history: History, body: Mapping[str, Any]) -> Json:
    """Adds the note that a request asks for, and returns it; raises ApiError if a value is missing or invalid."""
    number, text, author = read_id(body, "an alert"), read_text(body, "text", MOST_TEXT), read_text(body, "author")
    wall_s = history.wall_s()

    def add(connection: sqlite3.Connection) -> Note:
        if queries.transition(connection, number) is None:
            raise ApiError(404, f"there is no alert {number}")
        return add_note(connection, number, text, author, wall_s)

    return _note_json(history.run(add))


def silence_json(silence: Silence) -> Json:
    """Returns a silence as docs/reference/api.md describes it."""
    return {
        "id": str(silence.id),
        "matchers": matchers_text(silence.matchers),
        "reason": silence.reason,
        "author": silence.author,
        "since": iso_time(silence.created_s),
        "until": None if silence.until_s is None else iso_time(silence.until_s),
        "until_resolved": silence.until_resolved,
    }


def new_silence(silences: Silences, body: Mapping[str, Any]) -> Silence:
    """Adds the silence that a request asks for, as `Silences.add`; raises ApiError if a value is missing or invalid."""
    robot, signal = read_text(body, "robot"), read_text(body, "signal")
    if not robot:
        raise ApiError(400, "robot: expected a name or a pattern, got nothing")
    matchers = [Matcher("robot", True, robot)] + ([Matcher("signal", True, signal)] if signal else [])
    for_s = body.get("for_s")
    if for_s is not None:
        if isinstance(for_s, bool) or not isinstance(for_s, (int, float)):
            raise ApiError(400, "for_s: expected a number of seconds")
        if not 0 < for_s < 1e9:
            raise ApiError(400, "for_s: expected seconds above 0, at most a year")
        for_s = float(for_s)
    return silences.add(
        matchers,
        for_s=for_s,
        until_resolved=body.get("until_resolved") is True,
        reason=read_text(body, "reason"),
        author=read_text(body, "author"),
    )


def expire_silence(silences: Silences, body: Mapping[str, Any]) -> Silence:
    """Ends the silence that a request names; raises ApiError if it names none, or one that has ended."""
    number = read_id(body, "a silence")
    reason, author = read_text(body, "reason"), read_text(body, "author")
    if not (reason + author).isprintable():
        raise ApiError(400, "expected a reason and an author of one line each")
    try:
        return silences.expire(number, reason=reason, author=author)
    except ConfigError as error:
        raise ApiError(404, error.problem) from None
