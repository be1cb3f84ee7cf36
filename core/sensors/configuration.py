"""What battery_sensor publishes and where each value comes from: simulated, this machine, or nowhere.

`read_sources({"temperature": {"source": "host"}})["temperature"].read(now_s)` gives degrees C, or raises SensorError.
"""

from __future__ import annotations

import random
import re
from dataclasses import replace
from typing import Any, Callable, Dict, Mapping, Optional, Tuple

from ..errors import ConfigError, Path
from ..parameters import Parameter, read_parameters, require_mapping
from .catalogue import HOST_SOURCES
from .host import HostBattery, HostCpuUsage, HostTemperature
from .simulated import SimulatedBattery, SimulatedCpuUsage, SimulatedTemperature
from .source import NotYet, SensorError, Source

__all__ = [
    "HOST",
    "METRICS",
    "SECTIONS",
    "SEED",
    "NotYet",
    "SensorError",
    "Source",
    "described_sections",
    "read_sources",
    "section_of",
]

METRICS: Mapping[str, str] = {"battery_level": "%", "temperature": "degC", "cpu_usage": "%"}
"""Name (also the topic) and unit of every metric, in the order in which they are published."""

SEED = Parameter("seed", int, None, "the same seed gives the same simulated values; left out: new ones at every start")

_SOURCE = Parameter(
    "source",
    str,
    "simulated",
    "where the value comes from: simulated, host (this machine) or none (not published)",
    choices=("simulated", "host", "none"),
)

SECTIONS: Mapping[str, Tuple[Parameter, ...]] = {
    "battery_level": (
        _SOURCE,
        Parameter("discharge_rate", float, 1.0, "simulated: % lost per second", minimum=0.0),
        Parameter("charge_rate", float, 4.0, "simulated: % gained per second on the charger", minimum=0.0),
        Parameter("charge_at", float, 5.0, "simulated: % at which it is charged", minimum=0.0, maximum=99.0),
    ),
    "temperature": (
        _SOURCE,
        Parameter("mean", float, 60.0, "simulated: mean in degrees C"),
        Parameter("spread", float, 4.0, "simulated: how far it wanders from the mean, in degrees C", minimum=0.0),
        Parameter("spike", float, 30.0, "simulated: degrees C that a hot spell of 30 s adds; 0: none", minimum=0.0),
        Parameter("spike_every_s", float, 120.0, "simulated: seconds in which one hot spell falls", minimum=1.0),
    ),
    "cpu_usage": (
        _SOURCE,
        Parameter("mean", float, 35.0, "simulated: mean in %", minimum=0.0, maximum=100.0),
        Parameter("spread", float, 30.0, "simulated: how far it moves from the mean, in %", minimum=0.0),
    ),
}
"""The parameters of every metric, in its own section of the node's configuration."""

HOST = "host"
"""Key of the section with further metrics of this machine, each under the name of its topic."""

_HOST_SOURCE = Parameter("source", str, None, "which value of this machine", choices=tuple(HOST_SOURCES))
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")

_HOST: Mapping[str, Callable[[], Source]] = {
    "battery_level": HostBattery,
    "temperature": HostTemperature,
    "cpu_usage": HostCpuUsage,
}


def read_sources(tree: Mapping[str, Any], path: Path = ()) -> Dict[str, Source]:
    """Makes the sources that a node's configuration asks for.

    Args:
        tree: the node's whole configuration; only `seed`, the sections named after metrics and `host` are read.
        path: where the tree is, for error messages.

    Returns:
        A source per metric, in the order of `METRICS` and then of the section `host`; those with `source: none` are
        left out.

    Raises:
        ConfigError: a key is unknown or a value not allowed.
    """
    tree = with_default_source(tree)
    seed = SEED.read(tree["seed"], (*path, "seed")) if tree.get("seed") is not None else random.getrandbits(32)
    sources: Dict[str, Source] = {}
    for metric in METRICS:
        source = _read_source(metric, tree.get(metric, {}), f"{seed}/{metric}", (*path, metric))
        if source is not None:
            sources[metric] = source
    for metric, found in _host_sections(tree, path).items():
        sources[metric] = _read_host_source(found, (*path, HOST, metric))
    return sources


def section_of(tree: Mapping[str, Any], metric: str) -> object:
    """Returns what a node's configuration says of one metric, with the defaults of what it does not say.

    None when it says nothing of a metric of the section `host`.
    """
    if metric in METRICS:
        return {**{parameter.name: parameter.default for parameter in SECTIONS[metric]}, **tree.get(metric, {})}
    section = tree.get(HOST, {}).get(metric)
    if section is None:
        return None
    return {**{parameter.name: parameter.default for parameter in _host_parameters(section["source"])}, **section}


def with_default_source(tree: Mapping[str, Any]) -> Mapping[str, Any]:
    """Returns a node's configuration in which each metric without a `source` has the one of the parameter `sensors`."""
    default = tree.get("sensors", "")
    if not default:
        return tree
    sections = {metric: tree.get(metric, {}) for metric in METRICS}
    sections = {metric: section for metric, section in sections.items() if isinstance(section, Mapping)}
    return {**tree, **{metric: {"source": default, **section} for metric, section in sections.items()}}


def described_sections(tree: Mapping[str, Any]) -> Tuple[Parameter, ...]:
    """Returns the parameters of every metric of a node's configuration that can be used, by their dotted names."""
    sections = dict(SECTIONS)
    for metric, found in _host_sections(tree, ()).items():
        sections[f"{HOST}.{metric}"] = _host_parameters(found["source"])
    return tuple(
        replace(parameter, name=f"{section}.{parameter.name}")
        for section, parameters in sections.items()
        for parameter in parameters
    )


def _host_sections(tree: Mapping[str, Any], path: Path) -> Mapping[str, Mapping[str, Any]]:
    sections = require_mapping(tree.get(HOST, {}), (*path, HOST))
    for metric, found in sections.items():
        where = (*path, HOST, metric)
        if metric in METRICS:
            raise ConfigError("is a metric of its own, allowed is another name", where)
        if not _NAME.match(metric):
            raise ConfigError("is no name of a metric, allowed are letters, digits and _, a letter first", where)
        require_mapping(found, where)
    return sections


def _host_parameters(source: str) -> Tuple[Parameter, ...]:
    option = HOST_SOURCES[source].option
    return (_HOST_SOURCE,) if option is None else (_HOST_SOURCE, option)


def _read_host_source(section: Mapping[str, Any], path: Path) -> Source:
    if section.get("source") is None:
        raise ConfigError(f"is missing, allowed is {_HOST_SOURCE.allowed}", (*path, "source"))
    source = _HOST_SOURCE.read(section["source"], (*path, "source"))
    options = read_parameters(section, _host_parameters(source), path)
    del options["source"]
    return HOST_SOURCES[source].make(**options)


def _read_source(metric: str, found: object, seed: str, path: Path) -> Optional[Source]:
    section = require_mapping(found, path)
    if section.get("source") is False:  # YAML reads a plain `off` or `no` as false
        section = {**section, "source": "none"}
    values = read_parameters(section, SECTIONS[metric], path)
    kind = values.pop("source")
    if kind == "none":
        return None
    if kind == "host":
        return _HOST[metric]()
    if metric == "battery_level":
        return SimulatedBattery(**values)
    if metric == "temperature":
        return SimulatedTemperature(**values, seed=seed)
    return SimulatedCpuUsage(**values, seed=seed)
