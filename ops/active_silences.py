"""The silences of a running monitor: a copy of those in the history, which others may change at any time."""

from __future__ import annotations

import sqlite3
import threading
import time
from dataclasses import replace
from typing import Callable, Dict, List, Optional, Sequence, Tuple, TypeVar

from robot_health_monitor.core.errors import ConfigError, ServiceError
from robot_health_monitor.core.faults import Faults
from robot_health_monitor.core.formatting import count_text, duration_text, printable
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.runtime.threads import MonotonicEvent

from .history.history import History
from .matchers import Matcher
from .silences import (
    Alert,
    Silence,
    add_silence,
    expire_silence,
    limit_to_durations,
    read_silences,
    resolve_alert,
    time_text,
)  # fmt: skip

Changed = TypeVar("Changed")

_MOST_CACHED = 20_000
_REFRESH_S = 1.0
_TIMEOUT_S = 2.0
_FAULT = "silence list"
_CLOCK_FAULT = "wall clock"


class Silences:
    """The silences of a running monitor: an in-memory copy, which follows the history file within about a second.

    All methods but `look` may be called from any thread.
    """

    def __init__(
        self, history: History, faults: Optional[Faults] = None, wall_time_s: Callable[[], float] = time.time
    ) -> None:
        """Reads the silences; `close` ends following the file.

        While they cannot be read, that is a fault, and the last known ones stay in force.
        """
        self._history = history
        self._faults = Faults() if faults is None else faults
        self._wall_time_s = wall_time_s
        self._lock = threading.Lock()
        self._active: Sequence[Silence] = ()
        self._found: Dict[Alert, Optional[Silence]] = {}
        self._next_end_s = float("inf")
        self._version = 0
        self._seen: Optional[Tuple[sqlite3.Connection, int]] = None
        self._closing = MonotonicEvent()
        history.on_record(self._note_transition)
        self._refresh(history.run)
        threading.Thread(target=self._follow, name="silences", daemon=True).start()

    def silence_of(self, robot: str, signal: str) -> Optional[Silence]:
        """Returns the silence of an alert, of several the one that ends last; None: it is not silenced."""
        if not self._active:
            return None
        now_s = self._wall_time_s()
        with self._lock:
            if now_s >= self._next_end_s:
                self._set_active(self._active, now_s)
            key = printable(robot), printable(signal)
            if key not in self._found:
                if len(self._found) >= _MOST_CACHED:
                    self._found.clear()
                covering = [silence for silence in self._active if silence.covers(*key)]
                self._found[key] = max(covering, key=_end_order, default=None)
            silence = self._found[key]
        return silence.seen_at(now_s) if silence is not None and silence.is_active(now_s) else None

    def active(self) -> List[Silence]:
        """Returns the active silences, oldest first."""
        now_s = self._wall_time_s()
        return [silence.seen_at(now_s) for silence in self._active if silence.is_active(now_s)]

    def look(self, connection: sqlite3.Connection) -> None:
        """Reads the silences again if another process has changed the file: call before a notification is sent.

        Call with the history's connection inside a transaction, in which another process cannot add a silence.
        """
        seen = (connection, connection.execute("PRAGMA data_version").fetchone()[0])
        if seen == self._seen:
            return
        try:
            self._take_over(connection)
        except (sqlite3.Error, ConfigError):
            return  # `_follow` reports it; the last known ones stay in force
        self._seen = seen

    def add(
        self,
        matchers: Sequence[Matcher],
        *,
        for_s: Optional[float] = None,
        until_resolved: bool = False,
        reason: str = "",
        author: str = "",
    ) -> Silence:
        """Adds a silence, as `add_silence`; a ServiceError says that the history failed or did not answer."""
        texts = {"reason": reason, "author": author}
        return self._change(
            lambda connection, now_s: add_silence(
                connection, matchers, now_s, for_s=for_s, until_resolved=until_resolved, **texts
            )
        )

    def expire(self, number: int, *, reason: str = "", author: str = "") -> Silence:
        """Ends a silence, as `expire_silence`; a ServiceError says that the history failed or did not answer."""
        return self._change(
            lambda connection, now_s: expire_silence(connection, number, now_s, reason=reason, author=author)
        )

    def close(self) -> None:
        """Stops following the file; returns at once."""
        self._closing.set()

    def _follow(self) -> None:
        while not self._closing.wait(_REFRESH_S):
            self._refresh(self._history.read)

    def _refresh(self, run: Callable[[Callable[[sqlite3.Connection], List[Silence]], float], List[Silence]]) -> None:
        version = self._version
        now_s = self._wall_time_s()
        try:
            silences = run(lambda connection: read_silences(connection, active_at_s=now_s), _TIMEOUT_S)
            self._limit(silences, now_s)
        except (ConfigError, ServiceError, sqlite3.Error) as error:
            if not self._closing.is_set():
                self._faults.report(_FAULT, f"cannot be read, the last known ones stay in force: {error}", Level.WARN)
            return
        self._faults.clear(_FAULT)
        with self._lock:
            # Otherwise they have changed meanwhile; the next time shows it.
            if version == self._version and silences != list(self._active):
                self._set_active(silences, now_s)

    def _limit(self, silences: Sequence[Silence], now_s: float) -> None:
        """Limits silences that were made in the future to their duration, with one line."""
        in_future = [each for each in silences if each.is_in_future(now_s)]
        if any(each.noticed_s is None or each.noticed_s > now_s or not each.is_active(now_s) for each in in_future):
            noticed = self._change(limit_to_durations)
            if noticed:
                self._faults.report(_CLOCK_FAULT, _limit_text(noticed, now_s), Level.WARN)
        if not any(each.is_active(now_s) for each in in_future):
            self._faults.clear(_CLOCK_FAULT)

    def _change(self, change: Callable[[sqlite3.Connection, float], Changed]) -> Changed:
        """Changes the stored silences in a transaction, with the present time in s since 1970."""
        now_s = self._wall_time_s()

        def change_and_read(connection: sqlite3.Connection) -> Changed:
            changed = change(connection, now_s)
            self._take_over(connection)
            return changed

        return self._history.run(change_and_read, _TIMEOUT_S)

    def _take_over(self, connection: sqlite3.Connection) -> None:
        """Reads the silences. Call in a transaction of the history."""
        now_s = self._wall_time_s()
        silences = read_silences(connection, active_at_s=now_s)
        with self._lock:
            self._version += 1
            self._set_active(silences, now_s)

    def _set_active(self, silences: Sequence[Silence], now_s: float) -> None:
        """Call with the lock held."""
        self._active = tuple(silence for silence in silences if silence.is_active(now_s))
        self._found = {}
        ends = [silence.seen_at(now_s).until_s for silence in self._active]
        self._next_end_s = min((end_s for end_s in ends if end_s is not None), default=float("inf"))

    def _note_transition(
        self, connection: sqlite3.Connection, number: int, transition: Transition, wall_s: float
    ) -> None:
        """Ends silences whose last alert has resolved; runs in the transaction that stores the transition."""
        if transition.to_level is not Level.OK:
            return
        alert = printable(transition.robot), printable(transition.signal)
        if not resolve_alert(connection, alert, wall_s):
            return
        with self._lock:
            self._version += 1
            self._set_active([_without(silence, alert, wall_s) for silence in self._active], self._wall_time_s())


def _limit_text(silences: Sequence[Silence], now_s: float) -> str:
    first = silences[0]
    for_s = (first.until_s or first.created_s) - first.created_s
    text = f"silence {first.id} was made at {time_text(first.created_s)}, which is in the future"
    text += f"; it ends in {duration_text(for_s)}, at {time_text(now_s + for_s)}"
    if len(silences) > 1:
        text += f"; so do {count_text(len(silences) - 1, 'more silence')}, each after its duration"
    return text


def _end_order(silence: Silence) -> float:
    return float("inf") if silence.until_s is None else silence.until_s


def _without(silence: Silence, alert: Alert, now_s: float) -> Silence:
    if silence.alerts is None:
        return silence
    alerts = silence.alerts - {alert}
    return replace(silence, alerts=alerts, ended_s=silence.ended_s if alerts else now_s)
