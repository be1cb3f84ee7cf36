"""The state of robots, and of the monitor itself, as JSON values, as docs/reference/api.md describes them."""

from __future__ import annotations

import math
import time
from typing import Any, Callable, Dict, Mapping, NamedTuple, Sequence

from ...core.config import OF_ARRIVALS
from ...core.judge import Judgement, Monitor, config_of, number_of, wording
from ...core.nodes import AlertSystem
from ...core.values import Clock, Fault, Level, summary_of
from ...runtime.times import iso_time
from ..plot import plot_bounds

MOST_SAMPLES = 300  # of one signal in an answer
_OFFSET_TOLERANCE_S = 0.25
"""Wall time and the monitor's time may drift apart by this much before samples get other wall times."""

Json = Dict[str, Any]


class OwnState:
    """The present faults of a process, as the page, the API, /healthz and the metrics show them.

    /diagnostics shows the same: the faults of a robot's monitor in the status of its alert_system, those of the process
    in the status of the process. May be read in any thread.
    """

    def __init__(
        self, robots: Callable[[], Sequence[AlertSystem]], process_faults: Callable[[], Mapping[str, Fault]]
    ) -> None:
        """Takes functions: `robots` returns those watched now, `process_faults` the faults of no robot, by part."""
        self._robots = robots
        self._process_faults = process_faults

    def texts(self) -> list[str]:
        """Returns a line per fault."""
        return [f"{name}: {fault.text}" for name, _, _, fault in self._faults()]

    def as_json(self) -> Json:
        """Returns the key `monitor` of `/api/state`."""
        faults = self._faults()
        level, message = summary_of({name: fault for name, _, _, fault in faults})
        return {
            "level": level.name,
            "message": message,
            "faults": [
                {"robot": robot, "part": part, "level": fault.level.name, "text": fault.text}
                for _, robot, part, fault in faults
            ],
        }

    def of_robot(self, robot: AlertSystem) -> Json:
        """Returns the key `monitor` of a robot: the faults of the process concern every robot."""
        level, message = summary_of({**self._process_faults(), **robot.own_faults()})
        return {"level": level.name, "message": message}

    def _faults(self) -> list[tuple[str, str | None, str, Fault]]:
        """Returns the faults with a name for robot and part, the robot, if any, and the part; the process's first."""
        robots = self._robots()
        sources: list[tuple[str | None, Mapping[str, Fault]]] = [(None, self._process_faults())]
        sources += [(robot.robot, robot.own_faults()) for robot in robots]
        return [
            (f"{robot}: {part}" if robot and len(robots) > 1 else part, robot, part, fault)
            for robot, faults in sources
            for part, fault in faults.items()
        ]


class Samples(NamedTuple):
    """Samples of one robot's signals."""

    event: Json  # as the event `samples` of `/api/events`
    last_s: Mapping[str, float]  # time of the newest sample, on the monitor's clock; -inf if there is none
    now_s: float  # when they were read, on the same clock
    offset_s: float  # wall time minus the monitor's clock


NO_PLOT: Json = {"unit": "", "bounds": [], "forecast_s": None}
"""Of a signal that is not watched."""


def plot_of(alert_system: AlertSystem, signal: str) -> Json:
    """Returns the unit of a signal's samples, its bounds and its `forecast_s`."""
    config = config_of(signal, alert_system.monitor.config.signals)  # also of an element that has ended
    if config is None:
        return NO_PLOT
    unit = wording.judged_unit(config) if config.statistic in OF_ARRIVALS else config.unit
    return {"unit": unit, "bounds": plot_bounds(config), "forecast_s": config.forecast_s}


