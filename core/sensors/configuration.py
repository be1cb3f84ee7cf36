"""Configuration of battery_sensor: its metrics, and the source of each: simulated, this machine, or none.

`HOST_SOURCES` lists every metric of this machine that it can publish, and how each is read:

source = HOST_SOURCES["disk_percent"].make(path="/")
source.read(now_s)                      # % used, or SensorError
"""

from __future__ import annotations

import os
import random
import re
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Callable, Dict, Iterable, List, Mapping, NamedTuple, Optional, Tuple

from ..errors import ConfigError, Path, Problems
from ..parameters import Parameter, read_parameters, require_mapping
from .host import HOST_PATHS, Battery, HostCpuUsage, HostPaths, HostTemperature, call_psutil, temperature_sensors
from .simulated import SimulatedBattery, SimulatedCpuUsage, SimulatedTemperature
from .source import NoSuchSensor, NotMeasuredYet, SensorError, Source


class HostSource(NamedTuple):
    """One kind of metric of a machine."""

    unit: str
    description: str
    make: Callable[..., Source]
    """Creates the source; takes the option by its name, and `paths`."""
    option: Optional[Parameter] = None
    """Selects one where a machine may have several."""
    available: Callable[[HostPaths], Iterable[Any]] = lambda paths: ()
    """Returns the values of the option that this machine has; raises SensorError if they cannot be read."""


@dataclass(frozen=True)
class HostReading:
    """A source that remembers nothing between two reads."""

    function: Callable[[], float]

    def read(self, now_s: float) -> float:
        """Returns the value of the function, which may raise SensorError."""
        return self.function()


class HostNetworkRate:
    """Rate at which counters of a network interface grow, per second."""

    def __init__(self, fields: Tuple[str, str], interface: str = "", paths: HostPaths = HOST_PATHS) -> None:
        """Adds up two counters of psutil, of one interface or, without a name, of all together."""
        self._fields = fields
        self._interface = interface
        self._paths = paths
        self._last: Optional[Tuple[float, int]] = None
        self._rate: Optional[float] = None

    def read(self, now_s: float) -> float:
        """Returns the rate since the previous read in 1/s; the previous one if no time has passed since.

        Raises SensorError if there is no such interface, or if the rate has not been measured yet.
        """
        try:
            count = self._count()
        except SensorError:
            self._last = self._rate = None
            raise
        if self._last is None or now_s < self._last[0]:
            self._last = now_s, count
        elif now_s > self._last[0]:
            # A counter that is smaller than before was reset.
            self._rate = max(0, count - self._last[1]) / (now_s - self._last[0])
            self._last = now_s, count
        if self._rate is None:
            raise NotMeasuredYet("the rate is not measured yet: it takes two reads")
        return self._rate

    def _count(self) -> int:
        counters = _network_counters(self._paths)
        if self._interface == "" and counters:
            chosen = list(counters.values())
        elif self._interface in counters:
            chosen = [counters[self._interface]]
        else:
            available = ", ".join(sorted(counters)) or "none"
            name = f" {self._interface}" if self._interface else ""
            raise SensorError(f"this machine has no network interface{name}; available: {available}")
        return sum(int(getattr(counter, field)) for counter in chosen for field in self._fields)


def _reading(function: Callable[..., float], *arguments: object) -> Callable[..., Source]:
    """Returns what makes a source of a function, which also gets `paths` and the option."""
    return lambda paths=HOST_PATHS, **option: HostReading(partial(function, *arguments, paths=paths, **option))


def _load(index: int, paths: HostPaths) -> float:
    try:
        return os.getloadavg()[index]
    except (AttributeError, OSError) as error:
        raise SensorError(f"this machine has no load average: {error}") from None


def _memory(field: str, scale: float, paths: HostPaths) -> float:
    return float(getattr(call_psutil("virtual_memory", "memory", paths), field)) * scale


def _swap_percent(paths: HostPaths) -> float:
    swap = call_psutil("swap_memory", "swap", paths)
    if not swap.total:
        raise NoSuchSensor("this machine has no swap")
    return float(swap.percent)


def _disk(field: str, scale: float, path: str, paths: HostPaths) -> float:
    # The empty folder of an unmounted disk would be read as the disk that contains it.
    if not os.path.ismount(path):
        raise SensorError(f"no disk is mounted at {path}{_containing_disk(path)}")
    return float(getattr(call_psutil("disk_usage", f"the disk at {path}", paths, path), field)) * scale


def _containing_disk(path: str) -> str:
    if not os.path.exists(path):
        return ": there is no such folder"
    above = os.path.realpath(path)
    while not os.path.ismount(above):
        above = os.path.dirname(above)
    return f": the folder is on the disk at {above}"


def _battery(read: Callable[[Battery], float], paths: HostPaths) -> float:
    return float(read(Battery(paths)))


def _cores(paths: HostPaths) -> List[Optional[int]]:
    return [None, *range(len(call_psutil("cpu_times", "CPU times", paths, percpu=True)))]


