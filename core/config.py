"""Configuration of the monitor: a mapping or a `thresholds.yaml` becomes frozen values.

`SIGNAL_PARAMETERS` is the one list of what a signal can be told; `SignalConfig` holds the values. Every error names
the key's path and, where a file was read, file and line.
"""

from __future__ import annotations

import difflib
import math
import os
import re
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple, Union

from .errors import ConfigError, Path
from .formatting import bound_text, number_text
from .parameters import Parameter, describe, read_parameters, require_mapping
from .yaml_file import PathLike, read_yaml

STATISTICS = ("last", "mean", "min", "max", "stddev", "rate", "frequency_hz")
"""What a bound can be applied to."""

BOUNDS = ("warn_below", "warn_above", "error_below", "error_above")

NODE_PARAMETERS = (
    Parameter("robot_name", str, "", "the robot's name: hardware_id of everything published; empty: the host's name"),
    Parameter("thresholds", str, "", "path of the file that this configuration came from, for error messages"),
    Parameter("use_sim_time", bool, False, "take the time from /clock"),
    Parameter(
        "log_level", str, "INFO", "least severe log lines to write", choices=("DEBUG", "INFO", "WARN", "ERROR", "FATAL")
    ),
    Parameter(
        "executor",
        str,
        "single",
        "ROS 2 only: single, or events (rclpy's experimental EventsExecutor, which needs less CPU)",
        choices=("single", "events"),
    ),
    Parameter("rosbridge_port", int, 0, "port on which alert_system serves rosbridge clients; 0: none", 0, 65535),
    Parameter("rosbridge_address", str, "127.0.0.1", "address of that server; any other one needs a token"),
    Parameter("rosbridge_token", str, "", "what its clients have to show; empty: nothing"),
)
"""What every node can be told; a launch file of ROS 2 tells all nodes of a process the same."""

MONITOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("publish_rate", float, 1.0, "rate of /diagnostics in Hz", 0.01, 100.0),
)
"""What alert_system can be told besides its signals."""

SIGNAL_PARAMETERS = (
    Parameter("topic", str, None, "topic to listen on; left out: the signal's name"),
    Parameter("type", str, "", "type of the topic's messages; left out: the middleware is asked"),
    Parameter("field", str, "data", "path of the number inside the message; empty: only arrivals count, each a 1"),
    Parameter("scale", float, 1.0, "what the number is multiplied with to be in the unit"),
    Parameter("unit", str, "", "unit of the value, shown to people"),
    Parameter("placeholders", list, (), "numbers that mean 'not measured', as they come: invalid data"),
    Parameter("valid_min", float, None, "smallest value that can be true, in the unit; below it the data is invalid"),
    Parameter("valid_max", float, None, "largest value that can be true, in the unit; above it the data is invalid"),
    Parameter("invalid_for_s", float, 0.0, "how long data must be invalid before it is an ERROR, in s", 0.0),
    Parameter("window_s", float, 60.0, "length of the window for statistics, in s", 0.001),
    Parameter("window_samples", int, 6000, "most samples that the window keeps", 1, 1_000_000),
    Parameter("statistic", str, "last", "statistic of the window that the bounds apply to", choices=STATISTICS),
    Parameter("warn_below", float, None, "WARN below this value, in the statistic's unit"),
    Parameter("warn_above", float, None, "WARN above this value, in the statistic's unit"),
    Parameter("error_below", float, None, "ERROR below this value, in the statistic's unit"),
    Parameter("error_above", float, None, "ERROR above this value, in the statistic's unit"),
    Parameter(
        "hysteresis", float, 0.0, "how far back on the healthy side a bound clears, in the statistic's unit", 0.0
    ),
    Parameter("for_s", float, 0.0, "how long a bound must be crossed before it fires, in s", 0.0),
    Parameter("keep_firing_for_s", float, 0.0, "how long it must be back before it clears, in s", 0.0),
    Parameter("error_for_s", float, None, "for_s of the ERROR bounds, in s; left out: for_s", 0.0),
    Parameter("error_keep_firing_for_s", float, None, "the same for keep_firing_for_s, in s", 0.0),
    Parameter("latch", bool, False, "keep the worst level that fired until reset"),
    Parameter("flap_detection", bool, False, "announce a signal that changes too often once, not each time"),
    Parameter("flap_high", float, 50.0, "flapping begins at this state change, in %", 0.0, 100.0),
    Parameter("flap_low", float, 25.0, "flapping ends below this state change, in %", 0.0, 100.0),
    Parameter("stale_after_s", float, 5.0, "STALE after this long without a sample, in s; 0: never", 0.0),
    Parameter("startup_grace_s", float, 10.0, "the same before the first sample ever, in s", 0.0),
    Parameter("repeat_s", float, 0.0, "announce a level that is not OK again this often, in s; 0: once", 0.0),
)
"""What a signal can be told, each with unit and range."""

