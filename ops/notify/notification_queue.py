"""The queue of notifications, in the history's database: written with the transition, read by one thread per target.

These rules keep it correct across restarts, silences and outages of any length:

* The transaction that stores a transition also stores a row for each target that may have to be sent it.
* `notified` is what a target was last sent about an alert that is open there. What a row means for a target is decided
  only when it is its turn: compared with `notified`, the silences and the target's `min_level`.
* The rows of one alert are sent in their order. A row that failed waits behind the other alerts.
* A target with `after_s` is queued an alert only once that was open for so long without its silences (`reconcile`).
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
import sqlite3
import time
from collections import Counter
from typing import Any, Callable, Collection, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from ...core.config.signal_config import template_name
from ...core.values.model import Level, Transition
from ...core.values.patterns import matches_pattern
from ..configuration import TargetSettings
from ..store.present_state import alert_json
from ..store.rows import checked, is_count, is_level, is_number, is_text, is_time, optional
from .sender import Notification, Notified, alert_line, annotations_of, group_of

MOST_WAITING = 1_000
"""Rows per target from which on those are dropped that a later one of the same alert supersedes."""

_DROPPED_AT_ONCE = 100
_MOST_SKIPPED = 50  # rows that `take` discards in one transaction, for which alerts have to wait

_UNCONFIRMED = 0
"""In place of a level in `notified`: an attempt was made, and whether it arrived is not known."""

_MOST_GROUPED = 100  # alerts in one message
_LONGEST_WAIT_S = 5.0  # before it is looked again whether a wait is over: the wall clock may be set

_COLUMNS = "id, fingerprint, level, at_s, transition_json, attempts, is_repeat"
_HEAD = f"""
    SELECT {_COLUMNS} FROM notifications AS row
    WHERE target = ? AND NOT EXISTS (
        SELECT 1 FROM notifications AS earlier
        WHERE earlier.target = row.target AND earlier.fingerprint = row.fingerprint AND earlier.id < row.id
    ) ORDER BY attempts, place, id LIMIT 1
"""
# A source's next row follows its last one; the first row of another source is beside the first one that waits.
_INSERT_IF_CONCERNED = """
    INSERT INTO notifications
        (target, robot, source, place, fingerprint, level, at_s, queued_s, transition_json, is_repeat)
    SELECT :target, :robot, :source, max(
            coalesce((SELECT max(place) + 1 FROM notifications WHERE target = :target AND source = :source), 0),
            coalesce((SELECT min(place) FROM notifications WHERE target = :target AND attempts = 0), 0)
        ), :fingerprint, :level, :at_s, :queued_s, :json, :repeat
    WHERE :wanted
        OR EXISTS (SELECT 1 FROM notified WHERE target = :target AND fingerprint = :fingerprint)
        OR EXISTS (SELECT 1 FROM notifications WHERE target = :target AND fingerprint = :fingerprint)
"""
_STORE_NOTIFIED = """
    INSERT INTO notified (target, fingerprint, level, since_s, transition_json) VALUES (?, ?, ?, ?, ?)
    ON CONFLICT (target, fingerprint) DO UPDATE SET level = excluded.level, since_s = excluded.since_s,
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

_Alert = Tuple[str, Level, float, str]  # fingerprint, level, wall time in s since 1970, and JSON of the transition


class OpenAlert(NamedTuple):
    """A row of `open_alerts`; the level as such."""

    fingerprint: str
    robot: str
    signal: str
    level: Level
    at_s: float
    line: str
    begun_s: float
    silenced_s: float
    silenced_from_s: Optional[float]


class Part(NamedTuple):
    """A row that is being sent, by itself or with others."""

    id: int
    fingerprint: str
    notification: Notification


class Taken(NamedTuple):
    """A message that is being sent."""

    target: str
    notification: Notification
    parts: Sequence[Part]

    @property
    def id(self) -> int:
        """Identifies it among those of its target."""
        return self.parts[0].id