def _mount_points(paths: HostPaths) -> List[str]:
    """Returns where disks are mounted, each disk once."""
    devices = {"/": ""}
    for partition in call_psutil("disk_partitions", "mounted disks", paths, all=False):
        if partition.device not in devices.values() and os.path.isdir(partition.mountpoint):
            devices[partition.mountpoint] = partition.device
    return sorted(path for path in devices if os.path.ismount(path))


def _interfaces(paths: HostPaths) -> List[str]:
    return sorted(name for name in _network_counters(paths) if name != "lo")


def _network_counters(paths: HostPaths) -> Any:
    # nowrap: psutil would remember an interface's counters for the life of the process
    return call_psutil("net_io_counters", "network counters", paths, pernic=True, nowrap=False)


def _sensors(paths: HostPaths) -> List[str]:
    sensors = temperature_sensors(paths)
    return ["", *sensors] if sensors else []


_CORE = Parameter("core", int, None, "core, counted from 0; left out: all cores together", 0, 65535)
_PATH = Parameter("path", str, "/", "mount point of the disk")
_SENSOR = Parameter("sensor", str, "", "sensor, as chip/label or chip/number; left out: the hottest of the CPU")
_INTERFACE = Parameter("interface", str, "", "network interface; left out: all together")
_ERRORS = partial(HostNetworkRate, ("errin", "errout"))
_DROPS = partial(HostNetworkRate, ("dropin", "dropout"))

HOST_SOURCES: Mapping[str, HostSource] = {
    "cpu_percent": HostSource("%", "CPU load", HostCpuUsage, _CORE, _cores),
    "load_1min": HostSource("", "load average over 1 minute", _reading(_load, 0)),
    "load_5min": HostSource("", "load average over 5 minutes", _reading(_load, 1)),
    "load_15min": HostSource("", "load average over 15 minutes", _reading(_load, 2)),
    "memory_percent": HostSource("%", "memory in use", _reading(_memory, "percent", 1.0)),
    "memory_available": HostSource("MB", "memory available to programs", _reading(_memory, "available", 1e-6)),
    "swap_percent": HostSource("%", "swap in use", _reading(_swap_percent)),
    "disk_percent": HostSource("%", "disk in use", _reading(_disk, "percent", 1.0), _PATH, _mount_points),
    "disk_free": HostSource("GB", "free disk space", _reading(_disk, "free", 1e-9), _PATH, _mount_points),
    "temperature": HostSource("degC", "temperature", HostTemperature, _SENSOR, _sensors),
    "battery_percent": HostSource("%", "battery charge", _reading(_battery, Battery.percent)),
    "battery_plugged": HostSource(
        "", "1 while the charger is connected, else 0", _reading(_battery, Battery.is_plugged)
    ),
    "battery_voltage": HostSource("V", "battery voltage", _reading(_battery, Battery.volts)),
    "battery_current": HostSource(
        "A", "battery current, negative when discharging", _reading(_battery, Battery.amperes)
    ),
    "network_errors": HostSource("1/s", "packets with errors", _ERRORS, _INTERFACE, _interfaces),
    "network_drops": HostSource("1/s", "dropped packets", _DROPS, _INTERFACE, _interfaces),
}
"""Allowed values of `source` in the section `host` of battery_sensor."""

METRICS: Mapping[str, str] = {"battery_level": "%", "temperature": "degC", "cpu_usage": "%"}
"""Name (which is also the topic) and unit of the standard metrics, in the order in which they are published."""

SEED = Parameter("seed", int, None, "seed of the simulated values; left out: different values at every start")

_SOURCE = Parameter(
    "source",
    str,
    "simulated",
    "source of the values: simulated, host (this machine) or none (not published)",
    choices=("simulated", "host", "none"),
)

METRIC_PARAMETERS: Mapping[str, Tuple[Parameter, ...]] = {
    "battery_level": (
        _SOURCE,
        Parameter("discharge_rate", float, 1.0, "simulated: discharge in % per second", minimum=0.0),
        Parameter("charge_rate", float, 4.0, "simulated: charge in % per second", minimum=0.0),
        Parameter("charge_at", float, 5.0, "simulated: level in % at which charging starts", minimum=0.0, maximum=99.0),
    ),
    "temperature": (
        _SOURCE,
        Parameter("mean", float, 60.0, "simulated: mean in degrees C"),
        Parameter("spread", float, 4.0, "simulated: largest deviation from the mean in degrees C", minimum=0.0),
        Parameter("spike", float, 30.0, "simulated: height in degrees C of a hot spell of 30 s; 0: none", minimum=0.0),
        Parameter("spike_every_s", float, 120.0, "simulated: period in s with one hot spell each", minimum=1.0),
    ),
    "cpu_usage": (
        _SOURCE,
        Parameter("mean", float, 35.0, "simulated: mean in %", minimum=0.0, maximum=100.0),
        Parameter("spread", float, 30.0, "simulated: largest deviation from the mean in %", minimum=0.0),
    ),
}
"""Parameters of the standard metrics, each in the section of its name; the first is `source`."""