CONDITION_PARAMETERS = (
    Parameter("signal", str, None, "name of the other signal"),
    Parameter("is", float, None, "true while the other signal is this value, in its unit"),
    Parameter("is_not", float, None, "true while it is another value"),
    Parameter("below", float, None, "true while it is below this value"),
    Parameter("above", float, None, "true while it is above this value"),
)
"""What a condition on another signal can be told: the signal and one comparison."""

CONDITIONS: Mapping[str, str] = {
    "only_if": "the bounds count only while this holds, or while the other signal is not known",
    "latch_release_if": "a latch is released while this holds, as `reset` would",
}
"""The conditions on other signals that a signal can have."""

DEFAULT_SIGNALS: Mapping[str, Mapping[str, Any]] = {
    "battery_level": {
        "type": "std_msgs/Float32", "unit": "%", "valid_min": 0.0, "valid_max": 100.0,
        "warn_below": 20.0, "error_below": 10.0, "hysteresis": 2.0,
    },
    "temperature": {
        "type": "std_msgs/Float32", "unit": "degC", "valid_min": -40.0, "valid_max": 150.0,
        "warn_above": 80.0, "error_above": 95.0, "hysteresis": 2.0,
    },
    "cpu_usage": {
        "type": "std_msgs/Float32", "unit": "%", "valid_min": 0.0, "valid_max": 100.0,
        "warn_above": 95.0, "hysteresis": 5.0, "for_s": 5.0,
    },
}  # fmt: skip
"""What is watched when nothing is configured: the same as `config/thresholds.yaml` says."""

_CONDITION_PARAMETERS = tuple(
    replace(parameter, name=f"{key}.{parameter.name}", description=f"{meaning}: {parameter.description}")
    for key, meaning in CONDITIONS.items()
    for parameter in CONDITION_PARAMETERS
)

_UNIT_RANGES: Mapping[str, Tuple[Optional[float], Optional[float]]] = {
    "%": (0.0, 100.0),
    "degC": (-273.15, None),
    "°C": (-273.15, None),
    "C": (-273.15, None),
    "K": (0.0, None),
    "Hz": (0.0, None),
}
"""Units whose values cannot lie everywhere: (smallest, largest)."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")


@dataclass(frozen=True)
class Condition:
    """A condition on the latest value of another signal."""

    signal: str
    """The other signal's name."""
    comparison: str
    """`is`, `is_not`, `below` or `above`."""
    number: float
    """What its value is compared with, in its unit."""

    def __str__(self) -> str:
        comparison = {"is": "is", "is_not": "is not"}.get(self.comparison, f"is {self.comparison}")
        return f"{self.signal} {comparison} {bound_text(self.number)}"

    def holds(self, value: float) -> bool:
        """Says whether it is true for this value of the other signal."""
        if self.comparison in ("is", "is_not"):
            # Float32 brings 0.1 as 0.1000000015
            return math.isclose(value, self.number, rel_tol=1e-6) is (self.comparison == "is")
        return value < self.number if self.comparison == "below" else value > self.number


