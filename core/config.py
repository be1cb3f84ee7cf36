"""Configuration of the monitor: a mapping or a `thresholds.yaml` becomes frozen values.

`SIGNAL_PARAMETERS` lists the keys of a signal; `SignalConfig` holds their values. Every error names the key's path and,
for a file, file and line.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple, Union

from .errors import ConfigError, Path, Problems
from .field_path import parse_field_path
from .formatting import bound_text, number_text
from .middleware import split_type_name
from .parameters import Parameter, describe, read_parameters, require_mapping
from .standard_messages import check_field
from .yaml_file import PathLike, read_yaml

LINK = "link"
"""Name of the signal that is 1 while a robot can be reached, else 0. Reserved; conditions may refer to it."""

_RESERVED_NAMES = {LINK: "the link to the robot", "monitor": "the status of the monitor itself"}

STATISTICS = ("last", "mean", "min", "max", "stddev", "rate", "frequency_hz")
"""Statistics to which bounds can apply."""

BOUNDS = ("warn_below", "warn_above", "error_below", "error_above")

NODE_PARAMETERS = (
    Parameter("robot_name", str, "", "name of the robot: hardware_id of all messages; empty: the host name"),
    Parameter("thresholds", str, "", "path of the file that contains this configuration; used in error messages"),
    Parameter("use_sim_time", bool, False, "use the time from /clock instead of the system time"),
    Parameter(
        "log_level",
        str,
        "INFO",
        "lowest severity that is logged",
        choices=("DEBUG", "INFO", "WARN", "ERROR", "FATAL"),
    ),
    Parameter(
        "executor",
        str,
        "auto",
        "ROS 2 only: single (SingleThreadedExecutor), events (EventsExecutor, less CPU) or auto (events if it works)",
        choices=("auto", "single", "events"),
    ),
    Parameter(
        "sensors",
        str,
        "",
        "source of each metric of battery_sensor that names none: simulated, host or none; empty: simulated. "
        "none: health_monitor runs without battery_sensor, and without aggregator unless its inputs are configured",
        choices=("", "simulated", "host", "none"),
    ),
    Parameter("rosbridge_port", int, 0, "port of the rosbridge server of alert_system; 0: no server", 0, 65535),
    Parameter("rosbridge_address", str, "127.0.0.1", "address of the rosbridge server; any other one needs a token"),
    Parameter("rosbridge_token_file", str, "", "path of a file with the token that clients must present; empty: none"),
    Parameter("ops", str, "", "path of an ops.yaml (history, notifications, server); empty: none"),
)
"""Parameters common to all nodes: a ROS 2 launch file passes the same ones to all nodes of a process."""

MONITOR_PARAMETERS = (
    *NODE_PARAMETERS,
    Parameter("publish_rate", float, 1.0, "rate of /diagnostics, in Hz", 0.01, 100.0),
)
"""Parameters of alert_system, apart from its signals."""

_SIGNAL_PARAMETERS = (
    Parameter("topic", str, None, "topic of the signal; left out: the signal's name"),
    Parameter("type", str, "", "message type, such as std_msgs/Float32; left out: the type that is published"),
    Parameter("field", str, "data", "path of the number in the message; empty: count arrivals, the value is 1"),
    Parameter("scale", float, 1.0, "factor that converts the number to the unit"),
    Parameter("unit", str, "", "unit of the value, for display and plausibility checks"),
    Parameter("placeholders", list, (), "numbers that mean 'not measured', before scaling: invalid data"),
    Parameter("valid_min", float, None, "smallest valid value, in the unit; below it the data is invalid"),
    Parameter("valid_max", float, None, "largest valid value, in the unit; above it the data is invalid"),
    Parameter("invalid_for_s", float, 0.0, "time for which data must be invalid before it is an ERROR, in s", 0.0),
    Parameter("window_s", float, 60.0, "length of the window for statistics, in s", 0.001),
    Parameter(
        "window_min_s",
        float,
        None,
        "time for which samples must come before statistics other than last are defined, in s; left out: window_s / 2",
        0.0,
    ),
    Parameter("window_samples", int, 6000, "maximum number of samples in the window", 1, 1_000_000),
    Parameter("statistic", str, "last", "statistic of the window to which the bounds apply", choices=STATISTICS),
    Parameter("warn_below", float, None, "WARN below this value, in the unit of the statistic"),
    Parameter("warn_above", float, None, "WARN above this value, in the unit of the statistic"),
    Parameter("error_below", float, None, "ERROR below this value, in the unit of the statistic"),
    Parameter("error_above", float, None, "ERROR above this value, in the unit of the statistic"),
    Parameter(
        "hysteresis", float, 0.0, "distance from a bound at which its alert clears, in the unit of the statistic", 0.0
    ),
    Parameter("for_s", float, 0.0, "time for which a bound must be crossed before the alert fires, in s", 0.0),
    Parameter("keep_firing_for_s", float, 0.0, "time after the bound is no longer crossed until it clears, in s", 0.0),
    Parameter("error_for_s", float, None, "for_s of the ERROR bounds, in s; left out: for_s", 0.0),
    Parameter(
        "error_keep_firing_for_s",
        float,
        None,
        "keep_firing_for_s of the ERROR bounds, in s; left out: keep_firing_for_s",
        0.0,
    ),
    Parameter("latch", bool, False, "keep the worst level that fired until reset"),
    Parameter("flap_detection", bool, False, "announce a signal that changes too often once, not at each change"),
    Parameter("flap_high", float, 50.0, "state change at which flapping begins, in %", 0.0, 100.0),
    Parameter("flap_low", float, 25.0, "state change below which flapping ends, in %", 0.0, 100.0),
    Parameter("stale_after_s", float, 5.0, "time without a sample after which it is STALE, in s; 0: never", 0.0),
    Parameter("startup_grace_s", float, 10.0, "stale_after_s before the first sample, in s", 0.0),
    Parameter("repeat_s", float, 0.0, "interval of repeated announcements while not OK, in s; 0: none", 0.0),
)

LONGEST_S = 365.0 * 86_400.0
"""Longest duration in a configuration, in s: a year. Prometheus refuses much longer ones."""

SIGNAL_PARAMETERS = tuple(
    replace(parameter, maximum=LONGEST_S) if parameter.name.endswith("_s") else parameter
    for parameter in _SIGNAL_PARAMETERS
)
"""Keys of a signal, each with unit and range."""

CONDITION_PARAMETERS = (
    Parameter("signal", str, None, "name of the other signal"),
    Parameter("is", float, None, "true while the other signal equals this value, in its unit"),
    Parameter("is_not", float, None, "true while the other signal differs from this value, in its unit"),
    Parameter("below", float, None, "true while the other signal is below this value, in its unit"),
    Parameter("above", float, None, "true while the other signal is above this value, in its unit"),
)
"""Keys of a condition on another signal: the signal and one comparison."""

CONDITIONS: Mapping[str, str] = {
    "only_if": "the bounds apply only while this holds or the other signal is unknown",
    "latch_release_if": "a latch is released while this holds, as by `reset`",
}
"""Keys of a signal that hold a condition on another signal."""

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
"""The signals if none are configured, as in `config/thresholds.yaml`."""

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
"""Smallest and largest possible value per unit."""

_DEEPEST_SECTION = 8
"""Deepest namespace above a `ros__parameters`."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")


