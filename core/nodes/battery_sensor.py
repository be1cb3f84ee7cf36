"""battery_sensor: publishes battery level, temperature and CPU usage, simulated or of this host."""

from __future__ import annotations

from typing import Any

from ..config import NODE_PARAMETERS, Parameter, read_parameters
from ..port import Middleware, Severity
from ..sensors import configuration
from ..sensors.computer import Computer
from ..sensors.source import NoSuchSensor, NotMeasuredYet, SensorError, Source
from ..values import ARRAY_TYPE, OWN_TOPICS, JsonObject, Level, Problems, Status, number_text
from . import node

SENSOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("sensor_name", str, "robot", "name of the sensor, for the log"),
    Parameter("publish_rate", float, 1.0, "rate of every metric in Hz", 0.01, 1000.0),
    configuration.SEED,
    configuration.HOST_PRESET,
)
"""Parameters of battery_sensor besides those of its metrics (`configuration.METRIC_PARAMETERS`)."""

_STATUS_PERIOD_S = 1.0


class BatterySensor:
    """Publishes each configured metric, and a status on /diagnostics with the source of each.

    A metric that cannot be read is not published; the log reports it once, and once when it can be read again.
    """

    def __init__(self, middleware: Middleware, computer: Computer | None = None) -> None:
        """Starts publishing; the sources of the host read `computer`, else this one. Raises ConfigError."""
        self._middleware = middleware
        self._computer = computer or Computer()
        self._failed: dict[str, SensorError] = {}
        self._seen: set[str] = set()
        tree = middleware.given_parameters()
        self._values, sources = _read_sensor(tree, self._computer)
        self._robot = self._values["robot_name"] or node.host_name()
        middleware.declare_parameters(SENSOR_PARAMETERS + configuration.declared_parameters(tree), self._reconfigure)
        middleware.advertise(node.DIAGNOSTICS, ARRAY_TYPE)
        self._timer = node.RateTimer(middleware, self._publish)
        self._use(tree, sources)
        middleware.create_timer(_STATUS_PERIOD_S, self._publish_status)
        rate = number_text(self._values["publish_rate"])
        metrics = ", ".join(self._sources) or "no metrics"
        middleware.log(Severity.INFO, f'sensor "{self._values["sensor_name"]}" started at {rate} Hz: {metrics}')
        if self._simulated:
            middleware.log(Severity.WARN, f"simulated values: {', '.join(self._simulated)}")

    def close(self) -> None:
        """Leaves the middleware."""
        self._middleware.close()

    def _use(self, tree: JsonObject, sources: dict[str, Source]) -> None:
        """Takes over a configuration; announces which topics are simulated before their first value."""
        self._tree, self._sources = tree, sources
        self._settings = metrics = configuration.settings_of(tree)
        self._kinds = {
            metric: str(settings["source"]) if metric in configuration.METRICS else "host"
            for metric, settings in self._settings.items()
        }
        self._simulated = [metric for metric, kind in self._kinds.items() if kind == "simulated"]
        own = [self._middleware.advertise(node.SIMULATED_SENSORS, node.STRING_TYPE, latched=True)]
        self._topics = {metric: self._middleware.advertise(metric, node.FLOAT_TYPE) for metric in metrics}
        self._publish_simulated()
        if "host" in self._kinds.values():
            own.append(self._middleware.advertise(node.UNAVAILABLE_SENSORS, node.STRING_TYPE))
        self._own_topics = ", ".join([*own, *(self._topics[metric] for metric in sources)])
        self._timer.set_rate(self._values["publish_rate"])

    def _publish(self, now_s: float) -> None:
        for metric, source in self._sources.items():
            try:
                value = source.read(now_s)
            except NotMeasuredYet:
                continue
            except Exception as raised:  # one broken source must not stop the others
                error = raised if isinstance(raised, SensorError) else SensorError(f"{type(raised).__name__}: {raised}")
                if metric not in self._failed:
                    named = {*configuration.METRICS, *(self._tree.get(configuration.HOST_SECTION) or {}), *self._seen}
                    # The preset is for any machine.
                    is_expected = isinstance(error, NoSuchSensor) and metric not in named
                    severity = Severity.INFO if is_expected else Severity.WARN
                    self._middleware.log(severity, f"{metric} is not published: {error}")
                self._failed[metric] = error
                continue
            self._seen.add(metric)
            if self._failed.pop(metric, None):
                self._middleware.log(Severity.INFO, f"{metric} can be read again")
            self._middleware.publish(metric, {"data": value})

    def _publish_simulated(self) -> None:
        topics = [self._topics[metric] for metric in self._simulated]
        self._middleware.publish(node.SIMULATED_SENSORS, {"data": ", ".join(topics)})

    def _publish_status(self, now_s: float) -> None:
        self._publish_simulated()
        without_sensor = [metric for metric, error in self._failed.items() if isinstance(error, NoSuchSensor)]
        unavailable = [metric for metric in without_sensor if metric not in self._seen]
        if "host" in self._kinds.values():
            self._middleware.publish(node.UNAVAILABLE_SENSORS, {"data": ", ".join(unavailable)})
        node.publish_statuses(self._middleware, lambda: [self._status(unavailable)])

    def _status(self, unavailable: list[str]) -> Status:
        broken = [metric for metric in self._failed if metric not in unavailable]
        values = {"simulated": "true" if self._simulated else "false", **self._kinds, OWN_TOPICS: self._own_topics}
        values.update((metric, f"not published: {error}") for metric, error in self._failed.items())
        if broken:
            level, message = Level.WARN, f"cannot read {', '.join(broken)}"
        elif self._simulated:
            level, message = Level.OK, f"simulated values: {', '.join(self._simulated)}"
        else:
            level, message = Level.OK, f"{len(self._sources) - len(self._failed)} metrics published"
        return Status("sensors", level, message, self._robot, values)

    def _reconfigure(self, tree: JsonObject) -> str:
        values, sources = _read_sensor(tree, self._computer)
        old, old_settings = self._values, self._settings
        node.refuse_changes(old, values, except_for=("sensors",))
        if tree.get("seed") == self._tree.get("seed"):
            same = {
                metric
                for metric, settings in configuration.settings_of(tree).items()
                if settings == old_settings.get(metric)
            }
            sources.update((metric, source) for metric, source in self._sources.items() if metric in same)
        self._values = values
        self._failed = {metric: error for metric, error in self._failed.items() if metric in sources}
        self._use(tree, sources)
        return node.describe_changes({"": old, **old_settings}, {"": values, **self._settings})


def _read_sensor(tree: JsonObject, computer: Computer) -> tuple[dict[str, Any], dict[str, Source]]:
    """Returns the values of the node's own parameters, and the source of each metric; raises all mistakes at once."""
    problems = Problems()
    values: dict[str, Any] = {}
    sources: dict[str, Source] = {}
    with problems:
        values = read_parameters(tree, SENSOR_PARAMETERS, sections=configuration.SECTION_NAMES)
    if problems.errors:  # those of these keys are known; they would be found again with every metric
        tree = {key: value for key, value in tree.items() if key in configuration.SECTION_NAMES}
    with problems:
        sources = configuration.read_sources(tree, computer=computer)
    problems.raise_if_any()
    return values, sources
