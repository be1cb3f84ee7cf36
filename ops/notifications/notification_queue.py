"""The queue of notifications, in the history's database: written with the transition, read by one thread per target.

These rules keep it correct across restarts, silences and outages of any length:

* A transition is noted in the transaction that stores it, which is all that the alert waits for. Soon afterwards it
  becomes a row for each target that may have to be sent it.
* `notified` is what a target was last sent about an alert that is open there. What a row means for a target is decided
  only when it is its turn: compared with `notified`, the silences and the target's `min_level`.
* The rows of one alert are sent in their order. A row that failed waits behind the other alerts.
* A row with an attempt may have arrived. It is sent until that succeeds or is refused; only a silence drops it. Then
  the target may know of the alert (`_UNCONFIRMED`): it is sent the end, or the alert again after the silence.

All functions run in the history's writer thread, inside its transactions.
"""

from __future__ import annotations

import json
import sqlite3
from collections import Counter
from typing import Any, Callable, Collection, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.outlets import json_line
from robot_health_monitor.core.patterns import matches_pattern

from ..configuration import TargetSettings
from .database import delete_odd_rows, is_transition
from .sender import Notification, Notified, alert_line, black_box_of

MOST_WAITING = 1_000
"""Rows per target from which on those are dropped that a later one of the same alert supersedes."""

_DROPPED_AT_ONCE = 100
_DISTRIBUTED_AT_ONCE = 20  # transitions in one transaction, for which alerts have to wait
_MOST_SKIPPED = 50  # rows that `take` discards in one transaction, for which alerts have to wait

_UNCONFIRMED = 0
"""In place of a level in `notified`: an attempt was made, and whether it arrived is not known."""

