"""aggregator: averages its inputs into `system_health`, with the statistics of each on /diagnostics."""

from __future__ import annotations

import math
import platform
from typing import Any, Callable, Mapping

from ..config import DEFAULT_SIGNALS, NODE_PARAMETERS, MonitorConfig, SignalConfig, load_config, read_signal
from ..diagnostics import ARRAY_TYPE, array_message
from ..formatting import number_text
from ..middleware import Middleware, Severity
from ..model import Level, Sample, Status
from ..monitor import Monitor
from ..parameters import Parameter, read_parameters
from ..score import health_score
from .changes import describe_changes
from .identity import DIAGNOSTICS, FLOAT_TYPE, base_name, refuse_change

AGGREGATOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("publish_rate", float, 1.0, "rate of system_health and /diagnostics in Hz", 0.01, 100.0),
    Parameter("window_s", float, 60.0, "length of the window for statistics, in s", 0.001),
    Parameter("stale_after_s", float, 5.0, "an input is missing after this long without a sample, in s", 0.001),
    Parameter(
        "method",
        str,
        "mean",
        "mean: average of the values; score: of 0 to 100 by thresholds",
        choices=("mean", "score"),
    ),
)
"""What aggregator can be told."""

INPUTS = ("battery_level", "temperature", "cpu_usage")
"""What system_health is the average of."""


class Aggregator:
    """Averages the three metrics into `system_health` and publishes the statistics of each on /diagnostics."""

    def __init__(self, middleware: Middleware) -> None:
        """Starts listening.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self._middleware = middleware
        self._node = base_name(middleware)
        self._values = read_parameters(middleware.given_parameters(), AGGREGATOR_PARAMETERS)
        self._thresholds = _read_thresholds(self._values)
        self._robot = self._values["robot_name"] or platform.node()
        self._monitor = Monitor(_window_config(self._values), self._robot)
        middleware.declare_parameters(AGGREGATOR_PARAMETERS, self._reconfigure)
        middleware.advertise("system_health", FLOAT_TYPE)
        middleware.advertise(DIAGNOSTICS, ARRAY_TYPE)
        for name in INPUTS:
            middleware.subscribe(name, FLOAT_TYPE, self._observer(name), field="data")
        self._timer = middleware.create_timer(1.0 / self._values["publish_rate"], self._publish)
        middleware.log(Severity.INFO, f"system_health is the {self._values['method']} of {', '.join(INPUTS)}")

    def close(self) -> None:
        """Leaves the middleware."""
        self._middleware.close()

    def _observer(self, name: str) -> Callable[[Any, float], None]:
        observe = self._monitor.observe

        def callback(value: Any, now_s: float) -> None:
            observe(Sample(name, value, now_s))

        return callback

    def _publish(self, now_s: float) -> None:
        self._monitor.tick(now_s)
        fresh = {name: self._monitor.fresh_value(name) for name in INPUTS}
        missing = [name for name, value in fresh.items() if value is None]
        values = {name: value for name, value in fresh.items() if value is not None}
        if self._values["method"] == "score":
            values = {name: health_score(value, self._thresholds[name]) for name, value in values.items()}
        if missing:
            level, message = Level.STALE, f"not published: no fresh {' and no fresh '.join(missing)}"
        else:
            health = math.fsum(values.values()) / len(values)
            level, message = Level.OK, f"{self._values['method']} is {number_text(health)}"
            self._middleware.publish("system_health", {"data": health})
        if self._middleware.has_listeners(DIAGNOSTICS):
            shown = {"method": self._values["method"], "missing": ", ".join(missing)}
            shown.update((name, number_text(value)) for name, value in values.items())
            status = Status("system_health", level, message, self._monitor.robot, shown)
            statuses = [*self._monitor.report(now_s).statuses.values(), status]
            self._middleware.publish(DIAGNOSTICS, array_message(statuses, self._node))

    def _reconfigure(self, tree: Mapping[str, Any]) -> str:
        values = read_parameters(tree, AGGREGATOR_PARAMETERS)
        refuse_change("robot_name", self._values["robot_name"], values["robot_name"])
        self._thresholds = _read_thresholds(values)
        self._monitor.configure(_window_config(values))
        if values["publish_rate"] != self._values["publish_rate"]:
            self._timer.cancel()
            self._timer = self._middleware.create_timer(1.0 / values["publish_rate"], self._publish)
        old, self._values = self._values, values
        return describe_changes({"": old}, {"": values})


def _read_thresholds(values: Mapping[str, Any]) -> Mapping[str, SignalConfig]:
    """Returns the signals whose thresholds the score uses: those of the file, or the defaults."""
    signals = {name: read_signal(name, signal) for name, signal in DEFAULT_SIGNALS.items()}
    if values["method"] == "score" and values["thresholds"]:
        signals.update(load_config(values["thresholds"]).signals)
    return signals


def _window_config(values: Mapping[str, Any]) -> MonitorConfig:
    settings = {name: values[name] for name in ("window_s", "stale_after_s")}
    return MonitorConfig({name: read_signal(name, settings) for name in INPUTS})