@dataclass(frozen=True)
class Condition:
    """A condition on the latest value of another signal."""

    signal: str
    """The other signal's name."""
    comparison: str
    """`is`, `is_not`, `below` or `above`."""
    number: float
    """Number with which its value is compared, in its unit."""

    def __str__(self) -> str:
        comparison = {"is": "is", "is_not": "is not"}.get(self.comparison, f"is {self.comparison}")
        return f"{self.signal} {comparison} {bound_text(self.number)}"

    def holds(self, value: float) -> bool:
        """Returns whether the condition is true for this value of the other signal."""
        if self.comparison in ("is", "is_not"):
            # 0.1 as a Float32 is 0.1000000015
            return math.isclose(value, self.number, rel_tol=1e-6) is (self.comparison == "is")
        return value < self.number if self.comparison == "below" else value > self.number


@dataclass(frozen=True)
class SignalConfig:
    """One signal: its source and its rules. `SIGNAL_PARAMETERS` describes each field."""

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
    window_min_s: float
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
    """Configuration of a Monitor and of the alert_system node."""

    signals: Mapping[str, SignalConfig]
    """By name, in the order of the configuration."""
    robot_name: str = ""
    """`hardware_id` of all messages; empty: the host name."""
    publish_rate: float = 1.0
    """Rate of /diagnostics, in Hz."""
    rosbridge_port: int = 0
    """Port of the rosbridge server of the ROS nodes; 0: no server."""
    rosbridge_address: str = "127.0.0.1"
    """Address of the rosbridge server."""
    rosbridge_token_file: str = ""
    """Path of the file with the token that its clients must present; empty: none."""
    ops: str = ""
    """Path of an ops.yaml; empty: none."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", MappingProxyType(dict(self.signals)))


class Section(NamedTuple):
    """Part of a configuration file that belongs to one node."""

    path: Path
    """Keys from the root of the file down to the parameters."""
    tree: Mapping[str, Any]
    """The mapping under `ros__parameters`."""

    @property
    def node(self) -> str:
        """The node's name without its namespace."""
        return self.path[-2].rpartition("/")[2]