_HEAD = """
    SELECT id, fingerprint, level, at_s, transition_json, attempts, is_repeat FROM
        (SELECT *, MIN(id) FROM notifications WHERE target = ? GROUP BY fingerprint) ORDER BY attempts, id LIMIT 1
"""
_INSERT_IF_CONCERNED = """
    INSERT INTO notifications (target, fingerprint, level, at_s, transition_json, is_repeat)
    SELECT :target, :fingerprint, :level, :at_s, :json, :repeat WHERE :wanted
        OR EXISTS (SELECT 1 FROM notified WHERE target = :target AND fingerprint = :fingerprint)
        OR EXISTS (SELECT 1 FROM notifications WHERE target = :target AND fingerprint = :fingerprint)
"""
# Updates, because REPLACE would change the indexes, too.
_STORE_OPEN = """
    INSERT INTO open_alerts (fingerprint, robot, signal, level, at_s, transition_json) VALUES (?, ?, ?, ?, ?, ?)
    ON CONFLICT (fingerprint) DO UPDATE SET robot = excluded.robot, signal = excluded.signal, level = excluded.level,
        at_s = excluded.at_s, transition_json = excluded.transition_json
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

_Alert = Tuple[str, Level, float, str]  # fingerprint, level, wall time in s since 1970, and JSON of the transition


class Taken(NamedTuple):
    """A notification that is being sent."""

    id: int
    target: str
    fingerprint: str
    notification: Notification


class NotificationQueue:
    """Decides what each target is sent."""

    def __init__(
        self,
        targets: Sequence[TargetSettings],
        is_silenced: Callable[[str, str], bool],
        look: Callable[[], None],
        is_simulated: Callable[[str, str], bool] = lambda robot, signal: False,
    ) -> None:
        """Reads nothing yet; see `prepare`. `is_silenced` and `is_simulated`, of robot and signal, are called often.

        `look` reads silences that others have added; called in the transaction that decides what is sent.
        """
        self._targets = {target.name: target for target in targets}
        self._is_silenced = is_silenced
        self._is_simulated = is_simulated
        self._look = look
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

    def has_expired_silence(self) -> bool:
        """Returns whether an alert that was held back is no longer silenced. May be called from any thread."""
        return any(not self._is_silenced(robot, signal) for robot, signal in self._held.copy())

    def use_targets(self, connection: sqlite3.Connection, targets: Sequence[TargetSettings]) -> None:
        """Replaces the targets: forgets the others, and queues what new ones do not know yet."""
        self._targets = {target.name: target for target in targets}
        self._waiting = Counter({name: self._waiting[name] for name in self._targets})
        self.prepare(connection)

    def prepare(self, connection: sqlite3.Connection) -> None:
        """Forgets targets that are no longer configured, and queues what the others do not know yet."""
        delete_odd_rows(connection)
        for table in ("notifications", "notified"):
            known = [name for (name,) in connection.execute(f"SELECT DISTINCT target FROM {table}")]
            unknown = [(name,) for name in known if name not in self._targets]
            connection.executemany(f"DELETE FROM {table} WHERE target = ?", unknown)
        while self.distribute(connection):
            pass
        self.reconcile(connection)

    def assume_sent(self, connection: sqlite3.Connection) -> None:
        """Takes every open alert as one that may have been sent: it is sent again, and its end in any case."""
        rows = connection.execute("SELECT fingerprint, level, at_s, transition_json FROM open_alerts").fetchall()
        for key, level, at_s, line in rows:
            for name, target in self._targets.items():
                if is_transition(line) and self._wants(target, json.loads(line), Level(level)):
                    connection.execute(_STORE_NOTIFIED, (name, key, _UNCONFIRMED, at_s, line))

    def note(self, connection: sqlite3.Connection, transition: Transition, wall_s: float) -> None:
        """Notes a transition, at a time in s since 1970, as it is stored. The alert waits for this one insertion."""
        insert = "INSERT INTO noted_transitions (at_s, transition_json) VALUES (?, ?)"
        # Stored with the alert: after a restart it is unknown until battery_sensor has said so again.
        further = {"simulated": True} if self._is_simulated(transition.robot, transition.signal) else {}
        connection.execute(insert, (wall_s, json_line(transition, **further)))

    def distribute(self, connection: sqlite3.Connection) -> bool:
        """Queues a bounded number of noted transitions for the targets that they concern; returns if there are more."""
        query = "SELECT id, at_s, transition_json FROM noted_transitions ORDER BY id LIMIT ?"
        rows = connection.execute(query, (_DISTRIBUTED_AT_ONCE,)).fetchall()
        for _, at_s, line in rows:
            transition = json.loads(line)
            key, level, is_repeat = transition["fingerprint"], Level[transition["to_level"]], transition["repeat"]
            if level is Level.OK:
                connection.execute("DELETE FROM open_alerts WHERE fingerprint = ?", (key,))
            elif not is_repeat:
                row = (key, transition["robot"], transition["signal"], int(level), at_s, line)
                connection.execute(_STORE_OPEN, row)
            for name, target in self._targets.items():
                is_wanted = self._wants(target, transition, level)
                if self._queue(connection, name, (key, level, at_s, line), is_repeat, is_wanted):
                    self._waiting[name] += 1
                    self._drop_superseded(connection, name)
        if rows:
            connection.execute("DELETE FROM noted_transitions WHERE id <= ?", (rows[-1][0],))
        return len(rows) == _DISTRIBUTED_AT_ONCE

    def take(self, connection: sqlite3.Connection, target: str) -> Optional[Taken]:
        """Returns the next notification for a target and counts the attempt; None: nothing is to be sent now."""
        self._look()
        if target not in self._targets:  # it has just been removed
            return None
        found = None
        for _ in range(_MOST_SKIPPED):
            row = connection.execute(_HEAD, (target,)).fetchone()
            if row is None:
                break
            notification = self._decide(connection, self._targets[target], row)
            if notification is not None:
                connection.execute("UPDATE notifications SET attempts = attempts + 1 WHERE id = ?", row[:1])
                found = Taken(row[0], target, row[1], notification)
                break
            connection.execute("DELETE FROM notifications WHERE id = ?", row[:1])
        self._count(connection, target)
        return found

    def finish(self, connection: sqlite3.Connection, taken: Taken) -> None:
        """Stores that a notification was sent, or that it was given up and may have arrived."""
        key, notification = (taken.target, taken.fingerprint), taken.notification
        if notification.is_resolved:
            connection.execute("DELETE FROM notified WHERE target = ? AND fingerprint = ?", key)
        else:
            before, sent = notification.before, notification.sent
            is_repetition = before is not None and before.level is sent.level
            since_s = before.since_s if before is not None and is_repetition else sent.since_s
            line = json.dumps(dict(notification.transition))
            connection.execute(_STORE_NOTIFIED, (*key, int(sent.level), since_s, line))
        connection.execute("DELETE FROM notifications WHERE id = ?", (taken.id,))
        self._count(connection, taken.target)

    def put_back(self, connection: sqlite3.Connection, taken: Taken) -> None:
        """Takes back an attempt that certainly did not arrive."""
        connection.execute("UPDATE notifications SET attempts = attempts - 1 WHERE id = ?", (taken.id,))

    def open_at(self, connection: sqlite3.Connection, target: str) -> List[Notified]:
        """Returns the alerts that are open at a target and about which nothing else waits."""
        query = (
            "SELECT level, since_s, transition_json FROM notified WHERE target = ? AND level <> ? "
            "AND fingerprint NOT IN (SELECT fingerprint FROM notifications WHERE target = ?)"
        )
        return [_notified(*row) for row in connection.execute(query, (target, _UNCONFIRMED, target))]

    def reconcile(self, connection: sqlite3.Connection) -> None:
        """Queues whatever a target does not know: after a start, or when a silence has expired."""
        self._look()
        self._held.clear()
        for name, target in self._targets.items():
            query = "SELECT DISTINCT fingerprint FROM notifications WHERE target = ?"
            waiting = {key for (key,) in connection.execute(query, (name,))}
            for alert in tuple(self._unknown_to(connection, target)):
                if alert[0] not in waiting:
                    self._queue(connection, name, alert, is_wanted=True)
            self._count(connection, name)

    def end_unwatched(self, connection: sqlite3.Connection, robots: Collection[str], wall_s: float) -> None:
        """Ends the alerts of all robots but those that are watched, at a time in s since 1970."""
        open_alerts = connection.execute("SELECT fingerprint, robot, transition_json FROM open_alerts").fetchall()
        for key, robot, line in open_alerts:
            if robot not in robots:
                connection.execute("DELETE FROM open_alerts WHERE fingerprint = ?", (key,))
                for name in self._targets:
                    self._queue(connection, name, (key, Level.OK, wall_s, _no_longer_watched(line)))
                    self._count(connection, name)

    @staticmethod
    def _queue(
        connection: sqlite3.Connection, target: str, alert: _Alert, is_repeat: bool = False, is_wanted: bool = False
    ) -> bool:
        """Queues a transition if the target wants it, or knows of the alert or will; returns whether that is so."""
        fingerprint, level, at_s, line = alert
        values = {
            "target": target, "fingerprint": fingerprint, "level": int(level), "at_s": at_s, "json": line,
            "repeat": is_repeat, "wanted": is_wanted,
        }  # fmt: skip
        return connection.execute(_INSERT_IF_CONCERNED, values).rowcount > 0

    def _unknown_to(self, connection: sqlite3.Connection, target: TargetSettings) -> Iterator[_Alert]:
        """Yields each alert about which a target knows something else."""
        query = "SELECT fingerprint, level, since_s, transition_json FROM notified WHERE target = ?"
        known = {key: (level, since_s, line) for key, level, since_s, line in connection.execute(query, (target.name,))}
        rows = connection.execute("SELECT fingerprint, robot, signal, level, at_s, transition_json FROM open_alerts")
        for key, robot, signal, level, at_s, line in rows:
            before = known.pop(key, None)
            if not self._wants(target, json.loads(line), Level(level)):
                if before is not None:
                    yield key, Level(level), at_s, line
            elif before is None or before[0] != level:
                if self._is_silenced(robot, signal):
                    self._held.add((robot, signal))
                else:
                    yield key, Level(level), at_s, line
        for key, (_, since_s, line) in known.items():  # the history lost its end
            yield key, Level.OK, since_s, _no_longer_watched(line)

    def _decide(
        self, connection: sqlite3.Connection, target: TargetSettings, head: Tuple[Any, ...]
    ) -> Optional[Notification]:
        """Returns what a row of `_HEAD` means for a target now; None: nothing."""
        _, fingerprint, level, at_s, line, attempts, is_repeat = head
        query = "SELECT level, since_s, transition_json FROM notified WHERE target = ? AND fingerprint = ?"
        row = connection.execute(query, (target.name, fingerprint)).fetchone()
        before = None if row is None else _notified(*row)
        notification = Notification(json.loads(line), False, at_s, before)
        if not self._wants(target, notification.transition, Level(level)):
            return None if before is None else Notification(notification.transition, True, at_s, before)
        if self._is_silenced(notification.robot, notification.signal):
            self._held.add((notification.robot, notification.signal))
            if attempts and row is None:
                values = (target.name, fingerprint, _UNCONFIRMED, at_s, line)
                connection.execute("INSERT INTO notified VALUES (?, ?, ?, ?, ?)", values)
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
        self._dropped[target] += connection.execute(_DROP_SUPERSEDED, (target, count)).rowcount
        self._count(connection, target)
        # Each alert may keep its latest notification: then there is nothing to drop for a while.
        self._drop_at[target] = max(MOST_WAITING, self._waiting[target] + _DROPPED_AT_ONCE)

    def _count(self, connection: sqlite3.Connection, target: str) -> None:
        query = "SELECT count(*) FROM notifications WHERE target = ?"
        self._waiting[target] = connection.execute(query, (target,)).fetchone()[0]
        if self._waiting[target] == 0:
            self._dropped[target] = 0


def _matches(patterns: Sequence[str], name: str) -> bool:
    return not patterns or any(matches_pattern(name, pattern) for pattern in patterns)


def _notified(level: int, since_s: float, line: str) -> Notified:
    transition = json.loads(line)
    known = Level[transition["to_level"]] if level == _UNCONFIRMED else Level(level)
    text, black_box = alert_line(transition), black_box_of(transition)
    return Notified(transition["robot"], transition["signal"], known, since_s, text, black_box)


def _no_longer_watched(line: str) -> str:
    """Returns the JSON of the transition with which an alert ends because its signal is no longer watched."""
    transition = json.loads(line)
    ended = {"to_level": "OK", "text": f"{transition['signal']} OK: no longer watched", "hint": "", "repeat": False}
    return json.dumps({**transition, "from_level": transition["to_level"], **ended})
