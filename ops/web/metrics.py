"""Metrics for Prometheus, in its text format. docs/reference/metrics.md lists them.

A client library would render them as a whole: of a thousand robots, 10 MB at a time.
https://prometheus.io/docs/instrumenting/exposition_formats/
"""

from __future__ import annotations

import threading
import time
from typing import Callable, Counter, Iterator, Mapping, NamedTuple, Sequence

from ...core.judge.wording import Judgement
from ...core.nodes import AlertSystem
from ...core.values import Clock, Level, Transition, package_version, printable

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_BY_SIGNAL = ("robot", "signal")

FULL, FLEET = "full", "fleet"
PROFILES = (FULL, FLEET)
"""What a scrape contains: every metric, or what the exported rules and the dashboard of a fleet need."""

_MOST_COUNTED = 20_000
"""With more signals, the counters of elements that are no longer watched are dropped."""

_ROBOTS_AT_ONCE = 200  # whose lines are rendered at a time


class Family(NamedTuple):
    """One metric."""

    name: str
    help: str
    labels: Sequence[str] = ()
    counts: bool = False  # a counter, whose name in the exposition ends with `_total`


_LEVEL = Family("robot_health_level", "Level of the signal: 0 OK, 1 WARN, 2 ERROR, 3 STALE or unknown.", _BY_SIGNAL)
_ALERT_LEVEL = Family(
    "robot_health_alert_level",
    "Level that was announced last: 0 OK, 1 WARN, 2 ERROR, 3 STALE. Unlike robot_health_level it waits, flaps and has "
    "causes as alerts do.",
    _BY_SIGNAL,
)
_CAUSED = Family("robot_health_caused", "1 while the signal is the effect of another alert, else absent.", _BY_SIGNAL)
_AFFECTS = Family(
    "robot_health_affects", "Signals that are worse than announced because of this one; absent without any.", _BY_SIGNAL
)
_VALUE = Family(
    "robot_health_value",
    "Last value of the signal's statistic, to which its bounds apply, in its unit; absent while undefined.",
    _BY_SIGNAL,
)
_LATEST = Family(
    "robot_health_latest",
    "Latest valid value of a signal whose statistic is not `last`, in its unit; absent while its data is invalid, "
    "stale or unreachable.",
    _BY_SIGNAL,
)
_TIME_TO_BOUND = Family(
    "robot_health_time_to_bound_seconds",
    "Time from the newest sample until the line of a forecast reaches the nearest bound ahead; absent while there is "
    "none, and like robot_health_latest.",
    _BY_SIGNAL,
)
_VALID = Family("robot_health_data_valid", "Whether the latest sample of the signal is valid.", _BY_SIGNAL)
_SAMPLES = Family("robot_health_samples", "Samples of the signal.", (*_BY_SIGNAL, "quality"), counts=True)
_TRANSITIONS = Family(
    "robot_health_transitions", "Announced changes of the signal's level.", (*_BY_SIGNAL, "to"), counts=True
)
_LINK_UP = Family("robot_health_link_up", "Whether the robot can be reached.", ("robot",))
_WAITING = Family("robot_health_notifications_waiting", "Notifications that are not delivered yet.")
_FAULTS = Family("robot_health_faults", "Parts of the monitor itself that do not work.")
_LAST_TICK = Family(
    "robot_health_last_tick_timestamp_seconds",
    "Last tick of the monitor, in seconds since 1970; of several robots the oldest.",
)
_ROBOTS_LAST_TICK = Family(
    _LAST_TICK.name,
    "Last tick of the robot's monitor, in seconds since 1970; in the profile `fleet`, instead of the oldest.",
    ("robot",),
)
_BUILD_INFO = Family("robot_health_build_info", "Version of the monitor.", ("version",))


class RobotMetrics(NamedTuple):
    """The figures of one robot at one moment."""

    labels: str  # of its series, without those of a signal
    signals: Mapping[str, Sequence[float | None]]  # by labels: the values in the order of `_OF_SIGNALS`
    link_up: bool | None  # None if it is not watched over a link
    tick_s: float  # the last tick, in s since 1970