def load_config(source: Union[Mapping[str, Any], PathLike], node: str = "alert_system") -> MonitorConfig:
    """Reads the configuration of a monitor.

    Args:
        source: the mapping under `ros__parameters`, the mapping of a whole file, or a file's path.
        node: the node whose section of a whole file to read; without one, the only section with `signals`.

    Raises:
        ConfigError: unknown keys, wrong types, contradictory bounds, impossible units, or an unreadable file. The
            message names file, line, key path, what was expected and what was found; `others` are further mistakes.
    """
    if isinstance(source, (str, os.PathLike)):
        read = read_yaml(source)
        try:
            return read_monitor(find_section(read.tree, node))
        except ConfigError as error:
            raise read.locate(error) from None
    tree = require_mapping(source)
    return read_monitor(find_section(tree, node) if is_whole_file(tree) else Section((), tree))


def is_whole_file(tree: Mapping[str, Any]) -> bool:
    """Returns whether `tree` is the mapping of a whole file, with node names above `ros__parameters`."""
    return any(isinstance(value, Mapping) and _has_sections(value, 1) for value in tree.values())


def _has_sections(tree: Mapping[Any, Any], depth: int) -> bool:
    return "ros__parameters" in tree or (
        depth < _DEEPEST_SECTION
        and any(isinstance(value, Mapping) and _has_sections(value, depth + 1) for value in tree.values())
    )


def sections(tree: Mapping[str, Any]) -> Dict[str, Section]:
    """Returns the sections of a whole file by node name without namespace; of several for one node, the last.

    Raises:
        ConfigError: the value of a `ros__parameters` is not a mapping.
    """
    return {section.node: section for section in list_sections(tree)}


def list_sections(tree: Mapping[str, Any], problems: Optional[Problems] = None) -> List[Section]:
    """Returns every section of a whole file.

    Args:
        tree: the mapping of the file.
        problems: receives the sections that cannot be used; None: they are raised.

    Raises:
        ConfigError: the value of a `ros__parameters` is not a mapping.
    """
    collected = Problems() if problems is None else problems
    found = _list_sections(tree, (), collected)
    if problems is None:
        collected.raise_if_any()
    return found


def _list_sections(tree: Mapping[str, Any], path: Path, problems: Problems) -> List[Section]:
    found: List[Section] = []
    for key, value in tree.items():
        if isinstance(value, Mapping):
            if "ros__parameters" in value:
                below = (*path, str(key), "ros__parameters")
                with problems:
                    found.append(Section(below, require_mapping(value["ros__parameters"], below)))
            elif len(path) < _DEEPEST_SECTION:
                found.extend(_list_sections(value, (*path, str(key)), problems))
    return found


def find_section(tree: Mapping[str, Any], node: str) -> Section:
    """Returns a node's section of a whole file; without one of its name, the only section with `signals`.

    Raises:
        ConfigError: there is none, or several.
    """
    found = list_sections(tree)
    of_node = [section for section in found if section.node == node]
    if of_node:
        refuse_second_section(of_node)
        return of_node[0]
    if "signals" in tree:
        nesting = f"{node}: {{ros__parameters: {{signals: ...}}}}"
        raise ConfigError(f"expected below the name of a node: {nesting}", ("signals",))
    refuse_missing_parameters(tree, node)
    with_signals = [section for section in found if "signals" in section.tree]
    if len(with_signals) == 1:
        return with_signals[0]
    there = describe(", ".join(map(str, list(tree)[:10]))) if tree else "nothing"
    raise ConfigError(f"expected one node with ros__parameters.signals, usually {node}, got {there}")


