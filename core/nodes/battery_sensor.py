"""battery_sensor: publishes battery level, temperature and CPU usage, simulated or of this host."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Set, Tuple

from ..config import NODE_PARAMETERS
from ..diagnostics import ARRAY_TYPE, array_message
from ..errors import Problems
from ..formatting import number_text
from ..middleware import Middleware, Severity, Timer
from ..model import Level, Status
from ..parameters import Parameter, read_parameters
from ..sensors import configuration
from ..sensors.host import HOST_PATHS, HostPaths
from ..sensors.source import NoSuchSensor, NotMeasuredYet, SensorError, Source
from .changes import Sections, describe_changes
from .identity import (
    DIAGNOSTICS,
    FLOAT_TYPE,
    SIMULATED_SENSORS,
    STRING_TYPE,
    UNAVAILABLE_SENSORS,
    base_name,
    host_name,
    refuse_changes,
)

SENSOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("sensor_name", str, "robot", "name of the sensor, for the log"),
    Parameter("publish_rate", float, 1.0, "rate of every metric in Hz", 0.01, 1000.0),
    configuration.SEED,
)
"""Parameters of battery_sensor besides those of its metrics (`configuration.METRIC_PARAMETERS`)."""

_STATUS_PERIOD_S = 1.0


class BatterySensor:
    """Publishes each configured metric, and a status on /diagnostics with the source of each.

    A metric that cannot be read is not published; the log reports it once, and once when it can be read again.
    """

    def __init__(self, middleware: Middleware, paths: HostPaths = HOST_PATHS) -> None:
        """Starts publishing.

        Args:
            middleware: the node's connection.
            paths: where the files of the host's sensors are.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self._middleware = middleware
        self._paths = paths
        self._tree = middleware.given_parameters()
        self._values, self._sources = _read_sensor(self._tree, paths)
        self._robot = self._values["robot_name"] or host_name()
        self._topics: Dict[str, str] = {}
        self._failed: Dict[str, SensorError] = {}
        self._seen: Set[str] = set()
        declared = SENSOR_PARAMETERS + configuration.declared_parameters(self._tree)
        middleware.declare_parameters(declared, self._reconfigure)
        middleware.advertise(DIAGNOSTICS, ARRAY_TYPE)
        self._advertise()
        self._timer = self._start_timer()
        middleware.create_timer(_STATUS_PERIOD_S, self._publish_status)
        rate = number_text(self._values["publish_rate"])
        metrics = ", ".join(self._sources) or "no metrics"
        middleware.log(Severity.INFO, f'sensor "{self._values["sensor_name"]}" started at {rate} Hz: {metrics}')
        simulated = self._simulated()
        if simulated:
            middleware.log(Severity.WARN, f"simulated values: {', '.join(simulated)}")

    def close(self) -> None:
        """Leaves the middleware."""
        self._middleware.close()

    def _advertise(self) -> None:
        """Announces the topics; which of them are simulated comes before the first value."""
        self._middleware.advertise(SIMULATED_SENSORS, STRING_TYPE, latched=True)
        for metric in (*configuration.METRICS, *self._sources):
            self._topics[metric] = self._middleware.advertise(metric, FLOAT_TYPE)
        self._publish_simulated()
        if "host" in self._kinds().values():
            self._middleware.advertise(UNAVAILABLE_SENSORS, STRING_TYPE)

    def _start_timer(self) -> Timer:
        return self._middleware.create_timer(1.0 / self._values["publish_rate"], self._publish)

    def _publish(self, now_s: float) -> None:
        for metric, source in self._sources.items():
            try:
                value = source.read(now_s)
            except NotMeasuredYet:
                continue
            except SensorError as error:
                self._note_failure(metric, error)
                continue
            except Exception as error:  # one broken source must not stop the others
                self._note_failure(metric, SensorError(f"{type(error).__name__}: {error}"))
                continue
            self._seen.add(metric)
            if self._failed.pop(metric, None):
                self._middleware.log(Severity.INFO, f"{metric} can be read again")
            self._middleware.publish(metric, {"data": value})

    def _note_failure(self, metric: str, error: SensorError) -> None:
        if metric not in self._failed:
            self._middleware.log(Severity.WARN, f"{metric} is not published: {error}")
        self._failed[metric] = error

    def _publish_simulated(self) -> None:
        topics = [self._topics[metric] for metric in self._simulated()]
        self._middleware.publish(SIMULATED_SENSORS, {"data": ", ".join(topics)})

    def _publish_status(self, now_s: float) -> None:
        self._publish_simulated()
        unavailable = [
            metric
            for metric, error in self._failed.items()
            if isinstance(error, NoSuchSensor) and metric not in self._seen
        ]
        if "host" in self._kinds().values():
            self._middleware.publish(UNAVAILABLE_SENSORS, {"data": ", ".join(unavailable)})
        if self._middleware.has_listeners(DIAGNOSTICS):
            status = self._status(unavailable)
            self._middleware.publish(DIAGNOSTICS, array_message([status], base_name(self._middleware)))

    def _status(self, unavailable: List[str]) -> Status:
        broken = [metric for metric in self._failed if metric not in unavailable]
        simulated = self._simulated()
        values = {"simulated": "true" if simulated else "false", **self._kinds()}
        values.update((metric, f"not published: {error}") for metric, error in self._failed.items())
        if broken:
            level, message = Level.WARN, f"cannot read {', '.join(broken)}"
        elif simulated:
            level, message = Level.OK, f"simulated values: {', '.join(simulated)}"
        else:
            level, message = Level.OK, f"{len(self._sources) - len(self._failed)} metrics published"
        return Status("sensors", level, message, self._robot, values)

    def _kinds(self) -> Dict[str, str]:
        """Returns `simulated`, `host` or `none` per metric."""
        kinds = {}
        for metric in dict.fromkeys([*configuration.METRICS, *self._sources]):
            source = configuration.settings_of(self._tree, metric).get("source", "none")
            kinds[metric] = str(source) if metric in configuration.METRICS else "host"
        return kinds

    def _simulated(self) -> List[str]:
        return [metric for metric, kind in self._kinds().items() if kind == "simulated"]

    def _reconfigure(self, tree: Mapping[str, Any]) -> str:
        values, sources = _read_sensor(tree, self._paths)
        refuse_changes(self._values, values, except_for=("sensors",))
        for metric in sources.keys() & self._sources.keys():
            old, new = (configuration.settings_of(of, metric) for of in (self._tree, tree))
            if new == old and tree.get("seed") == self._tree.get("seed"):
                sources[metric] = self._sources[metric]
        before = _sections(self._values, self._tree, self._sources)
        rate_changed = values["publish_rate"] != self._values["publish_rate"]
        self._tree, self._values, self._sources = tree, values, sources
        self._failed = {metric: error for metric, error in self._failed.items() if metric in sources}
        self._advertise()
        if rate_changed:
            self._timer.cancel()
            self._timer = self._start_timer()
        return describe_changes(before, _sections(values, tree, sources))


def _read_sensor(tree: Mapping[str, Any], paths: HostPaths) -> Tuple[Dict[str, Any], Dict[str, Source]]:
    """Returns the values of the node's own parameters, and the source of each metric.

    Raises:
        ConfigError: unknown keys or values that are not allowed, all of them.
    """
    problems = Problems()
    values: Dict[str, Any] = {}
    sources: Dict[str, Source] = {}
    with problems:
        values = read_parameters(tree, SENSOR_PARAMETERS, sections=configuration.SECTION_NAMES)
    if problems.errors:  # those of these keys are known; they would be found again with every metric
        tree = {key: value for key, value in tree.items() if key in configuration.SECTION_NAMES}
    with problems:
        sources = configuration.read_sources(tree, paths=paths)
    problems.raise_if_any()
    return values, sources


def _sections(values: Mapping[str, Any], tree: Mapping[str, Any], sources: Mapping[str, Source]) -> Sections:
    metrics = dict.fromkeys([*configuration.METRICS, *sources])
    return {"": values, **{metric: configuration.settings_of(tree, metric) for metric in metrics}}
