"""The state of robots as JSON values: the part of docs/reference/api.md that describes robots and signals."""

from __future__ import annotations

import math
import threading
import time
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core import explanation
from robot_health_monitor.core.explanation import Judgement
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.quality import as_float, converted
from robot_health_monitor.core.signal_config import SignalConfig
from robot_health_monitor.runtime.times import iso_time

from ..plot import plot_bounds
from .own_state import OwnState

__all__ = ["MOST_SAMPLES", "RobotReader", "Samples"]

MOST_SAMPLES = 300
"""Most samples of one signal in an answer."""

_OFFSET_TOLERANCE_S = 0.25
"""Wall time and the monitor's time may drift apart by this much before samples get other wall times."""

Json = Dict[str, Any]


class Samples(NamedTuple):
    """Samples of one robot's signals."""

    full: bool
    """True: all samples of the windows. False: those since the time that was asked for."""
    signals: Mapping[str, Sequence[Tuple[float, float]]]
    """By signal: time in s since 1970 and value."""
    window_s: Mapping[str, float]
    """Length of each window, in s."""
    last_s: Mapping[str, float]
    """Time of the newest sample, on the monitor's clock."""
    now_s: float
    """When they were read, on the same clock."""
    offset_s: float
    """Wall time minus the monitor's clock, in s."""


class _Known(NamedTuple):
    """What is kept of a signal so that it need not be made again."""

    config: SignalConfig
    bounds: List[Json]
    since_s: float
    since: Optional[str]


class RobotReader:
    """Reads the state of one robot. May be used in any thread."""

    def __init__(
        self, alert_system: AlertSystem, own_state: OwnState, wall_time_s: Callable[[], float] = time.time
    ) -> None:
        """Reads nothing yet.

        Args:
            alert_system: the node that judges the robot.
            own_state: the state of the monitor itself.
            wall_time_s: seconds since 1970.
        """
        self.alert_system = alert_system
        self._own_state = own_state
        self._wall_time_s = wall_time_s
        self._lock = threading.Lock()
        self._known: Dict[str, _Known] = {}
        self._offset_s = math.nan

    def state(self, *, window: bool) -> Json:
        """Returns the robot's state as in `/api/state`.

        Args:
            window: with the samples.
        """

        def read(monitor: Monitor, now_s: float) -> Json:
            self._follow_clock(now_s)
            judgements = monitor.judgements(now_s)
            return self._robot(monitor, judgements, self._windows(monitor, judgements) if window else {})

        with self._lock:
            return self.alert_system.read(read)

    def samples(self, before: Optional[Samples] = None) -> Samples:
        """Returns the samples of the windows.

        Args:
            before: an earlier result: only newer samples; None: all.
        """

        def read(monitor: Monitor, now_s: float) -> Samples:
            self._follow_clock(now_s)
            # When time went back, the windows have begun anew.
            full = before is None or before.offset_s != self._offset_s or now_s < before.now_s
            since_s: Mapping[str, float] = {} if before is None or full else before.last_s
            configs = {name: config for name, config in monitor.config.signals.items() if name in monitor.signals()}
            found = {name: monitor.shown_samples(name, MOST_SAMPLES, since_s.get(name, -math.inf)) for name in configs}
            signals = {name: [(t + self._offset_s, value) for t, value in new] for name, new in found.items()}
            window_s = {name: config.window_s for name, config in configs.items()}
            last_s = {name: new[-1][0] for name, new in found.items() if new}
            return Samples(full, signals, window_s, {**since_s, **last_s}, now_s, self._offset_s)

        with self._lock:
            return self.alert_system.read(read)

    def plot_of(self, signal: str) -> Tuple[str, List[Json]]:
        """Returns the unit of a signal's samples and its bounds; empty if it is not watched."""
        config = self.alert_system.monitor.config.signals.get(signal)
        return ("", []) if config is None else (config.unit, plot_bounds(config))

    def _follow_clock(self, now_s: float) -> None:
        offset_s = self._wall_time_s() - now_s
        if not abs(offset_s - self._offset_s) <= _OFFSET_TOLERANCE_S:  # also the first time
            self._offset_s = offset_s

    def _windows(self, monitor: Monitor, names: Mapping[str, Any]) -> Mapping[str, List[List[float]]]:
        offset_s = self._offset_s
        return {
            name: [[round(t + offset_s, 3), value] for t, value in monitor.shown_samples(name, MOST_SAMPLES)]
            for name in names
        }

    def _robot(
        self, monitor: Monitor, judgements: Mapping[str, Judgement], windows: Mapping[str, List[List[float]]]
    ) -> Json:
        level = Level.worst(judgement.level for judgement in judgements.values())
        signals = {name: self._signal(name, judgement, windows.get(name, [])) for name, judgement in judgements.items()}
        cause = None
        if level is not Level.OK:
            cause = next(name for name, judgement in judgements.items() if judgement.level is level)
        return {
            "level": level.name,
            "link": {None: None, True: "up", False: "down"}[monitor.link_up],
            "signal": cause,
            "message": signals[cause]["message"] if cause is not None else "",
            "since": signals[cause]["since"] if cause is not None else None,
            "monitor": self._own_state.of_robot(self.alert_system),
            "signals": signals,
        }

    def _signal(self, name: str, judgement: Judgement, window: List[List[float]]) -> Json:
        known = self._known.get(name)
        if known is None or known.since_s != judgement.since_s or known.config is not judgement.config:
            config, since_s = judgement.config, judgement.since_s
            known = _Known(config, plot_bounds(config), since_s, iso_time(since_s + self._offset_s))
            self._known[name] = known
        config = known.config
        number = converted(config, as_float(judgement.latest)) if judgement.seen else math.nan
        return {
            "level": judgement.level.name,
            "state": judgement.state,
            "value": number if math.isfinite(number) else None,
            "unit": config.unit,
            "message": explanation.reason(judgement),
            "hint": judgement.hint,
            "since": known.since,
            "silenced": self.alert_system.silence_of(name),
            "bounds": known.bounds,
            "window": window,
            "text": explanation.shown_text(judgement),
            "statistic": config.statistic,
            "judged": judgement.judged,
            "judged_unit": explanation.judged_unit(config),
            "flapping": judgement.flapping,
            "latch": config.latch,
        }
