"""Metrics for Prometheus, in prometheus_client's exposition. docs/reference/api.md lists them.

The library is imported at the first scrape: on small robots it takes memory.
"""

from __future__ import annotations

import threading
import time
from itertools import chain
from types import SimpleNamespace
from typing import Callable, Counter, Dict, Mapping, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.explanation import Judgement
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.version import package_version

METRICS_LIBRARY = "prometheus_client"
_BY_SIGNAL = ("robot", "signal")

FULL, FLEET = "full", "fleet"
PROFILES = (FULL, FLEET)
"""What a scrape contains: every metric, or what the exported rules of a fleet need."""

_MOST_COUNTED = 20_000
"""With more signals, the counters of elements that are no longer watched are dropped."""

_Series = Tuple[Tuple[Sequence[str], float], ...]  # values of the labels, and the value of the metric
_Kept = Dict[Tuple[Callable[..., _Series], str], Tuple[_Series, bytes]]
"""The latest lines of series that rarely change, by their function and robot."""


class Family(NamedTuple):
    """One metric."""

    name: str
    help: str
    labels: Sequence[str] = ()
    counts: bool = False  # a counter: the exposition appends `_total` to its name


_LEVEL = Family("robot_health_level", "Level of the signal: 0 OK, 1 WARN, 2 ERROR, 3 STALE or unknown.", _BY_SIGNAL)
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

    robot: str  # printable
    signals: Mapping[str, Judgement]
    transitions: Mapping[str, Counter[Level]]  # the announced changes of each signal, by the new level
    link_up: Optional[bool]  # None: it is not watched over a link
    tick_s: float  # the last tick, in s since 1970


class Metrics:
    """Counts transitions, reads robots and renders what was read."""

    def __init__(
        self,
        notifications_waiting: Callable[[], int] = int,
        wall_time_s: Callable[[], float] = time.time,
        count_faults: Callable[[], int] = int,
    ) -> None:
        """Starts with empty counters; asks how many notifications wait, and how many parts do not work, when needed."""
        self._notifications_waiting = notifications_waiting
        self._count_faults = count_faults
        self._wall_time_s = wall_time_s
        self._lock = threading.Lock()
        self._transitions: Dict[Tuple[str, str], Counter[Level]] = {}
        self._kept: Dict[str, _Kept] = {}  # by profile

    def counter(self, robot: str) -> Callable[[Transition], None]:
        """Returns the function that counts a transition of a robot. It may be called in any thread."""

        def count(transition: Transition) -> None:
            if not transition.repeat:
                with self._lock:
                    while len(self._transitions) > 2 * _MOST_COUNTED:  # nobody scrapes
                        del self._transitions[next(iter(self._transitions))]
                    self._transitions.setdefault((robot, transition.signal), Counter())[transition.to_level] += 1

        return count

    def read(self, alert_system: AlertSystem) -> RobotMetrics:
        """Reads a robot. May be called in any thread."""
        robot = alert_system.robot
        signals, link_up = alert_system.read(lambda monitor, now_s: (monitor.judgements(now_s), monitor.link_up))
        with self._lock:
            transitions = {name: Counter(self._transitions.get((robot, name), ())) for name in signals}
            if len(self._transitions) > _MOST_COUNTED:
                ended = [key for key in self._transitions if key[0] == robot and key[1] not in signals]
                for key in ended:
                    del self._transitions[key]
        tick_s = self._wall_time_s() - alert_system.tick_age_s
        return RobotMetrics(printable(robot), signals, transitions, link_up, tick_s)

    def render(self, robots: Sequence[RobotMetrics], profile: str = FULL) -> Tuple[bytes, str]:
        """Returns the exposition and its content type; raises ImportError if prometheus_client cannot be imported.

        The profile `fleet` has only what the exported rules need.
        """
        from prometheus_client import CONTENT_TYPE_LATEST

        before, parts = self._kept.get(profile, {}), []
        after: _Kept = {}
        for family, *groups in _OF_ROBOTS:
            if profile == FLEET and family in _NOT_IN_RULES:
                continue
            parts.append(_exposition(family, ()))
            for series_of, rarely_change in groups:
                if not rarely_change:
                    parts.append(_lines(family, tuple(chain.from_iterable(map(series_of, robots)))))
                    continue
                for robot in robots:
                    key, series = (series_of, robot.robot), series_of(robot)
                    known = before.get(key)
                    after[key] = known if known and known[0] == series else (series, _lines(family, series))
                    parts.append(after[key][1])
        self._kept[profile] = after
        if profile == FLEET:
            ticks = tuple(((robot.robot,), robot.tick_s) for robot in robots)
            return b"".join([*parts, _exposition(_ROBOTS_LAST_TICK, ticks)]), CONTENT_TYPE_LATEST
        oldest_tick_s = min((robot.tick_s for robot in robots), default=self._wall_time_s())
        parts += [
            _exposition(_WAITING, (((), self._notifications_waiting()),)),
            _exposition(_FAULTS, (((), self._count_faults()),)),
            _exposition(_LAST_TICK, (((), oldest_tick_s),)),
            _exposition(_BUILD_INFO, (((package_version(),), 1.0),)),
        ]
        return b"".join(parts), CONTENT_TYPE_LATEST


