"""Configuration of the monitor: a mapping or a `thresholds.yaml` becomes frozen values.

Here: the parameters of nodes, the sections of a file, and what several signals must agree on. `signal_config` has the
keys of a signal. Every error names the key's path and, for a file, file and line.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Tuple, Union

from ..messages import check_field
from ..values import ConfigError, JsonObject, Path, Problems, describe, list_text, split_type_name
from .causes import Causes, causes_of
from .parameters import Parameter
from .schema import declared, parameters, read_parameters, require_mapping
from .signal_config import (
    CONDITION_PARAMETERS,
    CONDITIONS,
    LINK,
    SIGNAL_PARAMETERS,
    SignalConfig,
    is_element_name,
    read_signal,
    template_name,
)
from .yaml_file import PathLike, read_yaml

_RESERVED_NAMES = {LINK: "the link to the robot", "monitor": "the status of the monitor itself"}

DEFAULT_SIGNALS: Mapping[str, JsonObject] = {
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
    parameter.below(key, description=f"{meaning}: {parameter.description}")
    for key, meaning in CONDITIONS.items()
    for parameter in CONDITION_PARAMETERS
)

_MAIN_SIGNALS = 3

NODES = ("alert_system", "aggregator", "battery_sensor")
"""The nodes that a thresholds.yaml is for."""
_DEEPEST_SECTION = 8
"""Deepest namespace above a `ros__parameters`."""
_MOST_SHARED = 512
"""Most signals that are kept to be shared by robots that configure the same."""


@dataclass(frozen=True)
class NodeConfig:
    """Parameters common to all nodes: a ROS 2 launch file passes the same ones to all nodes of a process."""

    robot_name: str = declared("", "name of the robot: hardware_id of all messages; empty: the host name")
    thresholds: str = declared("", "path of the file that contains this configuration; used in error messages")
    use_sim_time: bool = declared(False, "use the time from /clock instead of the system time")
    log_level: str = declared(
        "INFO", "lowest severity that is logged", choices=("DEBUG", "INFO", "WARN", "ERROR", "FATAL")
    )
    executor: str = declared(
        "auto",
        "ROS 2 only: single (SingleThreadedExecutor), events (EventsExecutor, less CPU) or auto (events if it works)",
        choices=("auto", "single", "events"),
    )
    sensors: str = declared(
        "",
        "source of each metric of battery_sensor that names none: simulated, host or none; empty: simulated. "
        "none: health_monitor runs without battery_sensor, and without aggregator unless its inputs are configured",
        choices=("", "simulated", "host", "none"),
    )
    rosbridge_port: int = declared(0, "port of the rosbridge server of alert_system; 0: no server", 0, 65535)
    rosbridge_address: str = declared("127.0.0.1", "address of the rosbridge server; any other one needs a token")
    rosbridge_token_file: str = declared("", "path of a file with the token that clients must present; empty: none")
    ops: str = declared("", "path of an ops.yaml (history, notifications, server); empty: none")


@dataclass(frozen=True)
class _Signals:
    signals: Mapping[str, SignalConfig]
    """By name, in the order of the configuration."""


@dataclass(frozen=True)
class MonitorConfig(NodeConfig, _Signals):
    """Configuration of a Monitor and of the alert_system node."""

    publish_rate: float = declared(1.0, "rate of /diagnostics, in Hz", 0.01, 100.0)
    show: Tuple[str, ...] = declared(
        (),
        "signals whose values the page and the live view show beside the robot's name; []: the first three with a unit",
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", MappingProxyType(dict(self.signals)))

    @property
    def main_signals(self) -> Tuple[str, ...]:
        """The signals that stand for the robot: `show`, else the first three with a unit."""
        with_unit = [name for name, signal in self.signals.items() if signal.unit and not signal.is_template]
        return self.show or tuple(with_unit[:_MAIN_SIGNALS])


NODE_PARAMETERS = parameters(NodeConfig)
MONITOR_PARAMETERS = parameters(MonitorConfig)
"""Parameters of alert_system, apart from its signals."""


class Section(NamedTuple):
    """Part of a configuration file that belongs to one node."""

    path: Path
    """Keys from the root of the file down to the parameters."""
    tree: JsonObject
    """The mapping under `ros__parameters`."""

    @property
    def node(self) -> str:
        """The node's name without its namespace."""
        return self.path[-2].rpartition("/")[2]


