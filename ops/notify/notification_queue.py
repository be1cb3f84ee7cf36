"""The queue of notifications, in the history's database: written with the transition, read by one thread per target.

These rules keep it correct across restarts, silences and outages of any length:

* The transaction that stores a transition also stores a row for each target that may have to be sent it.
* `notified` is what a target was last sent about an alert that is open there. What a row means for a target is decided
  only when it is its turn: compared with `notified`, the silences and the target's `min_level`.
* The rows of one alert are sent in their order. A row that failed waits behind the other alerts.
* A target with `after_s` is queued an alert only once that was open for so long without its silences (`prepare`).
  With `group_wait_s`, the rows of one robot become one message when its first one has waited so long (`_take_group`);
  of each alert its latest level is sent. Both waits are wall time, so that they go on after a restart.
* Sources (a robot and a configured signal) take turns: one that has a thousand rows does not delay the others.
* A row with an attempt may have arrived. It is sent until that succeeds or is refused; only a silence drops it. Then
  the target may know of the alert (`_UNCONFIRMED`): it is sent the end, or the alert again after the silence.
* Of more than `MOST_WAITING` rows, those go that a later one of the same alert supersedes, and the ends of alerts that
  were never sent. What is left is bounded by the number of open alerts.
* A row with unexpected values, which another program has written, is deleted where it is read.

All functions run in the history's writer thread, inside its transactions.
"""

from __future__ import annotations

import json
import time
from collections import Counter
from sqlite3 import Connection
from typing import (
    Any,
    Callable,
    Collection,
    Iterator,
    NamedTuple,
    Optional,
    Sequence,
)

from ...core.config import template_name
from ...core.nodes.outlets import json_line
from ...core.values import Clock, JsonObject, Level, Transition, matches_pattern
from ..configuration import TargetSettings
from ..store.active_silences import Silences
from ..store.present_state import keep_line
from ..store.rows import Rows, T, Values, records, skip
from .sender import Notification, group_of

MOST_WAITING = 1_000
"""Rows per target from which on those are dropped that a later one of the same alert supersedes."""

_DROPPED_AT_ONCE = 100
_MOST_SKIPPED = 50  # rows that `take` discards in one transaction, for which alerts have to wait

_UNCONFIRMED = Level.OK
"""In place of a level in `notified`: an attempt was made, and whether it arrived is not known."""

_MOST_GROUPED = 100  # alerts in one message
_LONGEST_WAIT_S = 5.0  # before it is looked again whether a wait is over: the wall clock may be set

_HEAD = """
    AS row WHERE target = ? AND NOT EXISTS (
        SELECT 1 FROM notifications AS earlier
        WHERE earlier.target = row.target AND earlier.fingerprint = row.fingerprint AND earlier.id < row.id
    ) ORDER BY attempts, place, id LIMIT 1
"""
# A source's next row follows its last one; the first row of another source is beside the first one that waits.
_INSERT = """
    INSERT INTO notifications
        (target, robot, source, place, fingerprint, level, at_s, queued_s, transition_json)
    SELECT :target, :robot, :source, max(
            coalesce((SELECT max(place) + 1 FROM notifications WHERE target = :target AND source = :source), 0),
            coalesce((SELECT min(place) FROM notifications WHERE target = :target AND attempts = 0), 0)
        ), :fingerprint, :level, :at_s, :queued_s, :json
    WHERE
"""
_ALWAYS = "1"
_IF_NOTHING_WAITS = "NOT EXISTS (SELECT 1 FROM notifications WHERE target = :target AND fingerprint = :fingerprint)"
_IF_CONCERNED = """
    EXISTS (SELECT 1 FROM notified WHERE target = :target AND fingerprint = :fingerprint)
    OR EXISTS (SELECT 1 FROM notifications WHERE target = :target AND fingerprint = :fingerprint)
"""
_STORE_NOTIFIED = """
    INSERT INTO notified (target, fingerprint, level, at_s, transition_json) VALUES (?, ?, ?, ?, ?)
    ON CONFLICT (target, fingerprint) DO UPDATE SET level = excluded.level, at_s = excluded.at_s,
        transition_json = excluded.transition_json
"""
_DROP_SUPERSEDED = """
    DELETE FROM notifications WHERE id IN (
        SELECT id FROM notifications AS row WHERE target = ? AND attempts = 0 AND EXISTS (
            SELECT 1 FROM notifications AS later
            WHERE later.target = row.target AND later.fingerprint = row.fingerprint AND later.id > row.id
        ) ORDER BY id LIMIT ?
    )
"""
_DROP_ENDED = """
    DELETE FROM notifications WHERE target = :target AND level = 0 AND attempts = 0
        AND fingerprint NOT IN (SELECT fingerprint FROM notified WHERE target = :target)
        AND NOT EXISTS (
            SELECT 1 FROM notifications AS other WHERE other.target = :target
                AND other.fingerprint = notifications.fingerprint AND other.id <> notifications.id
        )
"""


