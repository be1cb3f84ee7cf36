"""Writes the state of one signal as plain JSON values, and reads them, none of which can be trusted.

`Monitor.snapshot` writes it and `Monitor.restore` reads it. It comes from a file, so it may be of any form.
"""

from __future__ import annotations

import copy
import enum
import sys
from typing import Any, Mapping, NamedTuple

from ..values import JsonObject, MessageError, datum_text

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
    returns the one that counts from then on, which is the same, or what was saved.
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

    def value(self, key: str, value: Any, default: Any) -> Any:
        """Passes a value of the kind of its default, which is not written, and returned if it is missing.

        A type as the default allows values of this type, and None if it is missing. Raises UnusableStateError.
        """
        is_optional = isinstance(default, type)
        kind, missing = (default, None) if is_optional else (type(default), default)
        is_member = issubclass(kind, enum.Enum)
        if not self.is_saved:
            if value != missing:
                self.values[key] = value.name if is_member else value
            return value
        saved = self.values.get(key)
        if saved is None:
            return missing
        if is_member and saved in list(kind.__members__):
            return kind[saved]
        if _is_finite(saved) if kind is float else type(saved) is kind:
            return kind(saved)
        raise UnusableStateError(f"{self._path}{key}: expected a {kind.__name__.lower()}, got {datum_text(saved)}")

    def fields(self, owner: object, **defaults: Any) -> None:
        """Passes attributes of an object, each as `value` with its default."""
        for name, default in defaults.items():
            setattr(owner, name, self.value(name.lstrip("_"), getattr(owner, name), default))

    def waited_s(self, key: str, value_s: float = 0.0) -> float:
        """Passes a duration in which nothing counts while nothing watches; 0 if it is missing or negative."""
        return min(max(0.0, float(self.value(key, value_s, 0.0))), LONGEST_S)

    def since_s(self, key: str, value_s: float | None = None) -> float:
        """Passes when something began, by the time of the calls; now if it is missing, or lies ahead."""
        saved_s = self.section("since").value(key, None if value_s is None else value_s + self._ahead_s, float)
        if self._downtime is not None:
            value_s = None if saved_s is None else self._at_s(saved_s)
        return self.now_s if value_s is None else value_s

    def times_s(self, key: str, values_s: list[float], most: int) -> list[float]:
        """Passes times of the calls in their order, at most so many; none if they are missing."""
        saved_s = self.value(key, [time_s + self._ahead_s for time_s in values_s], [])
        return sorted(map(self._at_s, filter(_is_finite, saved_s[:most]))) if self.is_saved else values_s

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
