"""The three nodes, written once against the port: what they subscribe to, publish, offer and when.

Each reads its parameters and starts in its constructor, or raises ConfigError before it has subscribed to anything.
"""

from __future__ import annotations

import math
import platform
from typing import Any, Callable, Dict, List, Mapping, Optional, Set, Tuple

from . import sensing
from .config import (
    DEFAULT_SIGNALS,
    NODE_PARAMETERS,
    MonitorConfig,
    SignalConfig,
    described_parameters,
    load_config,
    read_signal,
)
from .diagnostics import ARRAY_TYPE, STATUS_TYPE, alert_message, array_message
from .middleware import Message, Middleware, Severity, Subscription, Timer
from .model import Level, Sample, Status, Transition
from .monitor import Monitor
from .parameters import ConfigError, Parameter, read_parameters
from .score import health_score
from .signal_monitor import LINK
from .wording import bound_text, number_text, with_unit

FLOAT_TYPE = "std_msgs/Float32"
TRIGGER_TYPE = "std_srvs/Trigger"
DIAGNOSTICS = "/diagnostics"
TICK_PERIOD_S = 1.0

SENSOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("sensor_name", str, "robot", "name of the sensor, for the log"),
    Parameter("publish_rate", float, 1.0, "rate of every metric in Hz", 0.01, 1000.0),
    sensing.SEED,
)
"""What battery_sensor can be told besides its metrics, which `sensing.SECTIONS` lists."""

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

_SEVERITY_OF_LEVEL = {
    Level.OK: Severity.INFO,
    Level.WARN: Severity.WARN,
    Level.ERROR: Severity.ERROR,
    Level.STALE: Severity.WARN,
}