class NotificationQueue:
    """Decides what each target is sent."""

    def __init__(
        self,
        targets: Sequence[TargetSettings],
        is_silenced: Callable[[str, str], bool],
        look: Callable[[sqlite3.Connection], object],
        is_simulated: Callable[[str, str], bool] = lambda robot, signal: False,
        wall_time_s: Callable[[], float] = time.time,
        public_url: str = "",
    ) -> None:
        """Reads nothing yet; see `prepare`. `is_silenced` and `is_simulated`, of robot and signal, are called often.

        `look` reads silences that others have added; called in the transaction that decides what is sent. `public_url`
        is the address of the web page, for links to the pages of alerts; empty if there is none.
        """
        self._targets = {target.name: target for target in targets}
        self._is_silenced = is_silenced
        self._is_simulated = is_simulated
        self._look = look
        self._wall_time_s = wall_time_s
        self._page = f"{public_url.rstrip('/')}/#alerts/" if public_url else ""
        self._wait_s: Dict[str, float] = {}
        self._held: Set[Tuple[str, str]] = set()  # robot and signal of each alert that a silence holds back
        self._waiting: Counter[str] = Counter()
        self._dropped: Counter[str] = Counter()
        self._drop_at: Dict[str, int] = {}

    def waiting(self, target: str) -> int:
        """Returns how many notifications wait for a target. May be called from any thread."""
        return self._waiting[target]

    def dropped(self, target: str) -> int:
        """Returns how many were dropped since it last was empty, because later ones superseded them. Any thread."""
        return self._dropped[target]

    def wait_s(self, target: str) -> float:
        """Returns how long what waits for a target has to wait for others, in s; 0 if it need not. Any thread."""
        return self._wait_s.get(target, 0.0)

    def is_reconciliation_due(self) -> bool:
        """Returns whether a wait (`after_s`) or a silence that held an alert back may be over. Any thread."""
        if any(target.after_s for target in self._targets.values()):
            return True
        return any(not self._is_silenced(robot, signal) for robot, signal in self._held.copy())

    def use_targets(self, connection: sqlite3.Connection, targets: Sequence[TargetSettings]) -> None:
        """Replaces the targets: forgets the others, and queues what new ones do not know yet."""
        self._targets = {target.name: target for target in targets}
        self._waiting = Counter({name: self._waiting[name] for name in self._targets})
        self.prepare(connection)

    def prepare(self, connection: sqlite3.Connection) -> None:
        """Forgets targets that are no longer configured, and queues what the others do not know yet."""
        for table in ("notifications", "notified"):
            known = [name for (name,) in connection.execute(f"SELECT DISTINCT target FROM {table}")]
            unknown = [(name,) for name in known if name not in self._targets]
            connection.executemany(f"DELETE FROM {table} WHERE target = ?", unknown)
        self.reconcile(connection)

    def assume_sent(self, connection: sqlite3.Connection) -> None:
        """Takes every open alert as one that may have been sent: it is sent again, and its end in any case."""
        for alert in _open_alerts(connection):
            for name, target in self._targets.items():
                if self._wants(target, json.loads(alert.line), alert.level):
                    row = (name, alert.fingerprint, _UNCONFIRMED, alert.at_s, alert.line)
                    connection.execute(_STORE_NOTIFIED, row)

    def note(self, connection: sqlite3.Connection, transition: Transition, alert_id: int, wall_s: float) -> None:
        """Queues a transition for the targets that it concerns, as it is stored, at a time in s since 1970."""
        # Stored with the alert: after a restart it is unknown until battery_sensor has said so again.
        simulated = {"simulated": True} if self._is_simulated(transition.robot, transition.signal) else {}
        line = alert_json(transition, alert_id, **simulated)
        if simulated:
            update = "UPDATE open_alerts SET transition_json = ? WHERE fingerprint = ?"
            connection.execute(update, (line, transition.fingerprint))
        level, fields = transition.to_level, json.loads(line)
        if level is Level.OK:
            self._held.discard((fields["robot"], fields["signal"]))
        for name, target in self._targets.items():
            alert = transition.fingerprint, level, wall_s, line
            is_wanted = not target.after_s and self._wants(target, fields, level)
            if self._queue(connection, name, alert, transition.repeat, is_wanted):
                self._waiting[name] += 1
                self._drop_superseded(connection, name)

    def take(self, connection: sqlite3.Connection, target: str) -> Optional[Taken]:
        """Returns the next notification for a target and counts the attempt; None: nothing is to be sent now."""
        self._look(connection)
        self._wait_s.pop(target, None)
        if target not in self._targets:  # it has just been removed
            return None
        if self._targets[target].group_wait_s:
            group = self._take_group(connection, self._targets[target])
            self._count(connection, target)
            return group
        found = None
        for _ in range(_MOST_SKIPPED):
            row = connection.execute(_HEAD, (target,)).fetchone()
            if row is None:
                break
            is_usual = any(checked(connection, "notifications", [row], _HEAD_CHECKS))
            notification = self._decide(connection, self._targets[target], row) if is_usual else None
            if notification is not None:
                connection.execute("UPDATE notifications SET attempts = attempts + 1 WHERE id = ?", row[:1])
                found = Taken(target, notification, [Part(row[0], row[1], notification)])
                break
            connection.execute("DELETE FROM notifications WHERE id = ?", row[:1])
        self._count(connection, target)
        return found

    def _take_group(self, connection: sqlite3.Connection, target: TargetSettings) -> Optional[Taken]:
        """Returns what one robot has waited for long enough, as one message; None if there is nothing of the kind."""
        query = """
            SELECT robot, min(queued_s), max(attempts) FROM notifications WHERE target = ?
            GROUP BY robot ORDER BY min(attempts), min(place), min(id)
        """
        now_s = self._wall_time_s()
        for robot, queued_s, attempts in connection.execute(query, (target.name,)).fetchall():
            left_s = queued_s + target.group_wait_s - now_s if is_time(queued_s) else 0.0
            if not attempts and 0.0 < left_s <= target.group_wait_s:  # otherwise the wall clock was set back
                self._wait_s[target.name] = min(left_s, self._wait_s.get(target.name, _LONGEST_WAIT_S))
                continue
            parts = self._parts_of(connection, target, robot)
            if parts:
                self._wait_s.pop(target.name, None)
                return Taken(target.name, group_of([part.notification for part in parts]), parts)
        return None

    def _parts_of(self, connection: sqlite3.Connection, target: TargetSettings, robot: object) -> List[Part]:
        """Returns what the rows of a robot mean, one part per alert, and counts the attempt; deletes the others."""
        query = f"SELECT {_COLUMNS} FROM notifications WHERE target = ? AND robot IS ? ORDER BY id"
        alerts: Dict[Any, List[Tuple[Any, ...]]] = {}
        for row in connection.execute(query, (target.name, robot)).fetchall():
            alerts.setdefault(row[1], []).append(row)
        parts: List[Part] = []
        for fingerprint, rows in alerts.items():
            if len(parts) == _MOST_GROUPED:
                break
            usual = [*checked(connection, "notifications", rows, _HEAD_CHECKS)]
            attempted = [row for row in usual if row[5]]
            if attempted:  # any of them may have arrived
                _, _, _, at_s, line, _, _ = attempted[0]
                connection.execute(_STORE_NOTIFIED, (target.name, fingerprint, _UNCONFIRMED, at_s, line))
            last = usual[-1] if usual else None
            notification = None if last is None else self._decide(connection, target, (*last[:5], 0, last[6]))
            kept = rows[:0] if last is None or notification is None else [last]
            done = [(row[0],) for row in rows if row not in kept]
            connection.executemany("DELETE FROM notifications WHERE id = ?", done)
            if last is not None and notification is not None:
                connection.execute("UPDATE notifications SET attempts = attempts + 1 WHERE id = ?", last[:1])
                parts.append(Part(last[0], fingerprint, notification))
        return parts

    def finish(self, connection: sqlite3.Connection, taken: Taken) -> None:
        """Stores that a message was sent, or that it was given up and may have arrived."""
        for number, fingerprint, notification in taken.parts:
            key = taken.target, fingerprint
            if notification.is_resolved:
                connection.execute("DELETE FROM notified WHERE target = ? AND fingerprint = ?", key)
            else:
                before, sent = notification.before, notification.sent
                is_repetition = before is not None and before.level is sent.level
                since_s = before.since_s if before is not None and is_repetition else sent.since_s
                line = json.dumps(dict(notification.transition))
                connection.execute(_STORE_NOTIFIED, (*key, int(sent.level), since_s, line))
            connection.execute("DELETE FROM notifications WHERE id = ?", (number,))
        self._count(connection, taken.target)

    def put_back(self, connection: sqlite3.Connection, taken: Taken) -> None:
        """Takes back an attempt that certainly did not arrive."""
        ids = [(part.id,) for part in taken.parts]
        connection.executemany("UPDATE notifications SET attempts = attempts - 1 WHERE id = ?", ids)

    def open_at(self, connection: sqlite3.Connection, target: str) -> List[Notified]:
        """Returns the alerts that are open at a target and about which nothing else waits."""
        rows = connection.execute("SELECT DISTINCT fingerprint FROM notifications WHERE target = ?", (target,))
        waiting = {key for (key,) in rows}
        known = _known_at(connection, target).items()
        return [_notified(*row) for key, row in known if key not in waiting and row[0] != _UNCONFIRMED]

    def reconcile(self, connection: sqlite3.Connection) -> None:
        """Queues whatever a target does not know: after a start, or when a silence or a wait (`after_s`) is over."""
        self._look(connection)
        self._held.clear()
        now_s = self._wall_time_s()
        if any(target.after_s for target in self._targets.values()):
            self._note_silenced(connection, now_s)
        for name, target in self._targets.items():
            query = "SELECT DISTINCT fingerprint FROM notifications WHERE target = ?"
            waiting = {key for (key,) in connection.execute(query, (name,))}
            for alert in tuple(self._unknown_to(connection, target, now_s)):
                if alert[0] not in waiting:
                    self._queue(connection, name, alert, is_wanted=True)
            self._count(connection, name)

    def end_unwatched(self, connection: sqlite3.Connection, robots: Collection[str], wall_s: float) -> None:
        """Ends the alerts of all robots but those that are watched, at a time in s since 1970."""
        for alert in _open_alerts(connection):
            if alert.robot not in robots:
                connection.execute("DELETE FROM open_alerts WHERE robot = ? AND signal = ?", alert[1:3])
                for name in self._targets:
                    ended = alert.fingerprint, Level.OK, wall_s, _no_longer_watched(alert.line)
                    self._queue(connection, name, ended)
                    self._count(connection, name)

    def _note_silenced(self, connection: sqlite3.Connection, now_s: float) -> None:
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
        connection: sqlite3.Connection,
        target: str,
        alert: _Alert,
        is_repeat: bool = False,
        is_wanted: bool = False,
    ) -> bool:
        """Queues a transition if the target wants it, or knows of the alert or will; returns whether that is so."""
        fingerprint, level, at_s, line = alert
        transition = json.loads(line)
        values = {
            "target": target, "fingerprint": fingerprint, "level": int(level), "at_s": at_s, "json": line,
            "repeat": is_repeat, "wanted": is_wanted, "robot": transition["robot"], "queued_s": self._wall_time_s(),
            "source": f"{transition['robot']} {template_name(transition['signal'])}",
        }  # fmt: skip
        return connection.execute(_INSERT_IF_CONCERNED, values).rowcount > 0

    def _unknown_to(self, connection: sqlite3.Connection, target: TargetSettings, now_s: float) -> Iterator[_Alert]:
        """Yields each alert about which a target knows something else."""
        known = _known_at(connection, target.name)
        for alert in _open_alerts(connection):
            key, robot, signal, level, at_s, line, begun_s, silenced_s, _ = alert
            before = known.pop(key, None)
            if not self._wants(target, json.loads(line), level):
                if before is not None:
                    yield key, level, at_s, line
            elif before is None or before[0] != level:
                if self._is_silenced(robot, signal):
                    self._held.add((robot, signal))
                elif before is not None or now_s - begun_s - silenced_s >= target.after_s:
                    yield key, level, at_s, line
        for key, (_, since_s, line) in known.items():  # the history lost its end
            yield key, Level.OK, since_s, _no_longer_watched(line)

    def _decide(
        self, connection: sqlite3.Connection, target: TargetSettings, head: Tuple[Any, ...]
    ) -> Optional[Notification]:
        """Returns what a row of `_HEAD` means for a target now; None: nothing."""
        _, fingerprint, level, at_s, line, attempts, is_repeat = head
        row = _known_at(connection, target.name, fingerprint).get(fingerprint)
        before = None if row is None else _notified(*row)
        transition = json.loads(line)
        if self._page and transition.get("alert_id"):
            transition["link"] = f"{self._page}{transition['alert_id']}"
        notification = Notification(transition, False, at_s, before)
        if not self._wants(target, notification.transition, Level(level)):
            self._held.discard((notification.robot, notification.signal))
            return None if before is None else Notification(notification.transition, True, at_s, before)
        if self._is_silenced(notification.robot, notification.signal):
            self._held.add((notification.robot, notification.signal))
            if attempts and row is None:
                connection.execute(_STORE_NOTIFIED, (target.name, fingerprint, _UNCONFIRMED, at_s, line))
            return None
        is_known = row is not None and row[0] == level
        if is_known and not attempts and (not is_repeat or target.type == "alertmanager"):
            return None
        return notification

    def _wants(self, target: TargetSettings, transition: Mapping[str, Any], level: Level) -> bool:
        """Returns whether a target is to know that an alert has a level."""
        robot, signal = str(transition["robot"]), str(transition["signal"])
        return (
            level is not Level.OK
            and level.severity >= target.min_level.severity
            and _matches(target.robots, robot)
            and _matches(target.signals, signal)
            and (target.simulated or not (transition.get("simulated") or self._is_simulated(robot, signal)))
        )

    def _drop_superseded(self, connection: sqlite3.Connection, target: str) -> None:
        waiting = self._waiting[target]
        if waiting <= self._drop_at.get(target, MOST_WAITING):
            return
        count = waiting - MOST_WAITING + _DROPPED_AT_ONCE
        for statement, values in ((_DROP_SUPERSEDED, (target, count)), (_DROP_ENDED, {"target": target})):
            self._dropped[target] += connection.execute(statement, values).rowcount
        self._count(connection, target)
        # Each alert may keep its latest notification: then there is nothing to drop for a while.
        self._drop_at[target] = max(MOST_WAITING, self._waiting[target] + _DROPPED_AT_ONCE)

    def _count(self, connection: sqlite3.Connection, target: str) -> None:
        query = "SELECT count(*) FROM notifications WHERE target = ?"
        self._waiting[target] = connection.execute(query, (target,)).fetchone()[0]
        if self._waiting[target] == 0:
            self._dropped[target] = 0


