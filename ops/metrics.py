"""Metrics for Prometheus, in prometheus_client's exposition. docs/api.md lists them.

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

__all__ = ["METRICS_LIBRARY", "Metrics", "RobotMetrics", "SignalMetrics"]

METRICS_LIBRARY = "prometheus_client"
_BY_SIGNAL = ("robot", "signal")

_Figures = Tuple[Tuple[str, str, int], ...]
"""Signal, level, and how often it was announced."""


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


class Metrics:
    """Counts transitions, reads robots and renders what was read."""

    def __init__(
        self, notifications_waiting: Callable[[], int] = int, wall_time_s: Callable[[], float] = time.time
    ) -> None:
        """Starts with empty counters.

        Args:
            notifications_waiting: returns how many notifications are not delivered yet.
            wall_time_s: seconds since 1970.
        """
        self._notifications_waiting = notifications_waiting
        self._wall_time_s = wall_time_s
        self._lock = threading.Lock()
        self._transitions: Dict[Tuple[str, str], Counter[Level]] = {}
        self._rendered: Dict[str, Tuple[_Figures, bytes]] = {}

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
            ModuleNotFoundError: prometheus_client is not installed.
        """
        from prometheus_client import CONTENT_TYPE_LATEST

        return b"".join([_exposition(self._families(robots)), *self._rendered_transitions(robots)]), CONTENT_TYPE_LATEST

    def _families(self, robots: Sequence[RobotMetrics]) -> List[Any]:
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        level = GaugeMetricFamily(
            "robot_health_level", "Level of the signal: 0 OK, 1 WARN, 2 ERROR, 3 STALE or unknown.", labels=_BY_SIGNAL
        )
        value = GaugeMetricFamily(
            "robot_health_value",
            "Last value of the signal's statistic, to which its bounds apply, in its unit; absent while undefined.",
            labels=_BY_SIGNAL,
        )
        valid = GaugeMetricFamily(
            "robot_health_data_valid", "Whether the latest sample of the signal is valid.", labels=_BY_SIGNAL
        )
        samples = CounterMetricFamily("robot_health_samples", "Samples of the signal.", labels=(*_BY_SIGNAL, "quality"))
        link = GaugeMetricFamily("robot_health_link_up", "Whether the robot can be reached.", labels=("robot",))
        for robot in robots:
            name = printable(robot.robot)
            if robot.link_up is not None:
                link.add_metric((name,), float(robot.link_up))
            for signal in robot.signals:
                labels = (name, signal.name)
                level.add_metric(labels, float(signal.level))
                if signal.value is not None:
                    value.add_metric(labels, signal.value)
                if signal.valid is not None:
                    valid.add_metric(labels, float(signal.valid))
                samples.add_metric((*labels, "good"), signal.good_samples)
                samples.add_metric((*labels, "bad"), signal.bad_samples)
        waiting = GaugeMetricFamily(
            "robot_health_notifications_waiting",
            "Notifications that are not delivered yet.",
            value=self._notifications_waiting(),
        )
        tick = GaugeMetricFamily(
            "robot_health_last_tick_timestamp_seconds",
            "Last tick of the monitor, in seconds since 1970; of several robots the oldest.",
            value=min((robot.tick_s for robot in robots), default=self._wall_time_s()),
        )
        build = GaugeMetricFamily("robot_health_build_info", "Version of the monitor.", labels=("version",))
        build.add_metric((package_version(),), 1.0)
        return [level, value, valid, samples, link, waiting, tick, build]

    def _rendered_transitions(self, robots: Sequence[RobotMetrics]) -> List[bytes]:
        """Returns the counters of transitions, of which most do not change from one scrape to the next.

        All exist from the start: Prometheus does not count the increase from nothing to 1.
        """
        with self._lock:
            counts = {key: dict(counter) for key, counter in self._transitions.items()}
        before = self._rendered
        after: Dict[str, Tuple[_Figures, bytes]] = {}
        parts: List[bytes] = []
        for robot in robots:
            figures = tuple(
                (signal.name, level.name, counts.get((robot.robot, signal.name), {}).get(level, 0))
                for signal in robot.signals
                for level in Level
            )
            rendered = before.get(robot.robot)
            if rendered is None or rendered[0] != figures:
                rendered = figures, _exposition([_transitions_family(printable(robot.robot), figures)])
            after[robot.robot] = rendered
            # The lines HELP and TYPE once.
            parts.append(rendered[1].split(b"\n", 2)[2] if parts else rendered[1])
        self._rendered = after
        return parts


def _transitions_family(robot: str, figures: _Figures) -> Any:
    from prometheus_client.core import CounterMetricFamily

    family = CounterMetricFamily(
        "robot_health_transitions", "Announced changes of the signal's level.", labels=(*_BY_SIGNAL, "to")
    )
    for signal, level, count in figures:
        family.add_metric((robot, signal, level), count)
    return family


def _exposition(families: Sequence[Any]) -> bytes:
    from prometheus_client import CollectorRegistry, generate_latest

    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collected(families))
    return generate_latest(registry)


class _Collected:
    """A collector whose metrics are ready."""

    def __init__(self, families: Sequence[Any]) -> None:
        self._families = families

    def collect(self) -> Sequence[Any]:
        return self._families