def refuse_missing_parameters(tree: Mapping[str, Any], node: str) -> None:
    """Refuses a node's name at the top of a file without `ros__parameters` below it.

    Raises:
        ConfigError: there is one; a similar key is named.
    """
    below = tree.get(node)
    if not isinstance(below, Mapping) or _has_sections(below, 1):
        return
    import difflib  # only for mistakes: it takes memory in every node

    for key in list(below)[:100]:
        if difflib.get_close_matches(str(key)[:60], ["ros__parameters"]):
            raise ConfigError("unknown key; did you mean ros__parameters, with two underscores?", (node, str(key)))
    raise ConfigError("expected the key ros__parameters above the parameters", (node,))


def refuse_second_section(found: List[Section]) -> None:
    """Refuses several sections for one node.

    Args:
        found: all sections for that node.

    Raises:
        ConfigError: there are several.
    """
    if len(found) > 1:
        places = " and ".join(".".join(section.path[:-1]) for section in found[:2])
        problem = f"expected one section for {found[0].node} in a file (one file per robot), got {places}"
        raise ConfigError(problem, found[1].path[:-1])


def read_monitor(section: Section) -> MonitorConfig:
    """Reads the section of alert_system.

    Raises:
        ConfigError: as `load_config` does; the path begins with the section's.
    """
    path, tree = section
    problems = Problems()
    if "rosbridge_token" in tree:
        # Other users can read parameters. The error must not contain the token either.
        problem = "not supported; write the token to a file and give its path as rosbridge_token_file"
        problems.add(ConfigError(problem, (*path, "rosbridge_token")))
    values: Dict[str, Any] = {}
    with problems:
        values = read_parameters(tree, MONITOR_PARAMETERS, path, ("signals", "qos_overrides", "rosbridge_token"))
    signals: Dict[str, SignalConfig] = {}
    if "signals" in tree or not problems.errors:  # a misspelt `signals` is one mistake, not two
        with problems:
            signals = _read_signals(tree, (*path, "signals"))
    problems.raise_if_any()
    settings = {field.name: values[field.name] for field in fields(MonitorConfig) if field.name in values}
    return MonitorConfig(signals, **settings)


def _read_signals(tree: Mapping[str, Any], path: Path) -> Dict[str, SignalConfig]:
    if "signals" not in tree:
        raise ConfigError("is missing; expected a mapping of signal names to their settings", path)
    signals = require_mapping(tree["signals"], path)
    if not signals:
        raise ConfigError("expected at least one signal, got none", path)
    problems = Problems()
    read: Dict[str, SignalConfig] = {}
    for name, found in signals.items():
        with problems:
            if name in _RESERVED_NAMES:
                problem = f"this name is reserved for {_RESERVED_NAMES[name]}; expected another"
                raise ConfigError(problem, (*path, name))
            read[name] = read_signal(name, found, (*path, name))
    _share_types(signals, read, path, problems)
    for name, signal in read.items():
        for key in CONDITIONS:
            condition = getattr(signal, key)
            if condition is not None and (condition.signal == name or condition.signal not in (*signals, LINK)):
                others = [other for other in signals if other not in (name, LINK)] + [LINK]
                problem = f"expected the name of another signal ({_names(others)}), got {describe(condition.signal)}"
                problems.add(ConfigError(problem, (*path, name, key, "signal")))
    problems.raise_if_any()
    return read