def _of_signals(value_of: Callable[[Judgement], Optional[float]], *labels: str) -> Callable[[RobotMetrics], _Series]:
    """Returns the function for the series of a robot's signals; a signal whose value is None has none."""

    def series_of(robot: RobotMetrics) -> _Series:
        values = ((name, value_of(judgement)) for name, judgement in robot.signals.items())
        return tuple(((robot.robot, name, *labels), value) for name, value in values if value is not None)

    return series_of


def _latest(signal: Judgement) -> Optional[float]:
    return None if signal.config.statistic == "last" else signal.latest_good


def _time_to_bound_s(signal: Judgement) -> Optional[float]:
    return None if signal.forecast is None else signal.forecast.time_to_bound_s


def _transitions(robot: RobotMetrics) -> _Series:
    """Returns the counters. All exist from the start: Prometheus sees no increase from nothing to 1."""
    return tuple(
        ((robot.robot, name, level.name), count[level]) for name, count in robot.transitions.items() for level in Level
    )


def _link_up(robot: RobotMetrics) -> _Series:
    return () if robot.link_up is None else (((robot.robot,), robot.link_up),)


_OF_ROBOTS = (
    (_LEVEL, (_of_signals(lambda signal: signal.level), True)),
    (_VALUE, (_of_signals(lambda signal: signal.judged), False)),
    (_LATEST, (_of_signals(_latest), False)),
    (_TIME_TO_BOUND, (_of_signals(_time_to_bound_s), False)),
    (_VALID, (_of_signals(lambda signal: not signal.is_bad if signal.seen else None), True)),
    (
        _SAMPLES,
        (_of_signals(lambda signal: signal.good_samples, "good"), False),
        (_of_signals(lambda signal: signal.bad_samples, "bad"), True),
    ),
    (_TRANSITIONS, (_transitions, True)),
    (_LINK_UP, (_link_up, True)),
)
"""The metrics of robots: functions that return their series, and whether these rarely change."""
_NOT_IN_RULES = (_TIME_TO_BOUND, _TRANSITIONS)


def _lines(family: Family, series: _Series) -> bytes:
    """Returns the lines of series, without HELP and TYPE."""
    return _exposition(family, series).split(b"\n", 2)[2]


def _exposition(family: Family, series: _Series) -> bytes:
    from prometheus_client import generate_latest
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    kind = CounterMetricFamily if family.counts else GaugeMetricFamily
    metric = kind(family.name, family.help, labels=family.labels)
    for labels, value in series:
        metric.add_metric(labels, value)
    return generate_latest(SimpleNamespace(collect=lambda: [metric]))  # a collector whose metric is ready