def is_transition(line: object) -> bool:
    """Whether a value is the JSON of a transition with all that the queue and the targets need."""
    try:
        transition = json.loads(line)  # type: ignore[arg-type]
    except (TypeError, ValueError, RecursionError):
        return False
    return (
        isinstance(transition, dict)
        and all(is_text(transition.get(name)) for name in ("robot", "signal", "fingerprint", "text"))
        and all(str(transition.get(name)) in Level.__members__ for name in ("from_level", "to_level"))
        and all(is_number(transition.get(name)) for name in ("now_s", "since_s"))
        and isinstance(transition.get("repeat"), bool)
        and isinstance(transition.get("hint"), str)
        and isinstance(transition.get("black_box"), str)
    )


_HEAD_CHECKS = (is_count, is_text, is_level, is_time, is_transition, is_count, is_count)


def _open_alerts(connection: sqlite3.Connection) -> Iterator[OpenAlert]:
    columns = "fingerprint, robot, signal, level, at_s, transition_json, begun_s, silenced_s, silenced_from_s"
    rows = connection.execute(f"SELECT {columns} FROM open_alerts").fetchall()
    checks = (is_text, is_text, is_text, is_level, is_time, is_transition, is_time, is_number, optional(is_time))
    for row in checked(connection, "open_alerts", rows, checks):
        yield OpenAlert(*row)._replace(level=Level(row[3]))


