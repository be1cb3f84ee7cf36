"""Writes the state of one signal as plain JSON values, and reads them, none of which can be trusted.

`Monitor.snapshot` writes it and `Monitor.restore` reads it. It comes from a file, so it may be of any form.
"""

from __future__ import annotations

import copy
import enum
import sys
from typing import Any, Callable, Mapping, NamedTuple, TypeVar

from ..values import JsonObject, MessageError, datum_text

Kind = TypeVar("Kind", bound=enum.Enum)

SavedSignal = JsonObject
"""State of one signal: numbers, texts, booleans, None and mappings of them. Empty if the signal is not
watched any more.

Durations are in seconds. Times are in seconds since 1970, all of them in the mapping `since` and the list `storm`.
"""

LONGEST_S = 1e10
"""Longer durations and ages are cut to this: 300 years."""


class Downtime(NamedTuple):
    """The time between two runs of the monitor, in seconds since 1970."""

    begin_s: float
    """When the earlier run was last known to watch the robot."""
    end_s: float
    """When this run continues from its states."""


class UnusableStateError(MessageError):
    """A saved state has an unexpected form; `str()` names the key and what was found."""


class SavedState:
    """A mapping of a state that is being written, or was saved.

    Whatever has a state passes it through these methods, in one function for both directions: each takes a value and
    returns the one that counts from then on, which is the same, or what was saved. False and None are not written.
    """

    def __init__(self, now_s: float, values: object, downtime: Downtime | None = None, ahead_s: float = 0.0) -> None:
        """Opens a mapping.

        Args:
            now_s: the time of the calls, in seconds.
            values: where to write, or what was saved; raises UnusableStateError if that is no mapping.
            downtime: the time since it was saved; None to write.
            ahead_s: the time in seconds since 1970 minus `now_s`, to write.
        """
        self.now_s = now_s
        self._downtime = downtime
        self._ahead_s = ahead_s
        self._path = ""
        self.values = _mapping(values, "state")

    @property
    def is_saved(self) -> bool:
        """Whether it was saved: what is not of the expected form raises UnusableStateError."""
        return self._downtime is not None

    def section(self, key: str) -> SavedState:
        """Returns a nested mapping, empty if it is missing."""
        below = copy.copy(self)
        below._path = f"{self._path}{key}."
        nested = self.values.get(key, {}) if self.is_saved else self.values.setdefault(key, {})
        below.values = _mapping(nested, self._path + key)
        return below

    def _pass(self, key: str, value: Any, is_allowed: Callable[[Any], bool], expected: str) -> Any:
        if not self.is_saved:
            if value is not None:
                self.values[key] = value
            return value
        saved = self.values.get(key)
        if saved is not None and not is_allowed(saved):
            raise UnusableStateError(f"{self._path}{key}: expected {expected}, got {datum_text(saved)}")
        return saved

    def flag(self, key: str, value: bool = False) -> bool:
        """Passes true or false; false if it is missing."""
        return bool(self._pass(key, value or None, lambda saved: isinstance(saved, bool), "true or false"))

    def text(self, key: str, value: str = "") -> str:
        """Passes a text; empty if it is missing."""
        return self._pass(key, value or None, lambda saved: isinstance(saved, str), "a text") or ""

    def number(self, key: str, value: float | None = None) -> float | None:
        """Passes a finite number; None if it is missing."""
        passed = self._pass(key, value, _is_finite, "a finite number")
        return None if passed is None else float(passed)

    def waited_s(self, key: str, value_s: float = 0.0) -> float:
        """Passes a duration in which nothing counts while nothing watches; 0 if it is missing or negative."""
        return min(max(0.0, self.number(key, value_s or None) or 0.0), LONGEST_S)

    def member(self, key: str, kind: type[Kind], value: Kind | None = None) -> Kind | None:
        """Passes a member of an enumeration, by its name; None if it is missing."""
        names = kind.__members__
        name = None if value is None else value.name
        name = self._pass(key, name, lambda saved: saved in list(names), f"one of {', '.join(names)}")
        return None if name is None else kind[name]

    def since_s(self, key: str, value_s: float | None = None) -> float:
        """Passes when something began, by the time of the calls; now if it is missing, or lies ahead."""
        saved_s = self.section("since").number(key, None if value_s is None else value_s + self._ahead_s)
        if self._downtime is not None:
            value_s = None if saved_s is None else self._at_s(saved_s)
        return self.now_s if value_s is None else value_s

    def times_s(self, key: str, values_s: list[float], most: int) -> list[float]:
        """Passes times of the calls in their order, at most so many; none if they are missing."""
        ahead_s = [time_s + self._ahead_s for time_s in values_s]
        saved_s = self._pass(key, ahead_s or None, _are_finite, "a list of finite numbers") or ()
        return sorted(map(self._at_s, saved_s[:most])) if self.is_saved else values_s

    @property
    def unwatched_since_s(self) -> float:
        """Since when nothing watched, by the time of the calls."""
        return self.now_s if self._downtime is None else self._at_s(self._downtime.begin_s)

    def _at_s(self, saved_s: float) -> float:
        ago_s = 0.0 if self._downtime is None else self._downtime.end_s - saved_s
        return self.now_s - min(max(0.0, ago_s), LONGEST_S)


def _mapping(values: object, path: str) -> Any:
    if not isinstance(values, Mapping):
        raise UnusableStateError(f"{path}: expected a mapping, got {datum_text(values)}")
    return values


def _is_finite(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max


def _are_finite(value: object) -> bool:
    return isinstance(value, list) and all(map(_is_finite, value))