@dataclass(frozen=True)
class SignalConfig:
    """One signal: where it comes from and how it is judged. `SIGNAL_PARAMETERS` says what each field means."""

    name: str
    topic: str
    type: str
    field: str
    scale: float
    unit: str
    placeholders: Tuple[float, ...]
    valid_min: Optional[float]
    valid_max: Optional[float]
    invalid_for_s: float
    window_s: float
    window_samples: int
    statistic: str
    warn_below: Optional[float]
    warn_above: Optional[float]
    error_below: Optional[float]
    error_above: Optional[float]
    hysteresis: float
    for_s: float
    keep_firing_for_s: float
    error_for_s: float
    error_keep_firing_for_s: float
    latch: bool
    flap_detection: bool
    flap_high: float
    flap_low: float
    stale_after_s: float
    startup_grace_s: float
    repeat_s: float
    only_if: Optional[Condition] = None
    latch_release_if: Optional[Condition] = None

    @property
    def bounds(self) -> Mapping[str, float]:
        """The bounds that are set, by their configuration names."""
        return {name: getattr(self, name) for name in BOUNDS if getattr(self, name) is not None}


@dataclass(frozen=True)
class MonitorConfig:
    """Everything that a Monitor and the alert_system node are told."""

    signals: Mapping[str, SignalConfig]
    """By name, in the order of the configuration."""
    robot_name: str = ""
    """`hardware_id` of everything published; empty: the node takes the host's name."""
    publish_rate: float = 1.0
    """Rate of /diagnostics, in Hz."""
    rosbridge_port: int = 0
    """Port of the rosbridge server that the ROS nodes run; 0: none."""
    rosbridge_address: str = "127.0.0.1"
    """Its address."""
    rosbridge_token: str = ""
    """What its clients have to show; empty: nothing."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", MappingProxyType(dict(self.signals)))


class Section(NamedTuple):
    """One node's part of a configuration file."""

    path: Path
    """Keys from the root of the file down to the parameters."""
    tree: Mapping[str, Any]
    """What stands under `ros__parameters`."""


def load_config(source: Union[Mapping[str, Any], PathLike], node: str = "alert_system") -> MonitorConfig:
    """Reads the configuration of a monitor.

    Args:
        source: the mapping under `ros__parameters`, the mapping of a whole file, or a file's path.
        node: whose section of a whole file to read; if there is none of that name, the only one with `signals`.

    Raises:
        ConfigError: an unknown key, a wrong type, contradictory bounds, a unit that cannot be right, or a file that
            cannot be read. The message names file, line, key path, what was found and what is allowed.
    """
    if isinstance(source, (str, os.PathLike)):
        read = read_yaml(source)
        try:
            return _load_section(_find_section(read.tree, node))
        except ConfigError as error:
            raise read.locate(error) from None
    tree = require_mapping(source)
    return _load_section(_find_section(tree, node) if is_whole_file(tree) else Section((), tree))


def is_whole_file(tree: Mapping[str, Any]) -> bool:
    """Says whether `tree` is a whole file's mapping, with node names above `ros__parameters`."""
    return any(True for _ in _sections(tree, ()))


def sections(tree: Mapping[str, Any]) -> Dict[str, Section]:
    """Returns the parts of a whole file by node name, the last part of it where it has a namespace."""
    return {section.path[-2].rpartition("/")[2]: section for section in _sections(tree, ())}


def _sections(tree: Mapping[str, Any], path: Path) -> List[Section]:
    found: List[Section] = []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            if "ros__parameters" in value:
                below = (*path, str(key), "ros__parameters")
                found.append(Section(below, require_mapping(value["ros__parameters"], below)))
            elif len(path) < 8:
                found.extend(_sections(value, (*path, str(key))))
    return found