class Metrics:
    """Counts transitions, reads robots and renders what was read."""

    def __init__(
        self,
        notifications_waiting: Callable[[], int] = int,
        wall_time_s: Clock = time.time,
        count_faults: Callable[[], int] = int,
    ) -> None:
        """Starts with empty counters; asks how many notifications wait, and how many parts do not work, when needed."""
        self._notifications_waiting = notifications_waiting
        self._count_faults = count_faults
        self._wall_time_s = wall_time_s
        self._lock = threading.Lock()
        self._transitions: dict[tuple[str, str], Counter[Level]] = {}

    def count(self, robot: str, transition: Transition) -> None:
        """Counts a transition of a robot. May be called in any thread."""
        if not transition.repeat:
            with self._lock:
                while len(self._transitions) > 2 * _MOST_COUNTED:  # nothing scrapes
                    del self._transitions[next(iter(self._transitions))]
                self._transitions.setdefault((robot, transition.signal), Counter())[transition.to_level] += 1

    def read(self, alert_system: AlertSystem) -> RobotMetrics:
        """Reads a robot. May be called in any thread."""
        robot = alert_system.robot
        judgements, link_up = alert_system.read(
            lambda monitor, now_s: ({**monitor.quiet_sources(), **monitor.judgements(now_s)}, monitor.link_up)
        )
        labels = f"robot={_quoted(robot)}"
        signals = {}
        with self._lock:
            for name, judgement in judgements.items():
                count = self._transitions.get((robot, name), _NONE)
                values = (*(value_of(judgement) for _, _, value_of in _OF_SIGNALS), *(count[level] for level in Level))
                signals[f"{labels},signal={_quoted(name)}"] = values
            if len(self._transitions) > _MOST_COUNTED:
                ended = [key for key in self._transitions if key[0] == robot and key[1] not in judgements]
                for key in ended:
                    del self._transitions[key]
        return RobotMetrics(labels, signals, link_up, self._wall_time_s() - alert_system.tick_age_s)

    def render(self, robots: Sequence[RobotMetrics], profile: str = FULL) -> Iterator[bytes]:
        """Yields the parts of the exposition.

        The profile `fleet` has only what the exported rules and the dashboard need.
        """
        columns: dict[Family, list[tuple[int, str]]] = {}
        for place, (family, further, _) in enumerate((*_OF_SIGNALS, *_OF_TRANSITIONS)):
            columns.setdefault(family, []).append((place, further))
        for family, places in columns.items():
            if profile == FULL or family not in _NOT_IN_FLEET:
                yield _head(family)
                for begin in range(0, len(robots), _ROBOTS_AT_ONCE):
                    yield b"".join(
                        _line(family, labels + further, values[place])
                        for robot in robots[begin : begin + _ROBOTS_AT_ONCE]
                        for labels, values in robot.signals.items()
                        for place, further in places
                    )
        yield _head(_LINK_UP) + b"".join(_line(_LINK_UP, robot.labels, robot.link_up) for robot in robots)
        if profile == FLEET:
            ticks = (_line(_ROBOTS_LAST_TICK, robot.labels, robot.tick_s) for robot in robots)
            yield _head(_ROBOTS_LAST_TICK) + b"".join(ticks)
            return
        oldest_tick_s = min((robot.tick_s for robot in robots), default=self._wall_time_s())
        version = f'version="{package_version()}"'
        for family, labels, value in (
            (_WAITING, "", self._notifications_waiting()),
            (_FAULTS, "", self._count_faults()),
            (_LAST_TICK, "", oldest_tick_s),
            (_BUILD_INFO, version, 1.0),
        ):
            yield _head(family) + _line(family, labels, value)


_OF_SIGNALS: Sequence[tuple[Family, str, Callable[[Judgement], float | None]]] = (
    (_LEVEL, "", lambda signal: signal.level),
    (_ALERT_LEVEL, "", lambda signal: signal.announced),
    (_CAUSED, "", lambda signal: 1.0 if signal.cause else None),
    (_AFFECTS, "", lambda signal: signal.affects or None),
    (_VALUE, "", lambda signal: signal.judged),
    (_LATEST, "", lambda signal: None if signal.config.statistic == "last" else signal.latest_good),
    (_TIME_TO_BOUND, "", lambda signal: None if signal.forecast is None else signal.forecast.time_to_bound_s),
    (_VALID, "", lambda signal: not signal.is_bad if signal.seen else None),
    (_SAMPLES, ',quality="good"', lambda signal: signal.good_samples),
    (_SAMPLES, ',quality="bad"', lambda signal: signal.bad_samples),
)
"""The metrics of a signal, with further labels; a value of None is no series."""
_OF_TRANSITIONS = tuple((_TRANSITIONS, f',to="{level.name}"', None) for level in Level)
"""All counters exist from the start: Prometheus sees no increase from nothing to 1."""
_NOT_IN_FLEET = (_CAUSED, _AFFECTS, _TIME_TO_BOUND, _TRANSITIONS)
_NONE: Counter[Level] = Counter()


def _head(family: Family) -> bytes:
    name = _name(family)
    return f"# HELP {name} {family.help}\n# TYPE {name} {'counter' if family.counts else 'gauge'}\n".encode()


def _line(family: Family, labels: str, value: float | None) -> bytes:
    if value is None:
        return b""
    braces = f"{{{labels}}}" if labels else ""
    return f"{_name(family)}{braces} {float(value)!r}\n".encode()


def _name(family: Family) -> str:
    return f"{family.name}_total" if family.counts else family.name


def _quoted(text: str) -> str:
    """Returns the value of a label."""
    escaped = printable(text).replace("\\", r"\\").replace('"', r"\"")
    return f'"{escaped}"'