def _known_at(
    connection: sqlite3.Connection, target: str, fingerprint: Optional[str] = None
) -> Dict[str, Tuple[int, float, str]]:
    """Returns what a target was last sent: level, time and JSON, by fingerprint (None: of every alert)."""
    query, values = "SELECT fingerprint, level, since_s, transition_json FROM notified WHERE target = ?", [target]
    if fingerprint is not None:
        query, values = f"{query} AND fingerprint = ?", [target, fingerprint]
    rows = connection.execute(query, values).fetchall()
    found = checked(connection, "notified", rows, (is_text, is_level, is_time, is_transition))
    return {key: (level, since_s, line) for key, level, since_s, line in found}


def _matches(patterns: Sequence[str], name: str) -> bool:
    return not patterns or any(matches_pattern(name, pattern) for pattern in patterns)


def _notified(level: int, since_s: float, line: str) -> Notified:
    transition = json.loads(line)
    known = Level[transition["to_level"]] if level == _UNCONFIRMED else Level(level)
    text, annotations = alert_line(transition), annotations_of(transition)
    return Notified(transition["robot"], transition["signal"], known, since_s, text, annotations)


def _no_longer_watched(line: str) -> str:
    """Returns the JSON of the transition with which an alert ends because its signal is no longer watched."""
    transition = json.loads(line)
    ended = {"to_level": "OK", "text": f"{transition['signal']} OK: no longer watched", "hint": "", "repeat": False}
    return json.dumps({**transition, "from_level": transition["to_level"], **ended})
