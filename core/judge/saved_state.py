"""Reads the saved state of one signal: plain JSON values, none of which can be trusted.

`Monitor.snapshot` writes it and `Monitor.restore` reads it. It comes from a file, so it may be of any form.
"""

from __future__ import annotations

import sys
from typing import Any, List, Mapping, NamedTuple, Optional

from ..values.errors import MessageError
from ..values.formatting import datum_text
from ..values.model import Level

SavedSignal = Mapping[str, Any]
"""State of one signal: numbers, texts, booleans, None and mappings of them. Empty: the signal is no longer watched.

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


class Saved:
    """Reads one mapping of a saved state; missing keys are their defaults.

    `path` is the dotted path of its keys. What is not of the expected form raises UnusableStateError.
    """

    def __init__(self, values: object, path: str = "") -> None:
        """Opens a mapping."""
        if not isinstance(values, Mapping):
            raise UnusableStateError(f"{path or 'state'}: expected a mapping, got {datum_text(values)}")
        self._values = values
        self._path = path

    def section(self, key: str) -> Saved:
        """Returns a nested mapping, empty if it is missing."""
        return Saved(self._values.get(key, {}), self._name(key))

    def has(self, key: str) -> bool:
        """Whether a key is there."""
        return key in self._values

    def flag(self, key: str) -> bool:
        """Returns true or false; false if it is missing."""
        value = self._values.get(key, False)
        if not isinstance(value, bool):
            raise self._unexpected(key, "true or false")
        return value

    def text(self, key: str, default: str = "") -> str:
        """Returns a text."""
        value = self._values.get(key, default)
        if not isinstance(value, str):
            raise self._unexpected(key, "a text")
        return value

    def number(self, key: str) -> Optional[float]:
        """Returns a finite number, None if it is missing or null."""
        value = self._values.get(key)
        if value is None:
            return None
        if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= sys.float_info.max:
            return float(value)
        raise self._unexpected(key, "a finite number")

    def numbers(self, key: str, most: int) -> List[float]:
        """Returns the finite numbers of a list, at most so many; none if it is missing."""
        values = self._values.get(key, [])
        if not isinstance(values, list):
            raise self._unexpected(key, "a list")
        return [Saved({key: each}, self._path).number(key) or 0.0 for each in values[:most]]

    def duration_s(self, key: str) -> float:
        """Returns a duration in seconds, 0 if it is missing or negative."""
        return min(max(0.0, self.number(key) or 0.0), LONGEST_S)

    def level(self, key: str) -> Level:
        """Returns a level by its name; OK if it is missing."""
        name = self.text(key, Level.OK.name)
        if name not in Level.__members__:
            raise self._unexpected(key, "a level")
        return Level[name]

    def _unexpected(self, key: str, expected: str) -> UnusableStateError:
        found = datum_text(self._values.get(key))
        return UnusableStateError(f"{self._name(key)}: expected {expected}, got {found}")

    def _name(self, key: str) -> str:
        return f"{self._path}.{key}" if self._path else key


def without_latch(state: SavedSignal) -> SavedSignal:
    """Returns a state whose latch is cleared; anything but a mapping unchanged."""
    return {key: value for key, value in state.items() if key != "latched"} if isinstance(state, Mapping) else state


def age_s(since: Optional[float], wall_s: float) -> float:
    """Returns how long ago a saved time was, in s; both are since 1970. 0 for None, or if the clock went back."""
    return 0.0 if since is None else min(max(0.0, wall_s - since), LONGEST_S)