class AlertSystem:
    """Judges every configured signal; logs and publishes each transition once, and its whole state every second.

    A transition brings the status of its signal to /diagnostics at once.
    """

    def __init__(self, middleware: Middleware, on_transition: Optional[Callable[[Transition], None]] = None) -> None:
        """Starts watching.

        Args:
            middleware: the node's connection.
            on_transition: called with every transition, besides the log and the topics.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self._middleware = middleware
        self._on_transition = on_transition
        self._node = _base_name(middleware)
        given = middleware.given_parameters()
        config = _read_monitor_config(given)
        self.monitor = Monitor(config, config.robot_name or platform.node())
        """The monitor, for whoever wants to look at it."""
        self._subscriptions: Dict[Tuple[str, str, str, str], Subscription] = {}
        middleware.declare_parameters(described_parameters(config), self._reconfigure)
        middleware.advertise("alerts", STATUS_TYPE)
        middleware.advertise(DIAGNOSTICS, ARRAY_TYPE)
        self._follow_topics(config)
        middleware.advertise_service("~reset", TRIGGER_TYPE, self._reset)
        middleware.create_timer(TICK_PERIOD_S, self._tick)
        self._report_timer = middleware.create_timer(1.0 / config.publish_rate, self._report)
        if "signals" not in given:
            middleware.log(Severity.INFO, "no signals are configured: watching the three of the defaults")
        for signal in config.signals.values():
            middleware.log(Severity.INFO, f"watching {_summary(signal)}")

    def observe(self, sample: Sample) -> None:
        """Judges a sample that does not come from a topic, such as that of the signal `link`."""
        self._announce(self.monitor.observe(sample), sample.now_s)

    def close(self) -> None:
        """Leaves the middleware."""
        self._middleware.close()

    def _follow_topics(self, config: MonitorConfig) -> None:
        """Subscribes to what is not subscribed to yet, and when all of that worked, ends what is no longer wanted."""
        wanted = {
            (name, signal.topic, signal.type, signal.field) for name, signal in config.signals.items() if name != LINK
        }
        added: Dict[Tuple[str, str, str, str], Subscription] = {}
        try:
            # Those that say most about a topic come first: what only counts its messages can then share them.
            for key in sorted(wanted - self._subscriptions.keys(), key=lambda key: (key[3] == "", key[2] == "", key)):
                name, topic, type_name, field = key
                added[key] = self._subscribe(name, topic, type_name, field)
        except ConfigError:
            for subscription in added.values():
                self._middleware.unsubscribe(subscription)
            raise
        for key in self._subscriptions.keys() - wanted:
            self._middleware.unsubscribe(self._subscriptions.pop(key))
        self._subscriptions.update(added)

    def _subscribe(self, name: str, topic: str, type_name: str, field: str) -> Subscription:
        try:
            return self._middleware.subscribe(topic, type_name, self._observer(name), field=field or None)
        except ConfigError as error:
            raise ConfigError(error.problem, ("signals", name)) from None

    def _observer(self, name: str) -> Callable[[Any, float], None]:
        take, notices, announce = self.monitor.take, self.monitor.notices, self._announce

        def callback(value: Any, now_s: float) -> None:
            transitions = take(name, value, now_s)
            if transitions or notices:
                announce(transitions, now_s)

        return callback

    def _tick(self, now_s: float) -> None:
        transitions = self.monitor.tick(now_s)
        if transitions or self.monitor.notices:
            self._announce(transitions, now_s)

    def _report(self, now_s: float) -> None:
        if self._middleware.has_listeners(DIAGNOSTICS):
            self._middleware.publish(
                DIAGNOSTICS, array_message(self.monitor.report(now_s).statuses.values(), self._node)
            )

    def _announce(self, transitions: List[Transition], now_s: float) -> None:
        for notice in self.monitor.notices:
            self._middleware.log(Severity.INFO, notice)
        self.monitor.notices.clear()
        for transition in transitions:
            self._middleware.log(_SEVERITY_OF_LEVEL[transition.to_level], transition.text)
            self._middleware.publish("alerts", alert_message(transition, self._node))
            if self._on_transition is not None:
                self._on_transition(transition)
        if transitions:
            # Only what changed: when a hundred signals come back one by one, a hundred whole reports would be too many.
            changed = dict.fromkeys(transition.signal for transition in transitions)
            statuses = [self.monitor.status(signal, now_s) for signal in changed]
            known = [status for status in statuses if status is not None]
            self._middleware.publish(DIAGNOSTICS, array_message(known, self._node))

    def _reset(self, request: Message) -> Message:
        transitions = self.monitor.reset()
        self._announce(transitions, self._middleware.now_s())
        cleared = ", ".join(transition.signal for transition in transitions) or "nothing was latched"
        return {"success": True, "message": f"reset: {cleared}"}

    def _reconfigure(self, tree: Mapping[str, Any]) -> None:
        old = self.monitor.config
        config = _read_monitor_config(tree)
        for name in ("robot_name", "rosbridge_port", "rosbridge_address", "rosbridge_token"):
            _refuse_new(name, getattr(old, name), getattr(config, name))
        self._follow_topics(config)
        if config.publish_rate != old.publish_rate:
            self._report_timer.cancel()
            self._report_timer = self._middleware.create_timer(1.0 / config.publish_rate, self._report)
        self._announce(self.monitor.configure(config), self._middleware.now_s())


class Aggregator:
    """Averages the three metrics into `system_health` and publishes the statistics of each on /diagnostics."""

    def __init__(self, middleware: Middleware) -> None:
        """Starts listening.

        Raises:
            ConfigError: the configuration cannot be used.
        """
        self._middleware = middleware
        self._node = _base_name(middleware)
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
        take = self._monitor.take

        def callback(value: Any, now_s: float) -> None:
            take(name, value, now_s)

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

    def _reconfigure(self, tree: Mapping[str, Any]) -> None:
        values = read_parameters(tree, AGGREGATOR_PARAMETERS)
        _refuse_new("robot_name", self._values["robot_name"], values["robot_name"])
        self._thresholds = _read_thresholds(values)
        self._monitor.configure(_window_config(values))
        if values["publish_rate"] != self._values["publish_rate"]:
            self._timer.cancel()
            self._timer = self._middleware.create_timer(1.0 / values["publish_rate"], self._publish)
        self._values = values


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

    def _reconfigure(self, tree: Mapping[str, Any]) -> None:
        values = _read_sensor(tree)
        _refuse_new("robot_name", self._values["robot_name"], values["robot_name"])
        sources = sensing.read_sources(tree)
        for metric in sources.keys() & self._sources.keys():
            old, new = (sensing.section_of(of, metric) for of in (self._tree, tree))
            if new == old and tree.get("seed") == self._tree.get("seed"):
                sources[metric] = self._sources[metric]
        rate_changed = values["publish_rate"] != self._values["publish_rate"]
        self._tree, self._values, self._sources = tree, values, sources
        self._failed &= sources.keys()
        self._advertise()
        if rate_changed:
            self._timer.cancel()
            self._timer = self._start_timer()


def _base_name(middleware: Middleware) -> str:
    return middleware.name.rpartition("/")[2]


def _refuse_new(name: str, old: object, new: object) -> None:
    if new != old:
        raise ConfigError("can only be given at the start", (name,))


def _read_monitor_config(tree: Mapping[str, Any]) -> MonitorConfig:
    return load_config(tree if "signals" in tree else {**tree, "signals": DEFAULT_SIGNALS})


def _read_sensor(tree: Mapping[str, Any]) -> Dict[str, Any]:
    return read_parameters(tree, SENSOR_PARAMETERS, sections=(*sensing.SECTIONS, sensing.HOST))


def _read_thresholds(values: Mapping[str, Any]) -> Mapping[str, SignalConfig]:
    """Returns the signals whose thresholds the score uses: those of the file, or the defaults."""
    signals = {name: read_signal(name, signal) for name, signal in DEFAULT_SIGNALS.items()}
    if values["method"] == "score" and values["thresholds"]:
        signals.update(load_config(values["thresholds"]).signals)
    return signals


def _window_config(values: Mapping[str, Any]) -> MonitorConfig:
    settings = {name: values[name] for name in ("window_s", "stale_after_s")}
    return MonitorConfig({name: read_signal(name, settings) for name in INPUTS})


def _summary(signal: SignalConfig) -> str:
    bounds = [
        f"{name.replace('_', ' ').upper().replace('BELOW', 'below').replace('ABOVE', 'above')} "
        + with_unit(bound_text(bound), signal.unit)
        for name, bound in signal.bounds.items()
    ]
    return f"{signal.name} on {signal.topic}" + (f": {', '.join(bounds)}" if bounds else "")