class Known(NamedTuple):
    """A row of `notified`: what a target was last sent about an alert."""

    fingerprint: str
    level: Level
    at_s: float  # wall time in s since 1970
    transition_json: JsonObject

    @property
    def notification(self) -> Notification:
        """It, as it was sent."""
        return Notification(self.transition_json, False, self.at_s)


class OpenAlert(NamedTuple):
    """A row of `open_alerts`."""

    fingerprint: str
    robot: str
    signal: str
    level: Level
    at_s: float
    transition_json: JsonObject
    begun_s: float
    silenced_s: float
    silenced_from_s: Optional[float]


class Waiting(NamedTuple):
    """A row of `notifications`."""

    id: int
    fingerprint: str
    level: Level
    at_s: float
    transition_json: JsonObject
    attempts: int


class Taken(NamedTuple):
    """A message that is being sent."""

    target: str
    notification: Notification
    parts: Sequence[tuple[int, Notification]]
    """The number of each row, and what it means."""

    @property
    def id(self) -> int:
        """Identifies it among those of its target."""
        return self.parts[0][0]


class NotificationQueue:
    """Decides what each target is sent."""

    def __init__(
        self,
        targets: Sequence[TargetSettings],
        silences: Silences,
        is_simulated: Callable[[str, str], bool] = lambda robot, signal: False,
        wall_time_s: Clock = time.time,
        public_url: str = "",
    ) -> None:
        """Reads nothing yet; see `prepare`. `is_simulated`, of robot and signal, is called often.

        `public_url` is the address of the web page, for links to the pages of alerts; empty if there is none.
        """
        self.targets = {target.name: target for target in targets if target.type != "heartbeat"}
        """Those that are sent alerts, by their names."""
        self._silences = silences
        self._is_simulated = is_simulated
        self._wall_time_s = wall_time_s
        self._page = f"{public_url.rstrip('/')}/#alerts/" if public_url else ""
        self.wait_s: dict[str, float] = {}
        """How long what waits for a target has to wait for others, in s; as the next two, to be read in any thread."""
        self._held: set[tuple[str, str]] = set()  # robot and signal of each alert that a silence holds back
        self.waiting: Counter[str] = Counter()
        """How many notifications wait, by target."""
        self.dropped: Counter[str] = Counter()
        """How many were dropped since a target had none, because later ones superseded them."""

    def is_reconciliation_due(self) -> bool:
        """Returns whether a wait (`after_s`) or a silence that held an alert back may be over. Any thread."""
        if any(target.after_s for target in self.targets.values()):
            return True
        return any(not self._is_silenced(robot, signal) for robot, signal in self._held.copy())

    def prepare(self, connection: Connection) -> None:
        """Queues whatever a target does not know: after a start, or when a silence or a wait (`after_s`) is over.

        Forgets targets that were configured before.
        """
        for table in ("notifications", "notified"):
            delete = f"DELETE FROM {table} WHERE target NOT IN ({', '.join('?' * len(self.targets))})"
            connection.execute(delete, tuple(self.targets))
        self._silences.look(connection)
        self._held.clear()
        now_s = self._wall_time_s()
        if any(target.after_s for target in self.targets.values()):
            self._note_silenced(connection, now_s)
        for name, target in self.targets.items():
            for transition, at_s in tuple(self._unknown_to(connection, target, now_s)):
                self._queue(connection, name, transition, at_s, _IF_NOTHING_WAITS)
            self._count(connection, name)

    def note(self, connection: Connection, transition: Transition, alert_id: int, wall_s: float) -> None:
        """Queues a transition for the targets that it concerns, as it is stored, at a time in s since 1970."""
        # Stored with the alert: after a restart it is unknown until battery_sensor has said so again.
        is_simulated = self._is_simulated(transition.robot, transition.signal)
        further = {"simulated": is_simulated, "what_to_do": transition.status.what_to_do}
        given = {name: value for name, value in further.items() if value}
        line = json_line(transition, alert_id=alert_id, **given)
        fields = json.loads(line)
        alert = fields["robot"], fields["signal"]
        keep_line(connection, *alert, line)
        if transition.to_level is Level.OK:
            self._held.discard(alert)
        for name, target in self.targets.items():
            is_wanted = not target.after_s and self._wants(target, fields)
            if self._queue(connection, name, fields, wall_s, _ALWAYS if is_wanted else _IF_CONCERNED):
                self.waiting[name] += 1
                self._drop_superseded(connection, name)

    def take(self, connection: Connection, target: str) -> Taken | None:
        """Returns the next notification for a target and counts the attempt; None if nothing is to be sent now."""
        self._silences.look(connection)
        self.wait_s.pop(target, None)
        settings = self.targets[target]
        parts: list[tuple[int, Notification]] = []
        for rows in (self._groups if settings.group_wait_s else self._heads)(connection, settings):
            parts = self._parts_of(connection, settings, rows)
            if parts:
                self.wait_s.pop(target, None)
                break
        self._count(connection, target)
        return Taken(target, group_of([notification for _, notification in parts]), parts) if parts else None

    def _heads(self, connection: Connection, target: TargetSettings) -> Iterator[Rows[Waiting]]:
        """Yields the next row, as long as the one before was deleted."""
        for _ in range(_MOST_SKIPPED):
            rows = _read(connection, "notifications", Waiting, _HEAD, (target.name,))
            if not rows.raw:
                return
            yield rows

    def _groups(self, connection: Connection, target: TargetSettings) -> Iterator[Rows[Waiting]]:
        """Yields the rows of each robot of which the first one has waited long enough for others."""
        query = """
            SELECT robot, min(queued_s), max(attempts) FROM notifications WHERE target = ?
            GROUP BY robot ORDER BY min(attempts), min(place), min(id)
        """
        now_s = self._wall_time_s()
        for robot, queued_s, attempts in connection.execute(query, (target.name,)).fetchall():
            left_s = queued_s + target.group_wait_s - now_s if isinstance(queued_s, (int, float)) else 0.0
            if not attempts and 0.0 < left_s <= target.group_wait_s:  # otherwise the wall clock was set back
                self.wait_s[target.name] = min(left_s, self.wait_s.get(target.name, _LONGEST_WAIT_S))
            else:
                tail = "WHERE target = ? AND robot IS ? ORDER BY id"
                yield _read(connection, "notifications", Waiting, tail, (target.name, robot))

    def _parts_of(
        self, connection: Connection, target: TargetSettings, rows: Rows[Waiting]
    ) -> list[tuple[int, Notification]]:
        """Returns what rows mean, one part per alert, and counts the attempt; deletes those that mean nothing."""
        parts: list[tuple[int, Notification]] = []
        done = {row[0] for row in rows.raw}
        if target.group_wait_s:
            for row in rows:
                if row.attempts:  # it may have arrived, whatever comes after it
                    _store_notified(connection, target.name, row)
            rows[:] = [row._replace(attempts=0) for row in rows]
        for fingerprint, last in {row.fingerprint: row for row in rows}.items():
            if len(parts) == _MOST_GROUPED:
                done -= {row.id for row in rows if row.fingerprint == fingerprint}
                continue
            notification = self._decide(connection, target, last)
            if notification is not None:
                parts.append((last.id, notification))
                done.remove(last.id)
        connection.executemany("DELETE FROM notifications WHERE id = ?", [(number,) for number in done])
        attempted = [(number,) for number, _ in parts]
        connection.executemany("UPDATE notifications SET attempts = attempts + 1 WHERE id = ?", attempted)
        return parts

    def finish(self, connection: Connection, taken: Taken) -> None:
        """Stores that a message was sent, or that it was given up and may have arrived."""
        for number, notification in taken.parts:
            fingerprint = notification.transition["fingerprint"]
            if notification.is_resolved:
                key = taken.target, fingerprint
                connection.execute("DELETE FROM notified WHERE target = ? AND fingerprint = ?", key)
            else:
                before, level = notification.before, notification.level
                since_s = before.at_s if before is not None and before.level is level else notification.at_s
                sent = Known(fingerprint, level, since_s, notification.transition)
                _store_notified(connection, taken.target, sent, level)
            connection.execute("DELETE FROM notifications WHERE id = ?", (number,))
        self._count(connection, taken.target)

    def put_back(self, connection: Connection, taken: Taken) -> None:
        """Takes back an attempt that certainly did not arrive."""
        ids = [(number,) for number, _ in taken.parts]
        connection.executemany("UPDATE notifications SET attempts = attempts - 1 WHERE id = ?", ids)

    def open_at(self, connection: Connection, target: str) -> list[Notification]:
        """Returns the alerts that are open at a target and about which nothing else waits."""
        tail = """
            WHERE target = ?1 AND level <> 0  -- _UNCONFIRMED
            AND fingerprint NOT IN (SELECT fingerprint FROM notifications WHERE target = ?1)
        """
        return [row.notification for row in _read(connection, "notified", Known, tail, (target,))]

    def end_unwatched(self, connection: Connection, robots: Collection[str], wall_s: float) -> None:
        """Ends the alerts of all robots but those that are watched, at a time in s since 1970."""
        for alert in _open_alerts(connection):
            if alert.robot not in robots:
                connection.execute("DELETE FROM open_alerts WHERE robot = ? AND signal = ?", alert[1:3])
                for name in self.targets:
                    self._queue(connection, name, _no_longer_watched(alert.transition_json), wall_s)
                    self._count(connection, name)

    def _note_silenced(self, connection: Connection, now_s: float) -> None:
        """Stores when the silences of open alerts begin to apply, and for how long they did: it does not count."""
        for alert in _open_alerts(connection):
            since_s, silenced_s = alert.silenced_from_s, alert.silenced_s
            is_silenced = self._is_silenced(alert.robot, alert.signal)
            if is_silenced is (since_s is not None):
                continue
            if since_s is not None:
                silenced_s += max(0.0, now_s - since_s)
            update = "UPDATE open_alerts SET silenced_s = ?, silenced_from_s = ? WHERE robot = ? AND signal = ?"
            connection.execute(update, (silenced_s, now_s if is_silenced else None, *alert[1:3]))

    def _queue(
        self,
        connection: Connection,
        target: str,
        transition: JsonObject,
        at_s: float,
        condition: str = _IF_CONCERNED,
    ) -> bool:
        """Queues a transition on a condition, by default if the target knows of its alert or will; returns whether."""
        values = {
            **transition, "target": target, "level": Level[transition["to_level"]], "at_s": at_s,
            "json": json.dumps(transition),
            "source": f"{transition['robot']} {template_name(transition['signal'])}", "queued_s": self._wall_time_s(),
        }  # fmt: skip
        return connection.execute(_INSERT + condition, values).rowcount > 0

    def _unknown_to(
        self, connection: Connection, target: TargetSettings, now_s: float
    ) -> Iterator[tuple[JsonObject, float]]:
        """Yields the transition of each alert about which a target knows something else, with its time."""
        known = _known_at(connection, target.name)
        for alert in _open_alerts(connection):
            before = known.pop(alert.fingerprint, None)
            if not self._wants(target, alert.transition_json):
                if before is not None:
                    yield alert.transition_json, alert.at_s
            elif before is None or before.level is not alert.level:
                if self._is_silenced(alert.robot, alert.signal):
                    self._held.add((alert.robot, alert.signal))
                elif before is not None or now_s - alert.begun_s - alert.silenced_s >= target.after_s:
                    yield alert.transition_json, alert.at_s
        for row in known.values():  # the history lost its end
            yield _no_longer_watched(row.transition_json), row.at_s

    def _decide(self, connection: Connection, target: TargetSettings, row: Waiting) -> Notification | None:
        """Returns what a row means for a target now; None if it means nothing."""
        known = _known_at(connection, target.name, row.fingerprint).get(row.fingerprint)
        before = None if known is None else known.notification
        transition = row.transition_json
        if self._page and transition.get("alert_id"):
            transition = {**transition, "link": f"{self._page}{transition['alert_id']}"}
        is_wanted = self._wants(target, transition)
        notification = Notification(transition, not is_wanted, row.at_s, before)
        name = notification.robot, notification.signal
        if not is_wanted:
            self._held.discard(name)
            return None if before is None else notification
        if self._is_silenced(*name):
            self._held.add(name)
            if row.attempts and known is None:
                _store_notified(connection, target.name, row)
            return None
        is_known = known is not None and known.level is row.level
        is_again = row.attempts or (transition["repeat"] and target.type != "alertmanager")
        return notification if is_again or not is_known else None

    def _is_silenced(self, robot: str, signal: str) -> bool:
        return self._silences.silence_of(robot, signal) is not None

    def _wants(self, target: TargetSettings, transition: JsonObject) -> bool:
        """Returns whether a target is to know that an alert has the level of a transition."""
        robot, signal, level = transition["robot"], transition["signal"], Level[transition["to_level"]]
        return (
            level is not Level.OK
            and level.severity >= target.min_level.severity
            and _matches(target.robots, robot)
            and _matches(target.signals, signal)
            and (target.simulated or not (transition.get("simulated") or self._is_simulated(robot, signal)))
        )

    def _drop_superseded(self, connection: Connection, target: str) -> None:
        waiting = self.waiting[target]
        if waiting < MOST_WAITING or waiting % _DROPPED_AT_ONCE:  # each alert may keep its latest notification
            return
        count = waiting - MOST_WAITING + _DROPPED_AT_ONCE
        for statement, values in ((_DROP_SUPERSEDED, (target, count)), (_DROP_ENDED, {"target": target})):
            self.dropped[target] += connection.execute(statement, values).rowcount
        self._count(connection, target)

    def _count(self, connection: Connection, target: str) -> None:
        query = "SELECT count(*) FROM notifications WHERE target = ?"
        self.waiting[target] = connection.execute(query, (target,)).fetchone()[0]
        if self.waiting[target] == 0:
            self.dropped[target] = 0