class RobotReader:
    """Reads the state of one robot. May be used in any thread."""

    def __init__(
        self,
        alert_system: AlertSystem,
        own_state: OwnState,
        wall_time_s: Clock = time.time,
    ) -> None:
        """Reads nothing yet; `wall_time_s` returns seconds since 1970."""
        self.alert_system = alert_system
        self.robot = alert_system.robot
        self._own_state = own_state
        self._wall_time_s = wall_time_s
        self._offset_s = math.nan
        """Wall time minus the monitor's clock. Kept while it hardly changes, so that times do not change with it."""

    def state(self, *, window: bool) -> Json:
        """Returns the robot's state as in `/api/state`; its samples only with `window`."""

        def read(monitor: Monitor, now_s: float) -> Json:
            self._follow_clock(now_s)
            judgements = monitor.judgements(now_s)
            signals = {
                name: self._signal(name, judgement, monitor.shown_samples(name, MOST_SAMPLES) if window else ())
                for name, judgement in judgements.items()
            }
            level = Level.worst(judgement.level for judgement in judgements.values())
            cause, shown = None, {"message": "", "since": None}
            if level is not Level.OK:
                worst = [name for name, judgement in judgements.items() if judgement.level is level]
                cause = next((name for name in worst if not judgements[name].cause), worst[0])
                shown = signals[cause]
            return {
                "level": level.name,
                "link": {None: None, True: "up", False: "down"}[monitor.link_up],
                "signal": cause,
                "message": shown["message"],
                "since": shown["since"],
                "monitor": self._own_state.of_robot(self.alert_system),
                "show": list(monitor.config.main_signals),
                "signals": signals,
            }

        return self.alert_system.read(read)

    def samples(self, before: Samples | None = None) -> Samples:
        """Returns the samples of the windows: those since `before`, an earlier result, or all if it is None."""

        def read(monitor: Monitor, now_s: float) -> Samples:
            self._follow_clock(now_s)
            # When time went back, the windows have begun anew.
            full = before is None or before.offset_s != self._offset_s or now_s < before.now_s
            since_s: Mapping[str, float] = {} if before is None or full else before.last_s
            configs = monitor.configs()
            shown = {name: monitor.shown_samples(name, MOST_SAMPLES, since_s.get(name, -math.inf)) for name in configs}
            event = {
                "robot": self.robot,
                "full": full,
                "signals": {name: self._shown(new) for name, new in shown.items() if new or full},
                "window_s": {name: config.window_s for name, config in configs.items()},
            }
            last_s = {name: new[-1][0] if new else since_s.get(name, -math.inf) for name, new in shown.items()}
            return Samples(event, last_s, now_s, self._offset_s)

        return self.alert_system.read(read)

    def _shown(self, samples: Sequence[tuple[float, float]]) -> list[list[float]]:
        return [[round(t + self._offset_s, 3), value] for t, value in samples]

    def _follow_clock(self, now_s: float) -> None:
        offset_s = self._wall_time_s() - now_s
        if not abs(offset_s - self._offset_s) <= _OFFSET_TOLERANCE_S:  # also the first time
            self._offset_s = offset_s

    def _signal(self, name: str, judgement: Judgement, samples: Sequence[tuple[float, float]]) -> Json:
        config, forecast = judgement.config, judgement.forecast
        number = number_of(config, judgement.latest) if judgement.seen else math.nan
        return {
            "level": judgement.level.name,
            "state": judgement.state,
            "value": number if math.isfinite(number) else None,
            "unit": config.unit,
            "message": wording.reason(judgement),
            "hint": wording.hint(judgement),
            "since": iso_time(judgement.since_s + self._offset_s),
            "silenced": self.alert_system.silence_of(name),
            "bounds": plot_bounds(config),
            "window": self._shown(samples),
            "text": wording.shown_text(judgement),
            "outlook": wording.outlook(judgement),
            "statistic": config.statistic,
            "judged": judgement.judged,
            "judged_unit": wording.judged_unit(config),
            "forecast": None if forecast is None else forecast.value,
            "forecast_s": None if forecast is None else forecast.forecast_s,
            "trend_per_min": None if forecast is None else forecast.slope_per_s * 60.0,
            "time_to_bound_s": None if forecast is None else forecast.time_to_bound_s,
            "flapping": judgement.flapping,
            "cause": judgement.cause or None,
            "affects": judgement.affects,
            "latch": config.latch,
        }
