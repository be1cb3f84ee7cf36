"""Metrics for Prometheus, in its text format. docs/reference/metrics.md lists them.

A client library would render them as a whole: of a thousand robots, 10 MB at a time.
https://prometheus.io/docs/instrumenting/exposition_formats/
"""

from __future__ import annotations

import threading
import time
from typing import Callable, Counter, Iterable, Iterator, Mapping, NamedTuple, Optional, Sequence

from ...core.judge import Judgement
from ...core.nodes import AlertSystem
from ...core.values import Clock, Level, Transition, package_version, printable

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"

FULL, FLEET = "full", "fleet"
PROFILES = (FULL, FLEET)
"""What a scrape contains: every metric, or what the exported rules and the dashboard of a fleet need."""

_MOST_COUNTED = 40_000
"""With more signals, the counters that were begun first begin anew."""

_ROBOTS_AT_ONCE = 200  # whose lines are rendered at a time

Value = Callable[[Judgement, Mapping[Level, int]], Optional[float]]
"""Returns the value of a series of a signal, from its judgement and its counted transitions; None if it is absent."""


def _announced_to(level: Level) -> Value:
    return lambda signal, to: to[level]


_OF_SIGNALS: Sequence[tuple[str, str, Mapping[str, Value]]] = (
    (
        "level",
        "Level of the signal: 0 OK, 1 WARN, 2 ERROR, 3 STALE or unknown.",
        {"": lambda signal, to: signal.level},
    ),
    (
        "alert_level",
        "Level that was announced last: 0 OK, 1 WARN, 2 ERROR, 3 STALE. Unlike robot_health_level it waits, flaps and "
        "has causes as alerts do.",
        {"": lambda signal, to: signal.announced},
    ),
    (
        "caused",
        "1 while the signal is the effect of another alert, else absent.",
        {"": lambda signal, to: 1.0 if signal.cause else None},
    ),
    (
        "affects",
        "Signals that are worse than announced because of this one; absent without any.",
        {"": lambda signal, to: signal.affects or None},
    ),
    (
        "value",
        "Last value of the signal's statistic, to which its bounds apply, in its unit; absent while undefined.",
        {"": lambda signal, to: signal.judged},
    ),
    (
        "latest",
        "Latest valid value of a signal whose statistic is not `last`, in its unit; absent while its data is invalid, "
        "stale or unreachable.",
        {"": lambda signal, to: None if signal.config.statistic == "last" else signal.latest_good},
    ),
    (
        "time_to_bound_seconds",
        "Time from the newest sample until the line of a forecast reaches the nearest bound ahead; absent while there "
        "is none, and like robot_health_latest.",
        {"": lambda signal, to: None if signal.forecast is None else signal.forecast.time_to_bound_s},
    ),
    (
        "data_valid",
        "Whether the latest sample of the signal is valid.",
        {"": lambda signal, to: not signal.is_bad if signal.seen else None},
    ),
    (
        "samples_total",
        "Samples of the signal.",
        {
            ',quality="good"': lambda signal, to: signal.good_samples,
            ',quality="bad"': lambda signal, to: signal.bad_samples,
        },
    ),
    (
        "transitions_total",
        "Announced changes of the signal's level.",
        # All exist from the start: Prometheus sees no increase from nothing to 1.
        {f',to="{level.name}"': _announced_to(level) for level in Level},
    ),
)
"""The metrics of a signal: name without `robot_health_`, help, and the values by further labels."""
_NOT_IN_FLEET = ("caused", "affects", "time_to_bound_seconds", "transitions_total")
_TICK = "last_tick_timestamp_seconds"


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
                self._transitions.setdefault((robot, transition.signal), Counter())[transition.to_level] += 1
                if len(self._transitions) > _MOST_COUNTED:
                    del self._transitions[next(iter(self._transitions))]

    def read(self, alert_system: AlertSystem) -> RobotMetrics:
        """Reads a robot. May be called in any thread."""
        robot = alert_system.robot
        judgements, link_up = alert_system.read(
            lambda monitor, now_s: ({**monitor.quiet_sources(), **monitor.judgements(now_s)}, monitor.link_up)
        )
        labels = f"robot={_quoted(robot)}"
        with self._lock:
            signals = {
                f"{labels},signal={_quoted(name)}": [
                    value(judgement, self._transitions.get((robot, name), _NONE))
                    for _, _, values in _OF_SIGNALS
                    for value in values.values()
                ]
                for name, judgement in judgements.items()
            }
        return RobotMetrics(labels, signals, link_up, self._wall_time_s() - alert_system.tick_age_s)

    def render(self, robots: Sequence[RobotMetrics], profile: str = FULL) -> Iterator[bytes]:
        """Yields the parts of the exposition.

        The profile `fleet` has only what the exported rules and the dashboard need.
        """
        place = 0
        for name, text, values in _OF_SIGNALS:
            further = [*enumerate(values, place)]
            place += len(values)
            if profile == FULL or name not in _NOT_IN_FLEET:
                yield _head(name, text)
                for begin in range(0, len(robots), _ROBOTS_AT_ONCE):
                    yield b"".join(
                        _line(name, labels + more, signal[number])
                        for robot in robots[begin : begin + _ROBOTS_AT_ONCE]
                        for labels, signal in robot.signals.items()
                        for number, more in further
                    )
        for name, text, series in self._others(robots, profile):
            yield _head(name, text) + b"".join(_line(name, labels, value) for labels, value in series)

    def _others(
        self, robots: Sequence[RobotMetrics], profile: str
    ) -> Iterator[tuple[str, str, Iterable[tuple[str, float | None]]]]:
        """Yields the metrics of robots and of the monitor: name, help, and the values by labels."""
        yield "link_up", "Whether the robot can be reached.", [(robot.labels, robot.link_up) for robot in robots]
        if profile == FLEET:
            text = "Last tick of the robot's monitor, in seconds since 1970"
            ticks = [(robot.labels, robot.tick_s) for robot in robots]
            yield _TICK, f"{text}; in the profile `fleet`, instead of the oldest.", ticks
            return
        yield (
            "notifications_waiting",
            "Notifications that are not delivered yet.",
            [("", self._notifications_waiting())],
        )
        yield "faults", "Parts of the monitor itself that do not work.", [("", self._count_faults())]
        oldest_s = min((robot.tick_s for robot in robots), default=self._wall_time_s())
        yield _TICK, "Last tick of the monitor, in seconds since 1970; of several robots the oldest.", [("", oldest_s)]
        yield "build_info", "Version of the monitor.", [(f'version="{package_version()}"', 1.0)]


_NONE: Counter[Level] = Counter()


def _head(name: str, text: str) -> bytes:
    kind = "counter" if name.endswith("_total") else "gauge"
    return f"# HELP robot_health_{name} {text}\n# TYPE robot_health_{name} {kind}\n".encode()


def _line(name: str, labels: str, value: float | None) -> bytes:
    if value is None:
        return b""
    braces = f"{{{labels}}}" if labels else ""
    return f"robot_health_{name}{braces} {float(value)!r}\n".encode()


def _quoted(text: str) -> str:
    """Returns the value of a label."""
    escaped = printable(text).replace("\\", r"\\").replace('"', r"\"")
    return f'"{escaped}"'