HOST_SECTION = "host"
"""Section with further metrics of this machine, by name, which is also the topic."""

SECTION_NAMES = (*METRIC_PARAMETERS, HOST_SECTION)
"""Sections of the node's configuration."""

_HOST_SOURCE = Parameter("source", str, None, "metric of this machine", choices=tuple(HOST_SOURCES))
_HOST_METRICS = {"battery_level": "battery_percent", "temperature": "temperature", "cpu_usage": "cpu_percent"}
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


def read_sources(tree: Mapping[str, Any], path: Path = (), paths: HostPaths = HOST_PATHS) -> Dict[str, Source]:
    """Creates a source per metric, in the order of `METRICS` and then of the section `host`; none for `source: none`.

    Reads `seed`, `sensors` and the sections of a node's whole configuration. `path` has the keys above it, for errors:
    a ConfigError with all unknown keys and values that are not allowed.
    """
    sources: Dict[str, Source] = {}
    problems = Problems()
    seed = random.getrandbits(32)
    with problems:
        if tree.get("seed") is not None:
            seed = SEED.read(tree["seed"], (*path, "seed"))
    for metric in METRICS:
        with problems:
            source = _read_source(metric, tree, f"{seed}/{metric}", (*path, metric), paths)
            if source is not None:
                sources[metric] = source
    with problems:
        for metric, found in _host_sections(tree, path).items():
            with problems:
                sources[metric] = _read_host_source(found, (*path, HOST_SECTION, metric), paths)
    problems.raise_if_any()
    return sources


def settings_of(tree: Mapping[str, Any], metric: str) -> Mapping[str, Any]:
    """Returns the settings of one metric in a valid configuration, defaults included; empty if it is not there."""
    if metric in METRICS:
        section, parameters = _section(tree, metric, ()), METRIC_PARAMETERS[metric]
    else:
        section = tree.get(HOST_SECTION, {}).get(metric, {})
        parameters = _host_parameters(section["source"]) if section else ()
    return {**{parameter.name: parameter.default for parameter in parameters}, **section}


def declared_parameters(tree: Mapping[str, Any]) -> Tuple[Parameter, ...]:
    """Returns the parameters of every metric in a valid configuration, by their dotted names."""
    # A middleware that fills in defaults must not fill in another source than `sensors` does.
    source = replace(_SOURCE, default=tree.get("sensors") or _SOURCE.default)
    sections = {metric: (source, *parameters[1:]) for metric, parameters in METRIC_PARAMETERS.items()}
    for metric, found in _host_sections(tree, ()).items():
        sections[f"{HOST_SECTION}.{metric}"] = _host_parameters(found["source"])
    return tuple(
        replace(parameter, name=f"{section}.{parameter.name}")
        for section, parameters in sections.items()
        for parameter in parameters
    )


def _section(tree: Mapping[str, Any], metric: str, path: Path) -> Mapping[str, Any]:
    """Returns the section of a standard metric; its default source is that of the parameter `sensors`."""
    found = require_mapping(tree.get(metric, {}), path)
    source = found.get("source", tree.get("sensors") or _SOURCE.default)
    return {**found, "source": "none" if source is False else source}  # YAML reads a plain `off` or `no` as false


def _host_sections(tree: Mapping[str, Any], path: Path) -> Mapping[str, Mapping[str, Any]]:
    sections = require_mapping(tree.get(HOST_SECTION, {}), (*path, HOST_SECTION))
    problems = Problems()
    for metric, found in sections.items():
        where = (*path, HOST_SECTION, metric)
        with problems:
            if metric in METRICS:
                raise ConfigError("is the name of a standard metric; expected another name", where)
            if not _NAME.match(metric):
                raise ConfigError("expected a name of letters, digits and _, starting with a letter", where)
            require_mapping(found, where)
    problems.raise_if_any()
    return sections


def _host_parameters(source: str) -> Tuple[Parameter, ...]:
    option = HOST_SOURCES[source].option
    return (_HOST_SOURCE,) if option is None else (_HOST_SOURCE, option)


def _read_host_source(section: Mapping[str, Any], path: Path, paths: HostPaths) -> Source:
    if section.get("source") is None:
        raise ConfigError(f"is missing; expected {_HOST_SOURCE.allowed}", (*path, "source"))
    source = _HOST_SOURCE.read(section["source"], (*path, "source"))
    options = read_parameters(section, _host_parameters(source), path)
    del options["source"]
    return HOST_SOURCES[source].make(**options, paths=paths)


def _read_source(metric: str, tree: Mapping[str, Any], seed: str, path: Path, paths: HostPaths) -> Optional[Source]:
    values = read_parameters(_section(tree, metric, path), METRIC_PARAMETERS[metric], path)
    kind = values.pop("source")
    if kind == "none":
        return None
    if kind == "host":
        return HOST_SOURCES[_HOST_METRICS[metric]].make(paths=paths)
    if metric == "battery_level":
        return SimulatedBattery(**values)
    if metric == "temperature":
        return SimulatedTemperature(**values, seed=seed)
    return SimulatedCpuUsage(**values, seed=seed)
