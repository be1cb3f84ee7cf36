"""What of this machine battery_sensor can publish: `HOST_SOURCES` is the one list, the classes below read it.

source = HOST_SOURCES["disk_percent"].make(path="/")
source.read(now_s)                      # % used, or SensorError
"""

from __future__ import annotations

import os
from functools import partial
from typing import Any, Callable, Iterable, List, Mapping, NamedTuple, Optional, Tuple

from ..parameters import Parameter
from .host import (
    HostBattery,
    HostCpuUsage,
    HostTemperature,
    battery_folder,
    call_psutil,
    read_battery,
    temperature_sensors,
)
from .source import NotYet, SensorError, Source


class HostSource(NamedTuple):
    """One kind of value that a machine has."""

    unit: str
    """Unit of the value."""
    description: str
    """What it is, in a few words."""
    make: Callable[..., Source]
    """Makes the source; takes the option by its name."""
    option: Optional[Parameter] = None
    """Which one, where a machine may have several."""
    offered: Callable[[], Iterable[Any]] = tuple
    """Returns the values of the option that there are on this machine; raises SensorError when they cannot be read."""


class Reading:
    """A source that is one function."""

    def __init__(self, read: Callable[[], float]) -> None:
        """Takes the function, which may raise SensorError."""
        self._read = read

    def read(self, now_s: float) -> float:
        """Returns the value now.

        Raises:
            SensorError: it cannot be read.
        """
        return self._read()


class HostDisk:
    """How full a disk is."""

    def __init__(self, field: str, scale: float, path: str) -> None:
        """Reads nothing yet.

        Args:
            field: of psutil's answer.
            scale: what it is multiplied with.
            path: where the disk is mounted.
        """
        self._field = field
        self._scale = scale
        self._path = path

    def read(self, now_s: float) -> float:
        """Returns the value now.

        Raises:
            SensorError: no disk is mounted there. The folder that is left when a disk was unmounted would otherwise
                be read as the disk that it lies on.
        """
        if not os.path.ismount(self._path):
            raise SensorError(f"no disk is mounted at {self._path}; {_disk_of(self._path)}")
        usage = call_psutil("disk_usage", f"the disk at {self._path}", self._path)
        return float(getattr(usage, self._field)) * self._scale


class HostNetworkRate:
    """How much a counter of a network interface grows per second."""

    def __init__(self, fields: Tuple[str, str], interface: str = "") -> None:
        """Reads nothing yet.

        Args:
            fields: the counters to add up, of psutil's answer.
            interface: its name; empty: all together.
        """
        self._fields = fields
        self._interface = interface
        self._last: Optional[Tuple[float, int]] = None
        self._rate: Optional[float] = None

    def read(self, now_s: float) -> float:
        """Returns the growth per second since the read before; the last one when no time has passed since.

        Raises:
            SensorError: there is no such interface, or nothing has been measured yet.
        """
        try:
            count = self._count()
        except SensorError:
            self._last = self._rate = None
            raise
        if self._last is None or now_s < self._last[0]:
            self._last = now_s, count
        elif now_s > self._last[0]:
            # a counter that is smaller than before began again
            self._rate = max(0, count - self._last[1]) / (now_s - self._last[0])
            self._last = now_s, count
        if self._rate is None:
            raise NotYet("no rate yet: it is measured from one read to the next")
        return self._rate

    def _count(self) -> int:
        counters = _network_counters()
        if self._interface == "" and counters:
            chosen = list(counters.values())
        elif self._interface in counters:
            chosen = [counters[self._interface]]
        else:
            there = ", ".join(sorted(counters)) or "none"
            raise SensorError(
                f"this machine shows no network interface {self._interface or 'at all'}; there are {there}"
            )
        return sum(int(getattr(counter, field)) for counter in chosen for field in self._fields)


def _load(minutes: int) -> Callable[[], float]:
    def read() -> float:
        try:
            return os.getloadavg()[(1, 5, 15).index(minutes)]
        except (AttributeError, OSError) as error:
            raise SensorError(f"this machine tells no load average: {error}") from None

    return read


def _memory(field: str, scale: float = 1.0) -> Callable[[], float]:
    return lambda: float(getattr(call_psutil("virtual_memory", "memory"), field)) * scale


def _swap_percent() -> float:
    swap = call_psutil("swap_memory", "swap")
    if not swap.total:
        raise SensorError("this machine has no swap")
    return float(swap.percent)


def _plugged() -> float:
    plugged = read_battery().power_plugged
    if plugged is None:
        raise SensorError("this machine does not tell whether its charger is plugged in")
    return 1.0 if plugged else 0.0


