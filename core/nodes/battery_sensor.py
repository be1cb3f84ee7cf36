"""battery_sensor: publishes battery level, temperature and CPU usage, simulated or of this host."""

from __future__ import annotations

from typing import Any, Dict, Mapping, Set

from ..config import NODE_PARAMETERS
from ..formatting import number_text
from ..middleware import Middleware, Severity, Timer
from ..parameters import Parameter, read_parameters
from ..sensors import configuration as sensing
from .changes import describe_changes
from .identity import FLOAT_TYPE, refuse_change

SENSOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("sensor_name", str, "robot", "name of the sensor, for the log"),
    Parameter("publish_rate", float, 1.0, "rate of every metric in Hz", 0.01, 1000.0),
    sensing.SEED,
)
"""What battery_sensor can be told besides its metrics, which `sensing.SECTIONS` lists."""


class BatterySensor:
    """Publishes battery level, temperature and CPU usage, each simulated or of this host.

    A metric that cannot be read is not published; the log says so once, and once when it can be read again.
    """

    def __init__(self, middleware: Middleware) -> None:
        """Starts publishing.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self._middleware = middleware
        self._tree = middleware.given_parameters()
        self._values = _read_sensor(self._tree)
        self._sources = sensing.read_sources(self._tree)
        self._failed: Set[str] = set()
        described = SENSOR_PARAMETERS + sensing.described_sections(self._tree)
        middleware.declare_parameters(described, self._reconfigure)
        self._advertise()
        self._timer = self._start_timer()
        middleware.log(
            Severity.INFO,
            f'sensor "{self._values["sensor_name"]}" started at {number_text(self._values["publish_rate"])} Hz: '
            + ", ".join(self._sources),
        )

    def close(self) -> None:
        """Leaves the middleware."""
        self._middleware.close()

    def _advertise(self) -> None:
        for metric in (*sensing.METRICS, *self._sources):
            self._middleware.advertise(metric, FLOAT_TYPE)

    def _start_timer(self) -> Timer:
        return self._middleware.create_timer(1.0 / self._values["publish_rate"], self._publish)

    def _publish(self, now_s: float) -> None:
        for metric, source in self._sources.items():
            try:
                value = source.read(now_s)
            except sensing.NotYet:
                continue
            except sensing.SensorError as error:
                self._note_failure(metric, str(error))
                continue
            if metric in self._failed:
                self._failed.remove(metric)
                self._middleware.log(Severity.INFO, f"{metric} can be read again")
            self._middleware.publish(metric, {"data": value})

    def _note_failure(self, metric: str, reason: str) -> None:
        if metric not in self._failed:
            self._failed.add(metric)
            self._middleware.log(Severity.WARN, f"{metric} is not published: {reason}")

    def _reconfigure(self, tree: Mapping[str, Any]) -> str:
        values = _read_sensor(tree)
        refuse_change("robot_name", self._values["robot_name"], values["robot_name"])
        sources = sensing.read_sources(tree)
        for metric in sources.keys() & self._sources.keys():
            old, new = (sensing.section_of(of, metric) for of in (self._tree, tree))
            if new == old and tree.get("seed") == self._tree.get("seed"):
                sources[metric] = self._sources[metric]
        rate_changed = values["publish_rate"] != self._values["publish_rate"]
        changes = describe_changes({"": self._values}, {"": values})
        self._tree, self._values, self._sources = tree, values, sources
        self._failed &= sources.keys()
        self._advertise()
        if rate_changed:
            self._timer.cancel()
            self._timer = self._start_timer()
        return changes


def _read_sensor(tree: Mapping[str, Any]) -> Dict[str, Any]:
    return read_parameters(tree, SENSOR_PARAMETERS, sections=(*sensing.SECTIONS, sensing.HOST))
