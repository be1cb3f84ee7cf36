"""Silences: suppress notifications of some alerts, for a time or until they resolve.

They are stored in the history file. The functions here serve the running monitor (`active_silences`) and
`robot-health silence`, beside a running monitor or without one. Silences never affect judging, the log, /diagnostics or
the history.
"""

from __future__ import annotations

import re
from sqlite3 import Connection
from typing import (
    Any,
    Dict,
    FrozenSet,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

from ...core.values import ConfigError, duration_text, matches_pattern, printable
from ...runtime.times import iso_time, local_time
from .matchers import Matcher, matchers_text, parse_matchers
from .queries import number_range
from .recurrence import Recurrence, parse_recurrence
from .rows import records, select, skip

MOST_ACTIVE = 1000
"""Largest number of active silences."""
MOST_TEXT = 200
"""Longest reason and author, in characters."""
LONGEST_S = 366 * 86_400.0
"""Longest silence, in s."""

_MOST_KEPT = 10_000
_TOLERATED_S = 3600.0
"""How far in the future a silence may have been made, by a clock that was set back meanwhile, in s."""

_DURATION = re.compile(r"(?:(\d{1,6})w)?(?:(\d{1,6})d)?(?:(\d{1,6})h)?(?:(\d{1,8})m)?(?:(\d{1,9})s)?\Z", re.ASCII)
_UNITS_S = (604_800, 86_400, 3600, 60, 1)

Alert = Tuple[str, str]
"""An alert: the names of its robot and its signal."""


class Silence(NamedTuple):
    """One silence. The fields but `alerts` are the columns of the table `silences`; times are in s since 1970."""

    id: int
    matchers: str
    """An alert must fulfil all of them; see `parse_matchers`."""
    reason: str
    author: str
    created_s: float
    until_s: Optional[float] = None
    """When it expires; None if it has no time limit."""
    newest_alert: int = 0
    """For one that ends when the alerts that were open at its begin have resolved: the number of the newest one."""
    ended_s: Optional[float] = None
    """When it was ended, or its last alert resolved; None if that is still to come."""
    ended_by: str = ""
    """Who ended it; empty if it was not ended, or if this is unknown."""
    ended_reason: str = ""
    """Why it was ended."""
    every: str = ""
    """When it is in force, while it is active; empty if it is all the time."""
    timezone: str = ""
    """The time zone of `every`."""
    alerts: FrozenSet[Alert] = frozenset()
    """With `newest_alert`: those that are still open."""

    @property
    def until_resolved(self) -> bool:
        """Whether it ends when the alerts that were open at its begin have resolved."""
        return self.newest_alert > 0

    @property
    def rule(self) -> Recurrence | None:
        """When it is in force; None if it is all the time."""
        return parse_recurrence(self.every, self.timezone) if self.every else None

    def is_active(self, now_s: float) -> bool:
        """Returns whether it has neither ended nor expired; it need not be in force."""
        return self.ended_s is None and (self.until_s is None or now_s < self.until_s)

    def in_force(self, now_s: float) -> bool:
        """Returns whether it suppresses notifications at a time: not if it was made in the future, by a wrong clock."""
        is_in_future = self.until_s is not None and self.created_s > now_s + _TOLERATED_S
        return self.is_active(now_s) and not is_in_future and (self.rule is None or self.rule.contains(now_s))

    def end_s(self, now_s: float) -> float:
        """Returns when it ended or expired; `now_s` if it is active."""
        return min(end for end in (now_s, self.until_s, self.ended_s) if end is not None)

    def covers(self, robot: str, signal: str) -> bool:
        """Returns whether it applies to an alert."""
        return self.matches(robot, signal) and (not self.until_resolved or (robot, signal) in self.alerts)

    def matches(self, robot: str, signal: str) -> bool:
        """Returns whether an alert fulfils all matchers."""
        return self.allows("robot", robot) and self.allows("signal", signal)

    def allows(self, label: str, name: str) -> bool:
        """Returns whether the name of a robot or a signal fulfils the matchers of that label."""
        return all(matcher.matches(name) for matcher in parse_matchers(self.matchers) if matcher.label == label)

    @property
    def end_text(self) -> str:
        """When it ends: `until 2026-11-22 06:00 UTC or resolved`.

        One that recurs: `every mon-fri 22:00-06:00 (Europe/Berlin)`, and when it ends.
        """
        ends = [] if self.until_s is None else [time_text(self.until_s)]
        end = "until " + " or ".join([*ends, "resolved"] if self.until_resolved else ends)
        return end if self.rule is None else f"{self.rule}{f', {end}' if ends else ''}"

    @property
    def text(self) -> str:
        """The reason and the end, in one line: `fan is being replaced (until 2026-11-22 06:00 UTC)`."""
        return f"{self.reason} ({self.end_text})" if self.reason else self.end_text


def parse_duration_s(text: str) -> float:
    """Reads a duration: `30m`, `1h30m`, `7d`; the units are w, d, h, m and s.

    Raises:
        ConfigError: it is not of this form, is 0, or is longer than a year.
    """
    match = _DURATION.match(text) if text else None
    if match is None:
        raise ConfigError(f"expected a duration such as 30m, 1h30m or 7d, got {text[:60]!r}")
    seconds = float(sum(int(count) * unit_s for count, unit_s in zip(match.groups("0"), _UNITS_S)))
    _check_duration(seconds)
    return seconds


def _check_duration(seconds: float) -> None:
    if not 0.0 < seconds <= LONGEST_S:
        raise ConfigError(f"expected a duration above 0 and of at most 366 d, got {duration_text(seconds)}")


def time_text(wall_s: float) -> str:
    """Returns a time in the local time zone, with the zone's name."""
    return local_time(wall_s, "%Y-%m-%d %H:%M %Z")


_COLUMNS = Silence._fields[:-1]


def add_silence(
    connection: Connection,
    matchers: Sequence[Matcher],
    now_s: float,
    *,
    for_s: float | None = None,
    until_resolved: bool = False,
    every: Recurrence | None = None,
    reason: str = "",
    author: str = "",
) -> Silence:
    """Adds a silence of the alerts that fulfil all matchers. Call inside a transaction.

    Args:
        connection: the database.
        matchers: which alerts.
        now_s: in s since 1970.
        for_s: how long, in s; None if there is no time limit.
        until_resolved: only for the alerts that are open now, until they resolve. With `for_s`: whichever comes first.
        every: when it is in force each week; None if it is all the time.
        reason: why; as `author` one line of at most 200 characters.
        author: who.

    Raises:
        ConfigError: no end is given, no open alert matches, a text is too long or not printable, or there are too many
            silences.
    """
    if for_s is None and not until_resolved and every is None:
        raise ConfigError("expected a duration, or until resolved; got neither")
    if until_resolved and every is not None:
        raise ConfigError("expected a time that comes again, or until resolved; got both")
    if for_s is not None:
        _check_duration(for_s)
    _check_texts(reason, author)
    text = matchers_text(matchers)
    parse_matchers(text)  # there may be none, or they are not printable, or too long
    if len(read_silences(connection, active_at_s=now_s)) >= MOST_ACTIVE:
        raise ConfigError(f"there are {MOST_ACTIVE} active silences, the largest number; expire some first")
    until_s = None if for_s is None else now_s + for_s
    rule = ("", "") if every is None else (every.text, every.zone)
    silence = Silence(0, text, reason, author, now_s, until_s, 0, None, "", "", *rule)
    if until_resolved:
        matching = {alert: number for alert, number in open_alerts(connection).items() if silence.matches(*alert)}
        if not matching:
            raise ConfigError(f"no open alert matches {text}")
        silence = silence._replace(newest_alert=max(matching.values()), alerts=frozenset(matching))
    insert = f"INSERT INTO silences ({', '.join(_COLUMNS[1:])}) VALUES ({', '.join('?' * len(_COLUMNS[1:]))})"
    number = connection.execute(insert, silence[1:-1]).lastrowid or 0
    # Ended ones are kept for `list`, in a bounded number.
    ended = "id <= ? AND (ended_s IS NOT NULL OR until_s <= ?)"
    connection.execute(f"DELETE FROM silences WHERE {ended}", (number - _MOST_KEPT, now_s))
    return silence._replace(id=number)


def _check_texts(reason: str, author: str) -> None:
    for name, text in (("reason", reason), ("author", author)):
        if len(text) > MOST_TEXT or not text.isprintable():
            raise ConfigError(f"expected a {name} of one line, at most {MOST_TEXT} characters, got {ascii(text)[:60]}")


def expire_silence(connection: Connection, number: int, now_s: float, *, reason: str = "", author: str = "") -> Silence:
    """Ends a silence at a time in s since 1970, and returns it. Call inside a transaction.

    Raises:
        ConfigError: there is no such silence, it has ended, or the reason or the author is no line of 200 characters.
    """
    _check_texts(reason, author)
    silence = next((each for each in read_silences(connection) if each.id == number), None)
    if silence is None:
        raise ConfigError(f"there is no silence {number}")
    if not silence.is_active(now_s):
        raise ConfigError(f"silence {number} has ended already, at {time_text(silence.end_s(now_s))}")
    update = "UPDATE silences SET ended_s = ?, ended_by = ?, ended_reason = ? WHERE id = ?"
    connection.execute(update, (now_s, author, reason, number))
    return silence


def read_silences(connection: Connection, active_at_s: float | None = None) -> List[Silence]:
    """Returns the silences, oldest first: those that are active at a time in s since 1970, or all."""
    tail = "WHERE ? IS NULL OR (ended_s IS NULL AND (until_s IS NULL OR until_s > ?)) ORDER BY id"
    rows = records(connection, "silences", Silence, tail, (active_at_s, active_at_s), ", ".join(_COLUMNS))
    opened = open_alerts(connection) if any(row.newest_alert for row in rows) else {}
    silences = []
    for row in rows:
        try:
            parse_matchers(row.matchers)
            row.rule  # noqa: B018 - it may not be one
        except ConfigError:  # of a newer version, or edited by hand
            skip(connection, "silences", row.id)
        else:
            shown = [printable(value) if isinstance(value, str) else value for value in row[:-1]]
            covered = [alert for alert, number in opened.items() if number <= row.newest_alert and row.matches(*alert)]
            silences.append(Silence._make([*shown, frozenset(covered)]))
    return silences


def open_alerts(connection: Connection) -> Dict[Alert, int]:
    """Returns the alerts that are open, with the numbers of the transitions that began them."""
    rows = select(connection, "open_alerts", (str, str, int), "SELECT robot, signal, alert_id FROM open_alerts")
    return {(robot, signal): number for robot, signal, number in rows}


class SilenceEvent(NamedTuple):
    """A silence began, or no longer applies."""

    wall_s: float
    """When, in s since 1970."""
    kind: str
    """`added`, `ended` (by someone, or for a reason) or `expired`."""
    silence: Silence


def silence_events(
    connection: Connection,
    now_s: float,
    since_s: float = 0.0,
    robot: str | None = None,
    signal: str | None = None,
) -> List[SilenceEvent]:
    """Returns begins and ends of the silences that are stored, by time, not older than `since_s`.

    `robot` and `signal`: of silences that apply to these only; `*` and `?` work as in file names.
    """
    asked = {"robot": robot, "signal": signal}
    names = {label: _names(connection, label, given) for label, given in asked.items() if given is not None}
    events = []
    for silence in read_silences(connection):
        if all(any(silence.allows(label, name) for name in names[label]) for label in names):
            events.append(SilenceEvent(silence.created_s, "added", silence))
            if not silence.is_active(now_s):
                kind = "expired" if silence.ended_s is None else "ended"
                events.append(SilenceEvent(silence.end_s(now_s), kind, silence))
    return sorted((event for event in events if event.wall_s >= since_s), key=lambda event: event.wall_s)


def _names(connection: Connection, label: str, given: str) -> List[str]:
    """Returns the names of robots or signals that a filter means: itself, and those that are known and match."""
    known = select(connection, "signal_states", (str,), f"SELECT DISTINCT {label} FROM signal_states")
    return [given, *(name for (name,) in known if matches_pattern(name, given))]


def silenced_transitions(connection: Connection, silence: Silence, now_s: float) -> int:
    """Returns how many alerts a silence has applied to so far, by changes of their level since it began."""
    query = """
        SELECT robot, signal, count(DISTINCT coalesce(alert_id, id)) FROM transitions WHERE id BETWEEN ?1 AND ?2
            AND +wall_s >= ?3 AND +wall_s < ?4 AND to_level <> 0 AND NOT repeat AND in_force(wall_s)
            AND (?5 = 0 OR coalesce(alert_id, id) <= ?5)
        GROUP BY robot, signal
    """
    every, begin_s = silence.rule, silence.created_s
    connection.create_function("in_force", 1, lambda wall_s: every is None or every.contains(wall_s))
    values = (*number_range(connection, begin_s), begin_s, silence.end_s(now_s), silence.newest_alert)
    counts = select(connection, "transitions", (str, str, int), query, values)
    return sum(count for robot, signal, count in counts if silence.matches(robot, signal))


def silence_json(silence: Silence, now_s: float) -> Dict[str, Any]:
    """Returns a silence as docs/reference/api.md describes it, at a time in s since 1970."""
    return {
        "id": str(silence.id),
        "matchers": silence.matchers,
        "reason": silence.reason,
        "author": silence.author,
        "since": iso_time(silence.created_s),
        "until": None if silence.until_s is None else iso_time(silence.until_s),
        "until_resolved": silence.until_resolved,
        "every": silence.every or None,
        "timezone": silence.timezone or None,
        "in_force": silence.in_force(now_s),
    }
