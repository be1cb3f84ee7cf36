"""aggregator: averages its inputs into `system_health`, with the statistics of each on /diagnostics."""

from __future__ import annotations

import math
import re
from functools import partial
from typing import Any, Mapping

from ..config import (
    DEFAULT_SIGNALS,
    LONGEST_S,
    NODE_PARAMETERS,
    MonitorConfig,
    Parameter,
    SignalConfig,
    load_config,
    read_parameters,
    read_signal,
)
from ..judge import Monitor
from ..port import Middleware, Severity, Subscription
from ..sensors.configuration import METRICS
from ..values import ARRAY_TYPE, OWN_TOPICS, ConfigError, JsonObject, Level, Sample, Status, number_text
from .node import DIAGNOSTICS, FLOAT_TYPE, RateTimer, describe_changes, host_name, publish_statuses, refuse_changes

AGGREGATOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("publish_rate", float, 1.0, "rate of system_health and /diagnostics in Hz", 0.01, 100.0),
    Parameter("window_s", float, 60.0, "length of the window of the statistics in s", 0.001, LONGEST_S),
    Parameter(
        "stale_after_s", float, 5.0, "an input without a sample for longer than this is missing, in s", 0.001, LONGEST_S
    ),
    Parameter("inputs", tuple, tuple(METRICS), "topics that are averaged, Float32; []: nothing is published"),
    Parameter(
        "method",
        str,
        "mean",
        "mean: average of the values; score: average of the values mapped to 0..100 by their thresholds",
        choices=("mean", "score"),
    ),
)
"""Parameters of aggregator."""

_MAX_INPUTS = 100


def has_inputs(parameters: JsonObject) -> bool:
    """Returns whether an aggregator with these parameters has something to average.

    Its default inputs are the metrics of battery_sensor, which does not run with `sensors: none`.
    """
    return parameters.get("sensors") != "none" or "inputs" in parameters


class Aggregator:
    """Publishes the average of its inputs, only while all of them are fresh, and statistics of each."""

    def __init__(self, middleware: Middleware) -> None:
        """Starts listening; raises ConfigError if the configuration cannot be used."""
        self._middleware = middleware
        self._subscriptions: dict[str, Subscription] = {}
        self._timer = RateTimer(middleware, self._publish)
        values = read_parameters(middleware.given_parameters(), AGGREGATOR_PARAMETERS)
        self._monitor = Monitor(MonitorConfig({}), values["robot_name"] or host_name())
        self._topic = middleware.advertise("system_health", FLOAT_TYPE)
        middleware.advertise(DIAGNOSTICS, ARRAY_TYPE)
        self._use(values)
        middleware.declare_parameters(AGGREGATOR_PARAMETERS, self._reconfigure)
        inputs = ", ".join(self._values["inputs"])
        health = f"is the {self._values['method']} of {inputs}" if inputs else "is not published: inputs is empty"
        middleware.log(Severity.INFO, f"system_health {health}")

    def close(self) -> None:
        """Leaves the middleware."""
        self._middleware.close()

    def _use(self, values: dict[str, Any]) -> None:
        """Averages by these parameters from now on."""
        inputs = _signal_names(values["inputs"])
        self._thresholds = _read_thresholds(values, inputs)
        settings = {name: values[name] for name in ("window_s", "stale_after_s")}
        signals = {name: read_signal(name, {**settings, "topic": topic}) for name, topic in inputs.items()}
        self._monitor.configure(MonitorConfig(signals))
        self._values, self._inputs = values, inputs
        for topic in self._subscriptions.keys() - set(inputs.values()):
            self._middleware.unsubscribe(self._subscriptions.pop(topic))
        for name, topic in inputs.items():
            if topic not in self._subscriptions:
                take = partial(self._take, name)
                self._subscriptions[topic] = self._middleware.subscribe(topic, FLOAT_TYPE, take, field="data")
        self._timer.set_rate(values["publish_rate"])

    def _take(self, name: str, value: Any, now_s: float) -> None:
        self._monitor.observe(Sample(name, value, now_s))

    def _publish(self, now_s: float) -> None:
        if not self._inputs:
            return
        self._monitor.tick(now_s)
        fresh = {name: self._monitor.fresh_value(name) for name in self._inputs}
        missing = [topic for name, topic in self._inputs.items() if fresh[name] is None]
        values = {name: value for name, value in fresh.items() if value is not None}
        if self._values["method"] == "score":
            values = {name: health_score(value, self._thresholds[name]) for name, value in values.items()}
        if missing:
            level, message = Level.STALE, f"not published: no fresh {' and no fresh '.join(missing)}"
        else:
            health = math.fsum(values.values()) / len(values)
            level, message = Level.OK, f"{self._values['method']} is {number_text(health)}"
            self._middleware.publish("system_health", {"data": health})
        key_values = {"method": self._values["method"], "missing": ", ".join(missing), OWN_TOPICS: self._topic}
        key_values.update((self._inputs[name], number_text(value)) for name, value in values.items())
        status = Status("system_health", level, message, self._monitor.robot, key_values)
        publish_statuses(self._middleware, lambda: [*self._monitor.report(now_s).statuses.values(), status])

    def _reconfigure(self, tree: JsonObject) -> str:
        old, values = self._values, read_parameters(tree, AGGREGATOR_PARAMETERS)
        refuse_changes(old, values, except_for=("thresholds",))
        self._use(values)
        return describe_changes({"": old}, {"": values})