def _share_types(found: Mapping[str, Any], signals: Dict[str, SignalConfig], path: Path, problems: Problems) -> None:
    """Gives signals without a type that of another signal of the same topic; two types for one topic are a mistake.

    Args:
        found: the signals as they were given.
        signals: those of them that could be read; changed.
        path: where they are.
        problems: receives the mistakes, each at both signals.
    """
    typed: Dict[str, Tuple[str, str]] = {}
    for name, given in found.items():
        topic, type_name = (given.get("topic", name), given.get("type")) if isinstance(given, Mapping) else (name, "")
        if not isinstance(topic, str) or not isinstance(type_name, str) or split_type_name(type_name) is None:
            continue
        first, other = typed.setdefault(topic, (name, type_name))
        if split_type_name(other) != split_type_name(type_name):
            for one, its_type, another, another_type in (
                (first, other, name, type_name),
                (name, type_name, first, other),
            ):
                problem = f"signal {another} of the same topic {topic} has {another_type}, this one {its_type}"
                problems.add(ConfigError(problem, (*path, one, "type")))
    for name, signal in signals.items():
        if signal.type or signal.topic not in typed:
            continue
        giver, type_name = typed[signal.topic]
        signals[name] = replace(signal, type=type_name)
        try:
            check_field(signal.topic, type_name, signal.field)
        except ConfigError as error:
            problem = f"{error.problem}; the type is that of signal {giver} of the same topic"
            problems.add(ConfigError(problem, (*path, name, "field")))
            problem = f"signal {name} of the same topic has no type of its own, and a field that this type has not"
            problems.add(ConfigError(problem, (*path, giver, "type")))


def _names(names: List[str]) -> str:
    return ", ".join(names if len(names) <= 20 else [*names[:20], "..."])


def read_signal(name: str, found: object, path: Path = ()) -> SignalConfig:
    """Reads the configuration of one signal.

    Raises:
        ConfigError: as `load_config` does.
    """
    problems = Problems()
    if not _NAME.match(name):
        problem = "expected a signal name of letters, digits and _, not beginning with a digit"
        problems.add(ConfigError(problem, path))
    values: Dict[str, Any] = {}
    with problems:
        tree = require_mapping(found, path)
        for key in CONDITIONS:
            if key in tree:
                with problems:
                    values[key] = _read_condition(tree[key], (*path, key))
        values.update(read_parameters(tree, SIGNAL_PARAMETERS, path, tuple(CONDITIONS)))
    problems.raise_if_any()
    if values["topic"] is None:
        values["topic"] = name
    if values["window_min_s"] is None:
        values["window_min_s"] = values["window_s"] / 2.0
    for key in ("for_s", "keep_firing_for_s"):
        if values[f"error_{key}"] is None:
            values[f"error_{key}"] = values[key]
    signal = SignalConfig(name=name, **values)
    with problems:
        _check_source(signal, path)
    if signal.flap_low > signal.flap_high:
        low, high = bound_text(signal.flap_low), bound_text(signal.flap_high)
        key, problem = "flap_low", f"expected at most flap_high ({high}), got {low}"
        if "flap_low" not in tree:
            key, problem = "flap_high", f"expected at least flap_low ({low}), got {high}"
        problems.add(ConfigError(problem, (*path, key)))
    if signal.window_min_s > signal.window_s:
        most, got = bound_text(signal.window_s), bound_text(signal.window_min_s)
        problems.add(ConfigError(f"expected at most window_s ({most}), got {got}", (*path, "window_min_s")))
    _check_order(signal, path, problems)
    _check_unit(signal, path, problems)
    problems.raise_if_any()
    return signal


def _read_condition(found: object, path: Path) -> Condition:
    values = read_parameters(require_mapping(found, path), CONDITION_PARAMETERS, path)
    signal = values.pop("signal")
    if signal is None:
        raise ConfigError("is missing; expected the name of another signal", (*path, "signal"))
    comparisons = {name: number for name, number in values.items() if number is not None}
    if len(comparisons) != 1:
        found_text = " and ".join(comparisons) or "none"
        raise ConfigError(f"expected one of {', '.join(values)}, got {found_text}", path)
    ((comparison, number),) = comparisons.items()
    return Condition(signal, comparison, number)


def _check_source(signal: SignalConfig, path: Path) -> None:
    problems = Problems()
    if not signal.topic:
        problems.add(ConfigError("expected the name of a topic, got ''", (*path, "topic")))
    if signal.type and split_type_name(signal.type) is None:
        got = describe(signal.type)
        problems.add(ConfigError(f"expected a type such as std_msgs/Float32, got {got}", (*path, "type")))
    try:
        parse_field_path(signal.field)
    except ValueError as error:
        problems.add(
            ConfigError(f"expected the path of a field, got {describe(signal.field)}: {error}", (*path, "field"))
        )
    if signal.scale == 0.0:
        problems.add(ConfigError("expected a number other than 0, got 0", (*path, "scale")))
    problems.raise_if_any()


