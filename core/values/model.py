"""The values that travel through the monitor: samples in, transitions and reports out.

Everything here is frozen. Nothing here knows a middleware, a clock or a file.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any, Callable, Dict, Iterable, List, Mapping, NamedTuple, NoReturn, TypeVar

Value = TypeVar("Value")

JsonObject = Mapping[str, Any]
"""An object as JSON and YAML have them: a section of a file, the arguments of a request."""

Message = JsonObject
"""A message, request or response of a middleware in rosbridge's form."""

Clock = Callable[[], float]
"""Returns a time in seconds: since 1970 where its name says `wall`, else since an arbitrary moment."""


class FrozenDict(Dict[str, Value]):
    """A read-only dict; unlike `MappingProxyType` it can be copied, pickled and written as JSON."""

    def _refuse(self, *args: Any, **kwargs: Any) -> NoReturn:
        raise TypeError("this mapping cannot be changed")

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse

    def __reduce__(self) -> Any:
        return FrozenDict, (dict(self),)


class Level(enum.IntEnum):
    """Health of a signal; the numbers are the wire values of diagnostic_msgs/DiagnosticStatus (REP-107)."""

    OK = 0
    """No rule is firing."""
    WARN = 1
    """Needs attention."""
    ERROR = 2
    """Out of its limits, or the data is invalid."""
    STALE = 3
    """No sample for too long, or the level is unknown."""

    @property
    def severity(self) -> int:
        """Rank for "the worst of": OK < WARN < STALE < ERROR. Not the wire value."""
        return _SEVERITY[self]

    @staticmethod
    def worst(levels: Iterable[Level]) -> Level:
        """Returns the most severe of `levels`, OK when there are none."""
        return max(levels, key=_SEVERITY.__getitem__, default=Level.OK)


_SEVERITY = {Level.OK: 0, Level.WARN: 1, Level.STALE: 2, Level.ERROR: 3}


class Sample(NamedTuple):
    """One measurement of one signal.

    A named tuple, because one is created per message: a frozen dataclass takes three times as long.
    """

    signal: str
    """Name of the signal, as in the configuration."""
    value: object
    """The number as received; anything but a finite real number is bad data."""
    now_s: float
    """When it arrived, in seconds on the adapter's clock (monotonic, or ROS time under use_sim_time)."""


class Forecast(NamedTuple):
    """A forecast of a signal, and the line that gave it."""

    value: float
    """Value at the horizon, in the unit of the signal."""
    slope_per_s: float
    """Slope of the line, in the unit per second."""
    forecast_s: float
    """Time from the newest sample to the horizon, in s."""
    time_to_bound_s: float | None
    """Time from the newest sample until the line reaches the nearest bound that lies ahead, in s; None if that takes
    longer than 10 times `forecast_s`."""
    bound: float | None
    """That bound; None if there is none."""


@dataclass(frozen=True)
class Status:
    """The state of one signal, shaped as diagnostic_msgs/DiagnosticStatus."""

    name: str
    """Name of the signal."""
    level: Level
    """The true level now, also while the signal flaps; STALE while it is unknown."""
    message: str
    """The reason for the level, in a few words."""
    hardware_id: str
    """The robot's name."""
    values: Mapping[str, str] = field(hash=False)
    """Key-values; see docs/rules.md."""
    hint: str = field(default="", compare=False)
    """Why there are no samples, as far as the middleware knows, or why the statistic is questionable; empty if
    nothing is known. Not part of `message`."""
    state: str = field(default="", compare=False)
    """One of `explanation.STATES`; empty for the status of a node."""
    lasts_s: float = field(default=0.0, compare=False)
    """How long the level has lasted, in seconds."""
    forecast: Forecast | None = field(default=None, compare=False)
    """None if the statistic is not `forecast` or is undefined, or if the latest value is not known."""
    outlook: str = field(default="", compare=False)
    """When the forecast reaches the nearest bound ahead: `reaches 20 % in 24 min`; empty if it reaches none, or if
    that is not known now."""
    silence: str | None = field(default=None, compare=False)
    """Reason and end of the silence of the signal; None if it is not silenced."""
    cause: str = field(default="", compare=False)
    """Name of the alert that keeps everything worse than the announced level from being announced; empty if none
    does."""
    affects: int = field(default=0, compare=False)
    """How many signals are worse than announced because of this one, directly or not."""
    what_to_do: str = field(default="", compare=False)
    """What to do when it alerts, as configured: one line, or the address of a page."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", FrozenDict(self.values))


@dataclass(frozen=True)
class Transition:
    """One change of a signal's announced level. `str()` gives the line with the time before it."""

    signal: str
    """Name of the signal, as in the configuration."""
    from_level: Level
    """The level announced until now."""
    to_level: Level
    """The level announced from now on; the same as `from_level` only in a repetition (`repeat_s`)."""
    value: object | None
    """Value of the statistic, or the bad datum as received; None before any sample."""
    statistic: str
    """Which statistic of the window `value` is."""
    bound: float | None
    """The configured bound that was crossed, in the signal's unit; None if none was (stale, invalid)."""
    now_s: float
    """When it was decided, in seconds on the adapter's clock."""
    since_s: float
    """Since when `from_level` had been announced, on the same clock: `now_s - since_s` is the time in the text.

    Time that was unknown never counts as OK: the signal was known to be OK for `now_s - since_s`, which is 0 if it was
    never known."""
    robot: str
    """The robot's name, which is also the `hardware_id`."""
    fingerprint: str
    """16 hexadecimal digits that identify robot and signal, the same across restarts and middlewares."""
    text: str
    """The alert line, without the time."""
    status: Status = field(hash=False)
    """The resulting status of the signal."""
    statistics: Mapping[str, float] = field(default_factory=dict, hash=False)
    """The window's defined statistics at that moment, by name."""
    repeat: bool = False
    """True for a repeated announcement (`repeat_s`)."""
    hint: str = field(default="", compare=False)
    """Why there are no samples, as far as the middleware knows; empty if nothing is known. Not part of `text`."""
    cause: str = ""
    """Name of the alert whose effect the signal is now: worse levels are not announced; empty if there is none."""
    affects: int = field(default=0, compare=False)
    """How many signals are worse than announced because of this one now, directly or not."""
    black_box: str = field(default="", compare=False)
    """Name of the file that records it; empty if none does."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "statistics", FrozenDict(self.statistics))

    def __str__(self) -> str:
        return f"{self.now_s:.3f} {self.text}"


class Changes(List[Transition]):
    """The transitions that one call caused, and notices for the log."""

    notices: tuple[str, ...] = ()
    """INFO lines, for example that time went back."""

    def add(self, transition: Transition | None) -> None:
        """Appends a transition; nothing for None."""
        if transition is not None:
            self.append(transition)


@dataclass(frozen=True)
class Report:
    """The whole state at one moment."""

    overall: Level
    """The worst level of all signals."""
    statuses: Mapping[str, Status]
    """One status per signal, in the order of the configuration."""
    now_s: float
    """When, in seconds on the adapter's clock."""
    robot: str
    """The robot's name."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "statuses", FrozenDict(self.statuses))