def _voltage() -> float:
    read_battery()
    return _power_supply_number("voltage_now") / 1e6


def _current() -> float:
    """Returns the current in A, negative when discharging, as sensor_msgs/BatteryState has it."""
    read_battery()
    try:
        amperes = abs(_power_supply_number("current_now")) / 1e6
    except SensorError:
        volts = _voltage()
        if not volts:
            raise
        amperes = abs(_power_supply_number("power_now")) / 1e6 / volts
    return -amperes if _power_supply_text("status") == "Discharging" else amperes


def _power_supply_text(file: str) -> str:
    folder = battery_folder()
    try:
        with open(os.path.join(folder or "", file), encoding="ascii") as stream:
            return stream.read().strip()
    except (OSError, ValueError) as error:
        raise SensorError(f"this machine's battery tells no {file}: {error}") from None


def _power_supply_number(file: str) -> int:
    text = _power_supply_text(file)
    try:
        return int(text)
    except ValueError:
        raise SensorError(f"this machine's battery tells no {file}: {text!r} is no number") from None


def _disk_of(path: str) -> str:
    """Says where the disk is mounted that a path lies on."""
    if not os.path.exists(path):
        return "there is no such folder"
    above = os.path.realpath(path)
    while not os.path.ismount(above):
        above = os.path.dirname(above)
    return f"the folder lies on the disk at {above}"


def _cores() -> List[Optional[int]]:
    return [None, *range(len(call_psutil("cpu_times", "CPU times", percpu=True)))]


def _mount_points() -> List[str]:
    """Returns where disks are mounted, each disk once."""
    found = {"/": ""}
    for partition in call_psutil("disk_partitions", "mounted disks", all=False):
        if partition.device not in found.values() and os.path.isdir(partition.mountpoint):
            found[partition.mountpoint] = partition.device
    return sorted(path for path in found if os.path.ismount(path))


def _interfaces() -> List[str]:
    return sorted(name for name in _network_counters() if name != "lo")


def _network_counters() -> Any:
    # nowrap: psutil would keep what it saw of an interface for the whole process
    return call_psutil("net_io_counters", "network counters", pernic=True, nowrap=False)


def _sensors() -> List[str]:
    sensors = temperature_sensors()
    return ["", *sensors] if sensors else []


_CORE = Parameter("core", int, None, "which core, from 0; left out: all together", 0, 65535)
_PATH = Parameter("path", str, "/", "where the disk is mounted")
_SENSOR = Parameter("sensor", str, "", "which sensor, chip/label or chip/number; left out: the hottest of the CPU")
_INTERFACE = Parameter("interface", str, "", "which network interface; left out: all together")


HOST_SOURCES: Mapping[str, HostSource] = {
    "cpu_percent": HostSource("%", "processor time in use", HostCpuUsage, _CORE, _cores),
    "load_1min": HostSource("", "processes that run or wait, mean of a minute", partial(Reading, _load(1))),
    "load_5min": HostSource("", "the same of 5 minutes", partial(Reading, _load(5))),
    "load_15min": HostSource("", "the same of 15 minutes", partial(Reading, _load(15))),
    "memory_percent": HostSource("%", "memory in use", partial(Reading, _memory("percent"))),
    "memory_available": HostSource(
        "MB", "memory that programs can still get", partial(Reading, _memory("available", 1e-6))
    ),
    "swap_percent": HostSource("%", "swap in use", partial(Reading, _swap_percent)),
    "disk_percent": HostSource("%", "disk in use", partial(HostDisk, "percent", 1.0), _PATH, _mount_points),
    "disk_free": HostSource("GB", "disk that is free", partial(HostDisk, "free", 1e-9), _PATH, _mount_points),
    "temperature": HostSource("degC", "temperature", HostTemperature, _SENSOR, _sensors),
    "battery_percent": HostSource("%", "charge of the battery", HostBattery),
    "battery_plugged": HostSource("", "1 while the charger is plugged in, else 0", partial(Reading, _plugged)),
    "battery_voltage": HostSource("V", "voltage of the battery", partial(Reading, _voltage)),
    "battery_current": HostSource("A", "current of the battery, negative when discharging", partial(Reading, _current)),
    "network_errors": HostSource(
        "1/s", "packets with errors", partial(HostNetworkRate, ("errin", "errout")), _INTERFACE, _interfaces
    ),
    "network_drops": HostSource(
        "1/s", "packets dropped", partial(HostNetworkRate, ("dropin", "dropout")), _INTERFACE, _interfaces
    ),
}
"""What `source` may be in the section `host` of battery_sensor."""