def _check_order(signal: SignalConfig, path: Path, problems: Problems) -> None:
    def refuse_above(low: str, high: str, why: str) -> None:
        low_value, high_value = getattr(signal, low), getattr(signal, high)
        if low_value is not None and high_value is not None and low_value > high_value:
            expected = f"expected at most {high} ({bound_text(high_value)})"
            problems.add(ConfigError(f"{expected}, got {bound_text(low_value)}: {why}", (*path, low)))

    def refuse_hysteresis(expected: str, why: str) -> None:
        got = bound_text(signal.hysteresis)
        problems.add(ConfigError(f"expected {expected}, got {got}: {why}", (*path, "hysteresis")))

    refuse_above("valid_min", "valid_max", "no value would be valid")
    refuse_above("error_below", "warn_below", "a falling value crosses the WARN bound first")
    refuse_above("warn_above", "error_above", "a rising value crosses the WARN bound first")
    lows = [name for name in ("warn_below", "error_below") if getattr(signal, name) is not None]
    highs = [name for name in ("warn_above", "error_above") if getattr(signal, name) is not None]
    for low in lows:
        for high in highs:
            refuse_above(low, high, "no value would be OK")
            room = getattr(signal, high) - getattr(signal, low)
            if 0.0 <= room < signal.hysteresis:
                refuse_hysteresis(f"at most {number_text(room)}", f"{low} would clear above {high}")
    if signal.statistic not in ("last", "mean", "min", "max"):
        return
    for name, bound in signal.bounds.items():
        with problems:
            _check_range(name, bound, signal.valid_min, signal.valid_max, "valid_min", "valid_max", path)
        clears_at = bound + signal.hysteresis if name in lows else bound - signal.hysteresis
        too_high = name in lows and signal.valid_max is not None and bound <= signal.valid_max < clears_at
        too_low = name in highs and signal.valid_min is not None and clears_at < signal.valid_min <= bound
        if too_high or too_low:
            refuse_hysteresis("less", f"{name} would clear at {number_text(clears_at)}, which is not a valid value")


def _check_range(
    name: str, found: float, low: Optional[float], high: Optional[float], low_name: str, high_name: str, path: Path
) -> None:
    expected = ""
    if low is not None and found < low:
        expected = f"at least {bound_text(low)} ({low_name})"
    elif high is not None and found > high:
        expected = f"at most {bound_text(high)} ({high_name})"
    if expected:
        raise ConfigError(f"expected {expected}, got {bound_text(found)}", (*path, name))


def _check_unit(signal: SignalConfig, path: Path, problems: Problems) -> None:
    low, high = _UNIT_RANGES.get(signal.unit, (None, None))
    limits = {name: getattr(signal, name) for name in ("valid_min", "valid_max")}
    if signal.statistic in ("last", "mean", "min", "max"):
        limits.update(signal.bounds)
    for name, value in limits.items():
        if value is not None:
            unit = f"the minimum of {signal.unit}", f"the maximum of {signal.unit}"
            with problems:
                _check_range(name, value, low, high, *unit, path)
    if signal.unit == "%" and signal.valid_max is not None and signal.valid_max <= 1.0:
        problems.add(
            ConfigError(
                f"expected valid_max 100 for the unit '%', got {bound_text(signal.valid_max)};"
                " a fraction from 0 to 1 has the unit ''",
                (*path, "unit"),
            )
        )


def described_parameters(config: MonitorConfig, *, are_default: bool = False) -> Tuple[Parameter, ...]:
    """Returns every parameter of a node with this configuration, under its dotted name, for `declare_parameters`.

    Args:
        config: the configuration.
        are_default: its signals are `DEFAULT_SIGNALS`, which give the defaults of their parameters.
    """
    return _described_parameters(tuple(config.signals), are_default)


@lru_cache(maxsize=4)  # the robots of a fleet have the same signals
def _described_parameters(signals: Tuple[str, ...], are_default: bool) -> Tuple[Parameter, ...]:
    defaults = DEFAULT_SIGNALS if are_default else {}
    return MONITOR_PARAMETERS + tuple(
        replace(
            parameter,
            name=f"signals.{name}.{parameter.name}",
            default=defaults.get(name, {}).get(parameter.name, parameter.default),
        )
        for name in signals
        for parameter in (*SIGNAL_PARAMETERS, *_CONDITION_PARAMETERS)
    )
