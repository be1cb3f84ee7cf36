"""Configuration of battery_sensor: its metrics, and the source of each: simulated, this machine, or none.

`catalogue.py` lists the metrics of this machine. It is imported where one of them is configured: reading this machine
takes a megabyte, which a node with simulated values or with none does without.
"""

from __future__ import annotations

import random
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Dict, Mapping, Sequence, Tuple

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
_Section = Tuple[Tuple[str, ...], Sequence[Parameter], Dict[str, Any]]
"""Where the settings of a metric are, the parameters that it can have, and what is given of them."""


def read_sources(tree: JsonObject, computer: Computer | None = None) -> dict[str, Source]:
    """Creates a source per metric, in the order of `METRICS` and then of the section `host`; none for `source: none`.

    Reads `seed`, `sensors`, `host_preset` and the sections of a node's whole configuration; the sources share
    `computer`. Raises a ConfigError with all unknown keys and values that are not allowed.
    """
    computer = computer or Computer()
    sources: dict[str, Source] = {}
    problems = Problems()
    seed = random.getrandbits(32)
    with problems:
        if tree.get("seed") is not None:
            seed = SEED.read(tree["seed"], ("seed",))
    for metric, (where, table, given) in _sections(tree, problems).items():
        with problems:
            values = read_parameters(given, table, where)
            kind = values.pop("source")
            if kind == "simulated":
                sources[metric] = _SIMULATED[metric](**values, seed=f"{seed}/{metric}")
            elif kind != "none":
                source = _host_sources()[_HOST_METRICS[metric] if metric in METRICS else kind]
                values = {} if metric in METRICS else values
                if source.example and not any(values[name] for name in source.example):
                    raise ConfigError(f"expected {' or '.join(source.example)}, to select processes", where)
                sources[metric] = source.make(computer, **values)
    problems.raise_if_any()
    return sources


def settings_of(tree: JsonObject) -> dict[str, JsonObject]:
    """Returns the settings of each metric in a valid configuration, defaults included."""
    return {
        metric: {**{parameter.name: parameter.default for parameter in table}, **given}
        for metric, (_, table, given) in _sections(tree).items()
    }


def declared_parameters(tree: JsonObject) -> tuple[Parameter, ...]:
    """Returns the parameters of every metric in a valid configuration, by their dotted names."""
    declared: list[Parameter] = []
    for where, (source, *options), given in _sections(tree).values():
        # A middleware that fills in defaults must not fill in another source than `sensors` does.
        table = (replace(source, default=given["source"]), *options)
        declared += [parameter.below(".".join(where)) for parameter in table]
    return tuple(declared)


def _sections(tree: JsonObject, problems: Problems | None = None) -> dict[str, _Section]:
    """Returns what is configured of each metric; mistakes, which a valid configuration has none of, are added."""
    problems = problems or Problems()
    sections: dict[str, _Section] = {}
    for metric in METRICS:
        with problems:
            where: tuple[str, ...] = (metric,)
            given = {"source": tree.get("sensors") or _SOURCE.default, **require_mapping(tree.get(metric, {}), where)}
            if given["source"] is False:  # YAML reads a plain `off` or `no` as false
                given["source"] = "none"
            sections[metric] = where, METRIC_PARAMETERS[metric], given
    with problems:
        preset = HOST_PRESET.read(tree.get("host_preset") or "none", ("host_preset",))
        host = require_mapping(tree.get(HOST_SECTION, {}), (HOST_SECTION,))
        for metric, settings in {**{name: {"source": name} for name in PRESETS[preset]}, **host}.items():
            with problems:
                where = (HOST_SECTION, metric)
                sections[metric] = where, *_host_settings(metric, settings, where)
    return sections


def _host_settings(metric: str, settings: Any, where: Path) -> tuple[Sequence[Parameter], dict[str, Any]]:
    """Returns the parameters that a metric of the section `host` can have, and what is given of them."""
    if metric in METRICS:
        raise ConfigError("is the name of a standard metric; expected another name", where)
    if not _NAME.match(metric):
        raise ConfigError("expected a name of letters, digits and _, starting with a letter", where)
    given = dict(require_mapping(settings, where))
    source = Parameter("source", str, None, "metric of this machine", choices=tuple(_host_sources()))
    if given.get("source") is None:
        raise ConfigError(f"is missing; expected {source.allowed} (see `robot-health sources`)", (*where, "source"))
    options = _host_sources()[source.read(given["source"], (*where, "source"))].options
    return (source, *options), given


def _host_sources() -> Mapping[str, HostSource]:
    from .catalogue import HOST_SOURCES

    return HOST_SOURCES
