"""Metrics for Prometheus, in prometheus_client's exposition. docs/reference/api.md lists them.

The library is imported at the first scrape: on small robots it takes memory.
"""

from __future__ import annotations

import threading
import time
from typing import Any, Callable, Counter, Dict, List, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.version import package_version

__all__ = ["METRICS_LIBRARY", "Family", "Metrics", "RobotMetrics", "SignalMetrics"]

METRICS_LIBRARY = "prometheus_client"
_BY_SIGNAL = ("robot", "signal")

_Series = Tuple[Tuple[Sequence[str], float], ...]
"""Values of the labels, and the value of the metric."""
_Kept = Dict[Tuple[str, str], Tuple[_Series, bytes]]
"""By part of the exposition and robot."""


class Family(NamedTuple):
    """One metric."""

    name: str
    help: str
    labels: Sequence[str] = ()
    counts: bool = False
    """Whether it is a counter; the exposition appends `_total` to its name."""


_LEVEL = Family("robot_health_level", "Level of the signal: 0 OK, 1 WARN, 2 ERROR, 3 STALE or unknown.", _BY_SIGNAL)
_VALUE = Family(
    "robot_health_value",
    "Last value of the signal's statistic, to which its bounds apply, in its unit; absent while undefined.",
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
_BUILD_INFO = Family("robot_health_build_info", "Version of the monitor.", ("version",))


class SignalMetrics(NamedTuple):
    """The figures of one signal."""

    name: str
    level: Level
    value: Optional[float]
    """The value that the bounds apply to, the last one while none comes; None while it is undefined."""
    valid: Optional[bool]
    """Whether the latest sample is valid; None before the first."""
    good_samples: int
    bad_samples: int


class RobotMetrics(NamedTuple):
    """The figures of one robot at one moment."""

    robot: str
    signals: Sequence[SignalMetrics]
    link_up: Optional[bool]
    """None: it is not watched over a link."""
    tick_s: float
    """The last tick, in s since 1970."""

    @property
    def label(self) -> str:
        """The name as the value of a label."""
        return printable(self.robot)


class Metrics:
    """Counts transitions, reads robots and renders what was read."""

    def __init__(
        self,
        notifications_waiting: Callable[[], int] = int,
        wall_time_s: Callable[[], float] = time.time,
        count_faults: Callable[[], int] = int,
    ) -> None:
        """Starts with empty counters.

        Args:
            notifications_waiting: returns how many notifications are not delivered yet.
            wall_time_s: seconds since 1970.
            count_faults: returns how many parts of the monitor do not work.
        """
        self._notifications_waiting = notifications_waiting
        self._count_faults = count_faults
        self._wall_time_s = wall_time_s
        self._lock = threading.Lock()
        self._transitions: Dict[Tuple[str, str], Counter[Level]] = {}
        self._kept: _Kept = {}

    def counter(self, robot: str) -> Callable[[Transition], None]:
        """Returns the function that counts a transition of a robot. It may be called in any thread."""

        def count(transition: Transition) -> None:
            if not transition.repeat:
                with self._lock:
                    self._transitions.setdefault((robot, transition.signal), Counter())[transition.to_level] += 1

        return count

    def read(self, alert_system: AlertSystem) -> RobotMetrics:
        """Reads a robot. May be called in any thread."""

        def read(monitor: Monitor, now_s: float) -> Tuple[List[SignalMetrics], Optional[bool]]:
            signals = [
                SignalMetrics(
                    name,
                    judgement.level,
                    judgement.judged,
                    not judgement.is_bad if judgement.seen else None,
                    judgement.good_samples,
                    judgement.bad_samples,
                )
                for name, judgement in monitor.judgements(now_s).items()
            ]
            return signals, monitor.link_up

        signals, link_up = alert_system.read(read)
        return RobotMetrics(alert_system.robot, signals, link_up, self._wall_time_s() - alert_system.tick_age_s)

    def render(self, robots: Sequence[RobotMetrics]) -> Tuple[bytes, str]:
        """Returns the exposition and its content type.

        Raises:
            ImportError: prometheus_client is not installed, or cannot be imported.
        """
        from prometheus_client import CONTENT_TYPE_LATEST

        before = self._kept
        after: _Kept = {}

        def kept(key: str, family: Family, series_of: Callable[[RobotMetrics], _Series]) -> bytes:
            """Returns the lines of series that rarely change; those of a robot are kept while they do not."""
            for robot in robots:
                series = series_of(robot)
                known = before.get((key, robot.robot))
                if known is None or known[0] != series:
                    known = series, _lines(family, series)
                after[key, robot.robot] = known
            return b"".join(after[key, robot.robot][1] for robot in robots)

        parts = [
            _header(_LEVEL),
            kept("level", _LEVEL, _levels),
            _header(_VALUE),
            _lines(_VALUE, tuple(series for robot in robots for series in _values(robot))),
            _header(_VALID),
            kept("valid", _VALID, _valid),
            _header(_SAMPLES),
            _lines(_SAMPLES, tuple(series for robot in robots for series in _good_samples(robot))),
            kept("bad", _SAMPLES, _bad_samples),
            _header(_TRANSITIONS),
            kept("transitions", _TRANSITIONS, self._count_transitions),
            _header(_LINK_UP),
            kept("link", _LINK_UP, _link_up),
            _exposition(_WAITING, (((), float(self._notifications_waiting())),)),
            _exposition(_FAULTS, (((), float(self._count_faults())),)),
            _exposition(_LAST_TICK, (((), min((robot.tick_s for robot in robots), default=self._wall_time_s())),)),
            _exposition(_BUILD_INFO, (((package_version(),), 1.0),)),
        ]
        self._kept = after
        return b"".join(parts), CONTENT_TYPE_LATEST

    def _count_transitions(self, robot: RobotMetrics) -> _Series:
        """Returns the counters. All exist from the start: Prometheus sees no increase from nothing to 1."""
        with self._lock:
            return tuple(
                ((robot.label, signal.name, level.name), float(count[level]))
                for signal in robot.signals
                for count in (self._transitions.get((robot.robot, signal.name), _NONE),)
                for level in Level
            )


def _levels(robot: RobotMetrics) -> _Series:
    return tuple(((robot.label, signal.name), float(signal.level)) for signal in robot.signals)


def _values(robot: RobotMetrics) -> _Series:
    return tuple(((robot.label, signal.name), signal.value) for signal in robot.signals if signal.value is not None)


def _valid(robot: RobotMetrics) -> _Series:
    return tuple(
        ((robot.label, signal.name), float(signal.valid)) for signal in robot.signals if signal.valid is not None
    )


def _good_samples(robot: RobotMetrics) -> _Series:
    return tuple(((robot.label, signal.name, "good"), float(signal.good_samples)) for signal in robot.signals)


def _bad_samples(robot: RobotMetrics) -> _Series:
    return tuple(((robot.label, signal.name, "bad"), float(signal.bad_samples)) for signal in robot.signals)


def _link_up(robot: RobotMetrics) -> _Series:
    return () if robot.link_up is None else (((robot.label,), float(robot.link_up)),)


def _header(family: Family) -> bytes:
    """Returns the lines HELP and TYPE."""
    return _exposition(family, ())


def _lines(family: Family, series: _Series) -> bytes:
    """Returns the lines of series, without HELP and TYPE."""
    return _exposition(family, series).split(b"\n", 2)[2]


def _exposition(family: Family, series: _Series) -> bytes:
    from prometheus_client import CollectorRegistry, generate_latest
    from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

    kind = CounterMetricFamily if family.counts else GaugeMetricFamily
    metric = kind(family.name, family.help, labels=family.labels)
    for labels, value in series:
        metric.add_metric(labels, value)
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collected([metric]))
    return generate_latest(registry)


_NONE: Counter[Level] = Counter()


class _Collected:
    """A collector whose metrics are ready."""

    def __init__(self, families: Sequence[Any]) -> None:
        self._families = families

    def collect(self) -> Sequence[Any]:
        return self._families