def _signal_names(topics: tuple[str, ...]) -> dict[str, str]:
    """Returns the topics by the name of their signal: the topic itself where it is a signal's name."""
    names: dict[str, str] = {}
    if len(topics) > _MAX_INPUTS:
        raise ConfigError(f"expected at most {_MAX_INPUTS} topics, got {len(topics)}", ("inputs",))
    for topic in topics:
        name = re.sub(r"\W", "_", topic.strip("/~"), flags=re.ASCII)
        if name in names or not re.fullmatch(r"[/~]?(?!\d)\w+(/\w+)*", topic, re.ASCII):
            expected = "expected names of topics that differ in more than / and _"
            raise ConfigError(f"{expected}, got {topic!r}", ("inputs",))
        names[name] = topic
    return names


def _read_thresholds(values: JsonObject, inputs: Mapping[str, str]) -> Mapping[str, SignalConfig]:
    """Returns the thresholds that the score uses, by input: those of the file, else the defaults."""
    if values["method"] != "score":
        return {}
    known = {name: read_signal(name, signal) for name, signal in DEFAULT_SIGNALS.items()}
    if values["thresholds"]:
        known.update(load_config(values["thresholds"]).signals)
    by_topic = {signal.topic: signal for signal in known.values()}
    thresholds = {}
    for name, topic in inputs.items():
        signal = by_topic.get(topic) or known.get(name)
        if signal is None:
            raise ConfigError(f"expected signals with thresholds for method score, got {topic}", ("inputs",))
        thresholds[name] = signal
    return thresholds


def health_score(value: float, signal: SignalConfig) -> float:
    """Returns how healthy `value`, in the signal's unit, is by its thresholds, from 0 to 100.

    100 is the healthy end of the valid range, 50 the WARN bound, 0 the ERROR bound or, without one, the unhealthy end
    of the valid range; linear between them. A signal with bounds on both sides gets the worse of its two scores. A
    side without a WARN bound gives 100.
    """
    below = (signal.warn_below, signal.error_below, signal.valid_min, signal.valid_max)
    above = (signal.warn_above, signal.error_above, signal.valid_max, signal.valid_min)
    return min(_side_score(value, *below), _side_score(-value, *(None if end is None else -end for end in above)))


def _side_score(
    value: float, warn: float | None, error: float | None, worst: float | None, best: float | None
) -> float:
    if warn is None:
        return 100.0
    zero = worst if error is None else error
    if value >= warn:
        return 100.0 if best is None or value >= best else 50.0 + 50.0 * (value - warn) / (best - warn)
    if zero is None:
        return 50.0
    return 0.0 if value <= zero or zero >= warn else 50.0 * (value - zero) / (warn - zero)