def _find_section(tree: Mapping[str, Any], node: str) -> Section:
    of_node = [section for section in _sections(tree, ()) if section.path[-2].rpartition("/")[2] == node]
    if len(of_node) > 1:
        places = " and ".join(".".join(section.path[:-1]) for section in of_node)
        raise ConfigError(f"found {places}, allowed is one {node} in a file: one file per robot")
    if of_node:
        return of_node[0]
    found = sections(tree)
    with_signals = [section for section in found.values() if "signals" in section.tree]
    if len(with_signals) == 1:
        return with_signals[0]
    if isinstance(tree.get(node), Mapping):
        for key in tree[node]:
            if difflib.get_close_matches(str(key), ["ros__parameters"]):
                raise ConfigError("unknown key; did you mean ros__parameters, with two underscores?", (node, str(key)))
        raise ConfigError("found no ros__parameters, allowed is that key above the parameters", (node,))
    there = ", ".join(tree) or "nothing"
    raise ConfigError(f"found {there}, allowed is one node with ros__parameters.signals, usually {node}")


def _load_section(section: Section) -> MonitorConfig:
    path, tree = section
    values = read_parameters(tree, MONITOR_PARAMETERS, path, ("signals", "qos_overrides"))
    signals_path = (*path, "signals")
    if "signals" not in tree:
        raise ConfigError("is missing, allowed is a mapping of signal names to what is known of each", signals_path)
    signals = require_mapping(tree["signals"], signals_path)
    if not signals:
        raise ConfigError("found no signal, allowed is at least one", signals_path)
    read = {name: read_signal(name, signal, (*signals_path, name)) for name, signal in signals.items()}
    for name, signal in read.items():
        for key in CONDITIONS:
            condition = getattr(signal, key)
            others = [other for other in (*read, "link") if other != name]
            if condition is not None and condition.signal not in others:
                raise ConfigError(
                    f"found {describe(condition.signal)}, allowed is another signal: {', '.join(others)}",
                    (*signals_path, name, key, "signal"),
                )
    settings = {field.name: values[field.name] for field in fields(MonitorConfig) if field.name in values}
    return MonitorConfig(read, **settings)


def read_signal(name: str, found: object, path: Path = ()) -> SignalConfig:
    """Reads the configuration of one signal.

    Raises:
        ConfigError: as `load_config` does.
    """
    if not _NAME.match(name):
        raise ConfigError("is no signal name, allowed are letters, digits and _, not beginning with a digit", path)
    tree = require_mapping(found, path)
    values = read_parameters(tree, SIGNAL_PARAMETERS, path, tuple(CONDITIONS))
    values.update((key, _read_condition(tree[key], (*path, key))) for key in CONDITIONS if key in tree)
    if values["scale"] == 0.0:
        raise ConfigError("found 0, allowed is any other number", (*path, "scale"))
    if values["topic"] is None:
        values["topic"] = name
    for key in ("for_s", "keep_firing_for_s"):
        if values[f"error_{key}"] is None:
            values[f"error_{key}"] = values[key]
    if values["flap_low"] > values["flap_high"]:
        raise ConfigError(
            f"found flap_low {bound_text(values['flap_low'])} and flap_high {bound_text(values['flap_high'])},"
            " allowed is flap_low at most flap_high: flapping would end before it begins",
            (*path, "flap_low" if "flap_low" in tree else "flap_high"),
        )
    signal = SignalConfig(name=name, **values)
    _check_order(signal, path)
    _check_unit(signal, path)
    return signal


def _read_condition(found: object, path: Path) -> Condition:
    values = read_parameters(require_mapping(found, path), CONDITION_PARAMETERS, path)
    signal = values.pop("signal")
    if signal is None:
        raise ConfigError("is missing, allowed is the name of another signal", (*path, "signal"))
    comparisons = {name: number for name, number in values.items() if number is not None}
    if len(comparisons) != 1:
        found_text = " and ".join(comparisons) or "no comparison"
        raise ConfigError(f"found {found_text}, allowed is one of {', '.join(values)}", path)
    ((comparison, number),) = comparisons.items()
    return Condition(signal, comparison, number)


