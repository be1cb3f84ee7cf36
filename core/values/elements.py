"""What a field brings besides a plain number: the elements of an array, a time stamp, a driver's status, a bad datum.

Getters (`field_path.py`) return these, so that a field means the same on every middleware.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Iterable, List, NamedTuple, Tuple

from .formatting import datum_text

MOST_ELEMENTS = 10_000
"""Largest number of elements of an array that are read; a longer array is invalid data."""

STAMP_LIMIT = 2**32
"""The seconds of a stamp are an unsigned number of 32 bits in ROS 1 and a signed one in ROS 2."""

NAME_ARRAYS = ("name", "names", "joint_names", "interface_names")
"""Fields with the names of the elements of the arrays beside them: `name` in JointState."""

TIME_TYPES = ("time", "builtin_interfaces/Time")
"""Types of stamps: that of ROS 1, and that of ROS 2."""

STATUS_TYPE = "diagnostic_msgs/DiagnosticStatus"
ARRAY_TYPE = "diagnostic_msgs/DiagnosticArray"


OWN_NAMES = ("alert_system: ", "aggregator: ", "battery_sensor: ", "connect: ")
"""How the names of statuses of this package's nodes begin, unless a node was renamed."""
OWN_KEY = "fingerprint"
"""Key of a value in every status of this package's nodes."""
OWN_TOPICS = "published_topics"
"""Key of the topics that a node of this package publishes, separated by commas: nothing proposes to watch these."""


_OLDEST_S = 1e9
"""An age above this, 31 years, is that of a stamp that counts from the start of a machine."""


class BadDatum(str):
    """A datum that is invalid whatever the configuration says; its text is the reason."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


class Stamp(float):
    """A time stamp, in seconds since 1970."""

    __slots__ = ()


class Age(float):
    """Time between a stamp and its arrival, in seconds; negative where the clocks of two machines differ."""

    __slots__ = ()

    @property
    def remark(self) -> str:
        """What an odd age says of the clocks; empty if it is not odd."""
        if self < 0.0:
            return "clocks differ"
        return "the stamp does not count from 1970" if self > _OLDEST_S else ""


class LinkDown(float):
    """The sample 0.0 of the signal `link`: a robot cannot be reached."""

    __slots__ = ("cause",)

    def __new__(cls, cause: str) -> LinkDown:
        """Creates it with the reason, which may be empty."""
        new = super().__new__(cls)
        new.cause = cause
        return new

    cause: str
    """Why it cannot be reached."""


class DriverStatus(NamedTuple):
    """A DiagnosticStatus as a whole. Fields are as received: nothing is judged yet."""

    level: Any
    """0 OK, 1 WARN, 2 ERROR, 3 STALE; anything else is invalid."""
    message: Any

    @property
    def number(self) -> float:
        """The level as a number; NaN if it is none."""
        level = self.level[0] if type(self.level) is bytes and len(self.level) == 1 else self.level
        return float(level) if type(level) is int and 0 <= level <= 3 else math.nan


class Elements(List[Tuple[str, Any]]):
    """Name and value, as received, of each element that a path with `[*]` or a pattern selects."""


NOT_A_NUMBER = BadDatum("a message or a list, not a number")


def is_own_status(name: object, keys: Iterable[object]) -> bool:
    """Returns whether a DiagnosticStatus is one of this package's nodes, by its name and the keys of its values."""
    return (isinstance(name, str) and name.startswith(OWN_NAMES)) or OWN_KEY in keys


def stamp_of(seconds: Any, nanoseconds: Any) -> Stamp | BadDatum:
    """Returns a stamp from its two parts; neither need be a number in JSON.

    >>> stamp_of(1700000000, 500000000)
    1700000000.5
    """
    for part in (seconds, nanoseconds):
        if isinstance(part, bool) or not isinstance(part, (int, float)) or not 0 <= part < STAMP_LIMIT:
            return BadDatum(f"not a time stamp: {datum_text(part)}")
    return Stamp(seconds + nanoseconds / 1e9)


def with_ages(value: Any, stamp_s: Callable[[], float]) -> Any:
    """Returns a value with the age of each stamp in its place; `stamp_s` is that of the middleware."""
    if type(value) is Stamp:
        return _age(value, stamp_s())
    if type(value) is Elements and any(type(each) is Stamp for _, each in value):
        now_s = stamp_s()
        return Elements((name, _age(each, now_s) if type(each) is Stamp else each) for name, each in value)
    return value


def _age(stamp: Stamp, now_s: float) -> Age | BadDatum:
    return Age(now_s - stamp) if stamp else BadDatum("no time stamp")


def too_many(number: int) -> BadDatum:
    """Returns the datum for an array that is too long to be read."""
    return BadDatum(f"{number} elements (limit {MOST_ELEMENTS})")