def load_config(source: Union[JsonObject, PathLike], node: str = "alert_system") -> MonitorConfig:
    """Reads the configuration of a monitor.

    Args:
        source: the mapping under `ros__parameters`, the mapping of a whole file, or a file's path.
        node: the node whose section of a whole file to read; without one, the only section with `signals`.

    Raises:
        ConfigError: unknown keys, wrong types, contradictory bounds, or an unreadable file. The
            message names file, line, key path, what was expected and what was found; `others` are further mistakes.
    """
    if isinstance(source, (str, os.PathLike)):
        read = read_yaml(source)
        with read.located():
            return read_monitor(find_section(read.tree, node))
    tree = require_mapping(source)
    return read_monitor(find_section(tree, node) if is_whole_file(tree) else Section((), tree))


def is_whole_file(tree: JsonObject) -> bool:
    """Returns whether `tree` is the mapping of a whole file, with node names above `ros__parameters`."""
    return next(_parameters(tree), None) is not None


def _parameters(tree: Mapping[Any, Any], path: Path = ()) -> Iterator[Tuple[Path, object]]:
    """Yields path and value of each `ros__parameters`."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            below = (*path, str(key))
            if "ros__parameters" in value:
                yield (*below, "ros__parameters"), value["ros__parameters"]
            elif len(path) < _DEEPEST_SECTION:
                yield from _parameters(value, below)


def sections(tree: JsonObject, problems: Optional[Problems] = None) -> List[Section]:
    """Returns the sections of a whole file.

    Raises ConfigError, or adds to `problems`: a section is no mapping, several are for a node of `NODES`, or a node of
    `NODES` has no `ros__parameters` below its name at the top.
    """
    collected = Problems() if problems is None else problems
    places: Dict[str, Path] = {}
    all_sections: List[Section] = []
    for path, below in _parameters(tree):
        with collected:
            section = Section(path, require_mapping(below, path))
            all_sections.append(section)
            first = places.setdefault(section.node, path)
            if first is not path and section.node in NODES:
                expected = f"expected one section for {section.node} in a file (one file per robot)"
                got = f"{'.'.join(first[:-1])} and {'.'.join(path[:-1])}"
                raise ConfigError(f"{expected}, got {got}", path[:-1])
    for node in NODES:
        below = tree.get(node)
        if isinstance(below, Mapping) and not is_whole_file({node: below}):
            expected = "expected the key ros__parameters, with two underscores, above the parameters"
            collected.add(ConfigError(expected, (node,)))
    if problems is None:
        collected.raise_if_any()
    return all_sections


def find_section(tree: JsonObject, node: str, problems: Optional[Problems] = None) -> Section:
    """Returns a node's section of a file, else the only one with `signals`.

    Raises ConfigError if there is none, or several; those of `sections` are added to `problems`, if it is given.
    """
    all_sections = sections(tree, problems)
    of_node = [section for section in all_sections if section.node == node]
    if len(of_node) == 1:
        return of_node[0]
    if "signals" in tree:
        nesting = f"{node}: {{ros__parameters: {{signals: ...}}}}"
        raise ConfigError(f"expected below the name of a node: {nesting}", ("signals",))
    with_signals = [section for section in of_node or all_sections if "signals" in section.tree]
    if len(with_signals) == 1:
        return with_signals[0]
    there = describe(", ".join(map(str, tree)) or None)
    raise ConfigError(f"expected one node with ros__parameters.signals, usually {node}, got {there}")


def read_monitor(section: Section) -> MonitorConfig:
    """Reads the section of alert_system; raises as `load_config` does, with the section's path before the key's."""
    path, tree = section
    problems = Problems()
    values: Dict[str, Any] = {}
    with problems:
        values = read_parameters(tree, MONITOR_PARAMETERS, path, ("signals", "qos_overrides"))
    signals: Dict[str, SignalConfig] = {}
    if "signals" in tree or not problems.errors:  # a misspelt `signals` is one mistake, not two
        with problems:
            signals = _read_signals(tree, (*path, "signals"))
    for name in values.get("show", ()) if signals else ():
        if name not in signals and not (is_element_name(name) and template_name(name) in signals):
            known = list_text(list(signals), 20)
            problems.add(ConfigError(f"expected names of signals ({known}), got {describe(name)}", (*path, "show")))
    problems.raise_if_any()
    return MonitorConfig(signals, **values)


def _read_signals(tree: JsonObject, path: Path) -> Dict[str, SignalConfig]:
    if "signals" not in tree:
        raise ConfigError("is missing; expected a mapping of signal names to their settings", path)
    signals = require_mapping(tree["signals"], path)
    if not signals:
        raise ConfigError("expected at least one signal, got none; `robot-health init` writes them", path)
    problems = Problems()
    read: Dict[str, SignalConfig] = {}
    for name, settings in signals.items():
        with problems:
            if name in _RESERVED_NAMES:
                problem = f"this name is reserved for {_RESERVED_NAMES[name]}; expected another"
                raise ConfigError(problem, (*path, name))
            read[name] = read_signal(name, settings, (*path, name))
    _share_types(read, path, problems)
    causes = causes_of(read)
    for name in read:
        for key, problem in _mistakes_of_references(name, read, signals, causes):
            problems.add(ConfigError(problem, (*path, name, *key)))
    problems.raise_if_any()
    return {name: _shared(signal) for name, signal in read.items()}


@lru_cache(maxsize=_MOST_SHARED)
def _shared(signal: SignalConfig) -> SignalConfig:
    """Returns the first signal that was equal: the robots of a fleet have the same, of 2 kB each."""
    return signal


def _may_refer_to(other: str, name: str, read: Mapping[str, SignalConfig], given: JsonObject) -> bool:
    """Returns whether a condition of the signal `name` may be on `other`: a signal, or an element of a template."""
    template = read.get(template_name(other))
    is_element = template is not None and template.is_template and is_element_name(other)
    return template_name(other) != name and (is_element or other in given or other == LINK)


def _mistakes_of_references(
    name: str, read: Mapping[str, SignalConfig], given: JsonObject, causes: Causes
) -> Iterator[Tuple[Path, str]]:
    """Yields key and problem where a signal refers to another: unknown names, itself, its own topic, circles."""
    signal = read[name]
    others = list_text([other for other in given if other not in (name, LINK)] + [LINK], 20)
    for key in CONDITIONS:
        condition = getattr(signal, key)
        if condition is not None and not _may_refer_to(condition.signal, name, read, given):
            problem = f"expected the name of another signal ({others}), got {describe(condition.signal)}"
            yield (key, "signal"), problem
    topics = {each.topic.lstrip("/") for each in read.values()} - {"", signal.topic.lstrip("/")}
    for cause in signal.depends_on:
        is_topic = template_name(cause) != name and cause.lstrip("/") in topics
        if not is_topic and not _may_refer_to(cause, name, read, given):
            problem = f"expected names of other signals ({others}) or their topics, got {describe(cause)}"
            yield ("depends_on",), problem
    circle = [cause for cause in causes.of(name) if name in causes.of(cause)]
    if circle:
        yield ("depends_on",), f"expected no circle, but {' and '.join([*circle, name])} depend on one another"


def _share_types(signals: Dict[str, SignalConfig], path: Path, problems: Problems) -> None:
    """Gives signals without a type that of another signal of the same topic; two types for one topic are a mistake."""
    typed = {signal.topic: signal for signal in reversed(list(signals.values())) if signal.type}
    for name, signal in signals.items():
        other = typed.get(signal.topic, signal)
        if split_type_name(other.type) != split_type_name(signal.type or other.type):
            problem = f"signal {other.name} of the same topic {signal.topic} has {other.type}, this one {signal.type}"
            problems.add(ConfigError(problem, (*path, name, "type")))
        elif other.type and not signal.type:
            signals[name] = replace(signal, type=other.type)
            try:
                check_field(signal.topic, other.type, signal.field)
            except ConfigError as error:
                problem = f"{error.problem}; the type is that of signal {other.name} of the same topic"
                problems.add(ConfigError(problem, (*path, name, "field")))


@lru_cache(maxsize=4)  # the robots of a fleet have the same signals
def described_parameters(signals: Tuple[str, ...], *, are_default: bool = False) -> Tuple[Parameter, ...]:
    """Returns all parameters of alert_system with these signals, by dotted names.

    With `are_default`, the signals are those of `DEFAULT_SIGNALS`.
    """
    defaults = DEFAULT_SIGNALS if are_default else {}
    described = list(MONITOR_PARAMETERS)
    for name in signals:
        own = defaults.get(name, {})
        for parameter in (*SIGNAL_PARAMETERS, *_CONDITION_PARAMETERS):
            default = own.get(parameter.name, parameter.default)
            described.append(parameter.below(f"signals.{name}", default=default))
    return tuple(described)