def is_transition(fields: JsonObject) -> bool:
    """Whether a JSON object is a transition with all that the queue and the targets need."""
    names = ("robot", "signal", "fingerprint", "text", "to_level")
    is_known = all(isinstance(fields.get(name), str) for name in names) and fields["to_level"] in Level.__members__
    return is_known and isinstance(fields.get("repeat"), bool)


def _read(connection: Connection, table: str, record: type[T], tail: str, values: Values = ()) -> Rows[T]:
    """Returns rows of a table as `records`, without those whose `transition_json` is no transition."""
    rows: Rows[Any] = records(connection, table, record, tail, values)
    for row in [row for row in rows if not is_transition(row.transition_json)]:
        skip(connection, table, row[0])
        rows.remove(row)
    return rows


def _open_alerts(connection: Connection) -> Rows[OpenAlert]:
    return _read(connection, "open_alerts", OpenAlert, "")


def _known_at(connection: Connection, target: str, *fingerprint: str) -> dict[str, Known]:
    """Returns what a target was last sent about an alert, or about each, by fingerprint."""
    tail = f"WHERE target = ? {'AND fingerprint = ?' if fingerprint else ''}"
    return {row.fingerprint: row for row in _read(connection, "notified", Known, tail, (target, *fingerprint))}


def _store_notified(
    connection: Connection, target: str, row: Known | OpenAlert | Waiting, level: Level = _UNCONFIRMED
) -> None:
    """Stores that a target was sent the transition of a row, or that an attempt was made."""
    connection.execute(_STORE_NOTIFIED, (target, row.fingerprint, level, row.at_s, json.dumps(row.transition_json)))


def _matches(patterns: Sequence[str], name: str) -> bool:
    return not patterns or any(matches_pattern(name, pattern) for pattern in patterns)


def _no_longer_watched(transition: JsonObject) -> JsonObject:
    """Returns the transition with which an alert ends because its signal is no longer watched."""
    ended = {"to_level": "OK", "text": f"{transition['signal']} OK: no longer watched", "hint": "", "repeat": False}
    return {**transition, "from_level": transition["to_level"], **ended}
