"""The silences of a running monitor: a copy of those in the history, which others may change at any time."""

from __future__ import annotations

import math
from functools import lru_cache
from sqlite3 import Connection
from typing import Any, Callable, Mapping, Sequence, TypeVar

from ...core.values import Level, ServiceError, Transition, printable
from .history import History
from .matchers import Matcher
from .silences import Silence, add_silence, expire_silence, read_silences

Changed = TypeVar("Changed")

_MOST_CACHED = 20_000
_TIMEOUT_S = 2.0
_FAULT = "silence list"
_RESOLVED = "its alerts are resolved"


class Silences:
    """The silences of a running monitor: an in-memory copy, which follows the history file within about a second.

    All methods but `look` may be called from any thread.
    """

    def __init__(self, history: History) -> None:
        """Reads the silences; from then on, the writer of the history looks each second whether others changed them.

        Those that are known stay in force if a new database is begun.
        """
        self._history = history
        self._faults = history.faults
        self._wall_time_s = history.wall_s
        self._stored: Sequence[Silence] = ()
        """Those that had not ended when they were read last, each second."""
        self._covering: Callable[[str, str], Sequence[Silence]] = lambda robot, signal: ()
        """Returns those of `_stored` that apply to an alert."""
        self._causes: dict[str, Mapping[str, str]] = {}
        history.on_record.append(self._note_transition)
        history.on_second.append(self.look)
        try:
            history.run(self.look, _TIMEOUT_S)
        except ServiceError as error:
            self._faults.report(_FAULT, f"cannot be read: {error}", Level.WARN)

    def note_causes(self, robot: str, causes: Mapping[str, str]) -> None:
        """Replaces what the signals of a robot suffer from now, by signal: a cause is silenced with its effects."""
        self._causes[robot] = causes

    def silence_of(self, robot: str, signal: str) -> Silence | None:
        """Returns the silence of an alert, else of its cause, or None; of several the one that ends last."""
        silence, causes, seen = self._silence_of(robot, signal), self._causes.get(robot, {}), {signal}
        while silence is None and causes.get(signal, signal) not in seen:
            signal = causes[signal]
            seen.add(signal)
            silence = self._silence_of(robot, signal)
        return silence

    def _silence_of(self, robot: str, signal: str) -> Silence | None:
        if not self._stored:
            return None
        now_s = self._wall_time_s()
        in_force = [each for each in self._covering(printable(robot), printable(signal)) if each.in_force(now_s)]
        return max(in_force, key=lambda each: math.inf if each.until_s is None else each.until_s, default=None)

    def active(self) -> list[Silence]:
        """Returns the active silences, oldest first; those that recur need not be in force."""
        now_s = self._wall_time_s()
        return [silence for silence in self._stored if silence.is_active(now_s)]

    def look(self, connection: Connection) -> None:
        """Reads the silences, which another process may have changed, and ends those whose alerts have all resolved.

        Call before a notification is sent.

        Call with the history's connection inside a transaction, in which another process cannot add a silence.
        """
        now_s = self._wall_time_s()
        silences = read_silences(connection, active_at_s=now_s)
        for each in [each for each in silences if each.until_resolved and not each.alerts]:
            expire_silence(connection, each.id, now_s, reason=_RESOLVED)
            silences.remove(each)
        if silences != self._stored:
            self._stored = silences
            self._covering = lru_cache(_MOST_CACHED)(lambda *alert: [each for each in silences if each.covers(*alert)])
        self._faults.clear(_FAULT)

    def add(self, matchers: Sequence[Matcher], **options: Any) -> Silence:
        """Adds a silence, as `add_silence`; a ServiceError says that the history failed or did not answer."""
        return self._change(lambda connection, now_s: add_silence(connection, matchers, now_s, **options))

    def expire(self, number: int, **texts: str) -> Silence:
        """Ends a silence, as `expire_silence`; a ServiceError says that the history failed or did not answer."""
        return self._change(lambda connection, now_s: expire_silence(connection, number, now_s, **texts))

    def _change(self, change: Callable[[Connection, float], Changed]) -> Changed:
        """Changes the stored silences in a transaction, with the present time in s since 1970."""
        now_s = self._wall_time_s()

        def change_and_read(connection: Connection) -> Changed:
            changed = change(connection, now_s)
            self.look(connection)
            return changed

        return self._history.run(change_and_read, _TIMEOUT_S)

    def _note_transition(self, connection: Connection, alert_id: int, transition: Transition, wall_s: float) -> None:
        """Ends silences whose last alert has resolved; runs in the transaction that stores the transition."""
        if transition.to_level is Level.OK and any(each.until_resolved for each in self._stored):
            self.look(connection)