def _check_order(signal: SignalConfig, path: Path) -> None:
    def refuse_above(low: str, high: str, why: str) -> None:
        low_value, high_value = getattr(signal, low), getattr(signal, high)
        if low_value is not None and high_value is not None and low_value > high_value:
            allowed = f"at most {high} ({bound_text(high_value)}): {why}"
            raise ConfigError(f"found {bound_text(low_value)}, allowed is {allowed}", (*path, low))

    refuse_above("valid_min", "valid_max", "no value would be valid")
    refuse_above("error_below", "warn_below", "a value falls below the WARN bound first")
    refuse_above("warn_above", "error_above", "a value rises above the WARN bound first")
    lows = [name for name in ("warn_below", "error_below") if getattr(signal, name) is not None]
    highs = [name for name in ("warn_above", "error_above") if getattr(signal, name) is not None]
    for low in lows:
        for high in highs:
            refuse_above(low, high, "no value would be healthy")
            room = getattr(signal, high) - getattr(signal, low)
            if signal.hysteresis > room:
                raise ConfigError(
                    f"found {bound_text(signal.hysteresis)}, allowed is at most {number_text(room)}:"
                    f" {low} would clear above {high}",
                    (*path, "hysteresis"),
                )
    if signal.statistic not in ("last", "mean", "min", "max"):
        return
    for name, bound in signal.bounds.items():
        _check_range(name, bound, signal.valid_min, signal.valid_max, "valid_min", "valid_max", path)
        clears_at = bound + signal.hysteresis if name in lows else bound - signal.hysteresis
        if (signal.valid_max is not None and clears_at > signal.valid_max) or (
            signal.valid_min is not None and clears_at < signal.valid_min
        ):
            raise ConfigError(
                f"found {bound_text(signal.hysteresis)}, allowed is less:"
                f" {name} would clear at {number_text(clears_at)}, which is no valid value",
                (*path, "hysteresis"),
            )


def _check_range(
    name: str, found: float, low: Optional[float], high: Optional[float], low_name: str, high_name: str, path: Path
) -> None:
    if low is not None and found < low:
        allowed = f"{bound_text(low)} ({low_name}) or more"
        raise ConfigError(f"found {bound_text(found)}, allowed is {allowed}", (*path, name))
    if high is not None and found > high:
        allowed = f"{bound_text(high)} ({high_name}) or less"
        raise ConfigError(f"found {bound_text(found)}, allowed is {allowed}", (*path, name))


def _check_unit(signal: SignalConfig, path: Path) -> None:
    low, high = _UNIT_RANGES.get(signal.unit, (None, None))
    limits = {name: getattr(signal, name) for name in ("valid_min", "valid_max")}
    if signal.statistic in ("last", "mean", "min", "max"):
        limits.update(signal.bounds)
    for name, value in limits.items():
        if value is not None:
            unit = f"least of {describe(signal.unit)}", f"most of {describe(signal.unit)}"
            _check_range(name, value, low, high, *unit, path)
    if signal.unit == "%" and signal.valid_max is not None and signal.valid_max <= 1.0:
        raise ConfigError(
            f"found '%' with valid_max {bound_text(signal.valid_max)}, allowed is valid_max 100 for a percentage;"
            " a fraction from 0 to 1 has the unit ''",
            (*path, "unit"),
        )


def described_parameters(config: MonitorConfig) -> Tuple[Parameter, ...]:
    """Returns every parameter of a node with this configuration, by its dotted name, for a middleware to declare."""
    return MONITOR_PARAMETERS + tuple(
        replace(parameter, name=f"signals.{name}.{parameter.name}")
        for name in config.signals
        for parameter in (*SIGNAL_PARAMETERS, *_CONDITION_PARAMETERS)
    )
