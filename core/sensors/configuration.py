"""Configuration of battery_sensor: its metrics, and the source of each: simulated, this machine, or none.

`catalogue.py` lists the metrics of this machine. It is imported where one of them is configured: reading this machine
takes a megabyte, which a node with simulated values or with none does without.
"""

from __future__ import annotations

import random
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Mapping, Sequence

from ..config import Parameter, read_parameters, require_mapping
from ..config.schema import parameters
from ..values import ConfigError, JsonObject, Path, Problems
from .computer import Computer
from .simulated import SimulatedBattery, SimulatedCpuUsage, SimulatedTemperature
from .source import Source

if TYPE_CHECKING:
    from .catalogue import HostSource

METRICS: Mapping[str, str] = {"battery_level": "%", "temperature": "degC", "cpu_usage": "%"}
"""Name (which is also the topic) and unit of the standard metrics, in the order in which they are published."""

SEED = Parameter("seed", int, None, "seed of the simulated values; left out: different values at every start")

PRESETS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "standard": (
        "load_5min",
        "memory_percent",
        "swap_percent",
        "pressure_memory",
        "oom_kills",
        "disk_percent",
        "disk_inodes_percent",
        "disk_read_only",
        "network_carrier",
        "wifi_signal",
        "clock_synchronized",
        "throttled",
        "systemd_failed",
    ),
}
"""Sources that `host_preset` adds to the section `host`, each with its own name and without options."""

HOST_PRESET = Parameter(
    "host_preset",
    str,
    "none",
    "metrics of this machine in addition to those of the section host, each on the topic of its name; standard: "
    + ", ".join(PRESETS["standard"]),
    choices=tuple(PRESETS),
)

_SOURCE = Parameter(
    "source",
    str,
    "simulated",
    "source of the values: simulated, host (this machine) or none (not published)",
    choices=("simulated", "host", "none"),
)

_SIMULATED: JsonObject = {
    "battery_level": SimulatedBattery, "temperature": SimulatedTemperature, "cpu_usage": SimulatedCpuUsage
}  # fmt: skip

METRIC_PARAMETERS: Mapping[str, tuple[Parameter, ...]] = {
    metric: (_SOURCE, *parameters(simulated)) for metric, simulated in _SIMULATED.items()
}
"""Parameters of the standard metrics, each in the section of its name; the first is `source`."""

HOST_SECTION = "host"
"""Section with further metrics of this machine, by name, which is also the topic."""

SECTION_NAMES = (*METRIC_PARAMETERS, HOST_SECTION)
"""Sections of the node's configuration."""

_HOST_METRICS = {"battery_level": "battery_percent", "temperature": "temperature", "cpu_usage": "cpu_percent"}
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


def read_sources(tree: JsonObject, path: Path = (), computer: Computer | None = None) -> dict[str, Source]:
    """Creates a source per metric, in the order of `METRICS` and then of the section `host`; none for `source: none`.

    Reads `seed`, `sensors`, `host_preset` and the sections of a node's whole configuration; the sources share
    `computer`. `path` has the keys above it, for errors: a ConfigError with all unknown keys and values that are not
    allowed.
    """
    computer = computer or Computer()
    sources: dict[str, Source] = {}
    problems = Problems()
    seed = random.getrandbits(32)
    with problems:
        if tree.get("seed") is not None:
            seed = SEED.read(tree["seed"], (*path, "seed"))
    metrics = list(METRICS)
    with problems:
        metrics += _host_sections(tree, path)
    for metric in metrics:
        with problems:
            where, table, given = _section(tree, metric, path)
            values = read_parameters(given, table, where)
            source = _source(metric, values, f"{seed}/{metric}", where, computer)
            if source is not None:
                sources[metric] = source
    problems.raise_if_any()
    return sources


def settings_of(tree: JsonObject, metric: str) -> JsonObject:
    """Returns the settings of one metric in a valid configuration, defaults included."""
    _, table, given = _section(tree, metric, ())
    return {**{parameter.name: parameter.default for parameter in table}, **given}


def declared_parameters(tree: JsonObject) -> tuple[Parameter, ...]:
    """Returns the parameters of every metric in a valid configuration, by their dotted names."""
    declared: list[Parameter] = []
    for metric in [*METRICS, *_host_sections(tree, ())]:
        where, (source, *options), given = _section(tree, metric, ())
        # A middleware that fills in defaults must not fill in another source than `sensors` does.
        table = (replace(source, default=given["source"]), *options)
        declared += [parameter.below(".".join(where)) for parameter in table]
    return tuple(declared)


def _section(tree: JsonObject, metric: str, path: Path) -> tuple[tuple[str, ...], Sequence[Parameter], dict[str, Any]]:
    """Returns where the settings of a metric are, the parameters that it can have, and what is given of them."""
    if metric in METRICS:
        where = (*path, metric)
        given = {"source": tree.get("sensors") or _SOURCE.default, **require_mapping(tree.get(metric, {}), where)}
        if given["source"] is False:  # YAML reads a plain `off` or `no` as false
            given["source"] = "none"
        return where, METRIC_PARAMETERS[metric], given
    where = (*path, HOST_SECTION, metric)
    given = dict(_host_sections(tree, path)[metric])
    source = Parameter("source", str, None, "metric of this machine", choices=tuple(_host_sources()))
    if given.get("source") is None:
        raise ConfigError(f"is missing; expected {source.allowed} (see `robot-health sources`)", (*where, "source"))
    options = _host_sources()[source.read(given["source"], (*where, "source"))].options
    return where, (source, *options), given


def _host_sections(tree: JsonObject, path: Path) -> Mapping[str, JsonObject]:
    sections = require_mapping(tree.get(HOST_SECTION, {}), (*path, HOST_SECTION))
    preset = HOST_PRESET.read(tree.get("host_preset") or "none", (*path, "host_preset"))
    problems = Problems()
    for metric, settings in sections.items():
        where = (*path, HOST_SECTION, metric)
        with problems:
            if metric in METRICS:
                raise ConfigError("is the name of a standard metric; expected another name", where)
            if not _NAME.match(metric):
                raise ConfigError("expected a name of letters, digits and _, starting with a letter", where)
            require_mapping(settings, where)
    problems.raise_if_any()
    return {**{name: {"source": name} for name in PRESETS[preset]}, **sections}


def _host_sources() -> Mapping[str, HostSource]:
    from .catalogue import HOST_SOURCES

    return HOST_SOURCES


def _source(metric: str, values: dict[str, Any], seed: str, path: Path, computer: Computer) -> Source | None:
    """Returns the source of a metric with these settings; None if it has none."""
    kind = values.pop("source")
    if kind == "none":
        return None
    if metric not in METRICS:
        source = _host_sources()[kind]
        if source.example and not any(values[name] for name in source.example):
            raise ConfigError(f"expected {' or '.join(source.example)}, to select processes", path)
        return source.make(computer, **values)
    if kind == "host":
        return _host_sources()[_HOST_METRICS[metric]].make(computer)
    seeds = {} if metric == "battery_level" else {"seed": seed}
    simulated: Source = _SIMULATED[metric](**values, **seeds)
    return simulated
