"""Every metric of this machine that battery_sensor can publish: `HOST_SOURCES` is the list, and how each is read.

source = HOST_SOURCES["disk_percent"].make(path="/")
source.read(now_s)                      # % used, or SensorError
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Iterable, List, Mapping, NamedTuple, Optional, Tuple

from ..parameters import Parameter
from .host import HOST_PATHS, Battery, HostCpuUsage, HostPaths, HostTemperature, call_psutil, temperature_sensors
from .source import NoSuchSensor, NotMeasuredYet, SensorError, Source


class HostSource(NamedTuple):
    """One kind of metric of a machine."""

    unit: str
    """Unit of the value."""
    description: str
    """Its meaning, in a few words."""
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
    """Returns the value; may raise SensorError."""

    def read(self, now_s: float) -> float:
        """Returns the current value, or raises SensorError."""
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
    """Returns the usage of the disk that is mounted at a path.

    Without the check, the empty folder of an unmounted disk would be read as the disk that contains it.
    """
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
