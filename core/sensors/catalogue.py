"""The metrics of this machine that battery_sensor can publish, and how each is read.

    source = HOST_SOURCES["disk_percent"].make(Computer(), path="/")
    source.read(now_s)                      # % used, or SensorError

docs/signals.md is generated from this table, and `robot-health sources` lists it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Dict, Iterable, List, Mapping, NamedTuple, Tuple

from ..parameters import Parameter
from . import daemons, disks, gpu, network, operating_system, processes
from .computer import Computer, HostPaths
from .host import (
    Battery,
    HostCpuUsage,
    HostTemperature,
    fan_rpm,
    rail_volts,
    read_chips,
    read_cpu_ticks,
    temperature_sensors,
)
from .processes import ProcessSource
from .source import Source

__all__ = ["HOST_SOURCES", "HostReading", "HostSource"]

Options = Dict[str, Any]


class HostSource(NamedTuple):
    """One kind of metric of a machine."""

    unit: str
    description: str
    make: Callable[..., Source]
    """Creates the source; takes the computer, and the options by their names."""
    options: Tuple[Parameter, ...] = ()
    """Select one where a machine may have several."""
    available: Callable[[HostPaths], Iterable[Options]] = lambda paths: ()
    """Returns the options of each that this machine has; raises SensorError if they cannot be read."""
    required: Tuple[str, ...] = ()
    """Names of options of which at least one must be given."""

    @property
    def options_text(self) -> str:
        """The options with their meaning, for the documentation."""
        return "; ".join(f"`{option.name}`: {option.description}" for option in self.options)


@dataclass(frozen=True)
class HostReading:
    """A source that remembers nothing between two reads."""

    function: Callable[[float], float]

    def read(self, now_s: float) -> float:
        """Returns the value of the function, which may raise SensorError."""
        return self.function(now_s)


def _reading(function: Callable[..., float], *arguments: object) -> Callable[..., Source]:
    """Returns what makes a source of a function, which gets the paths, its arguments and the options."""

    def make(computer: Computer, **options: Any) -> Source:
        return HostReading(lambda now_s: computer.once(now_s, function, *arguments, *options.values()))

    return make


def _shared(read: Callable[..., Any], value: Callable[..., float], *arguments: object) -> Callable[..., Source]:
    """Returns what makes a source of a part of what `read` returns, which all sources share."""

    def make(computer: Computer, **options: Any) -> Source:
        return HostReading(lambda now_s: value(computer.once(now_s, read, *arguments), *options.values()))

    return make


def _asked(
    subject: str, every_s: float, read: Callable[..., Any], value: Callable[..., float]
) -> Callable[..., Source]:
    """Returns what makes a source of a part of what `read` returns, which may hang."""

    def make(computer: Computer, **options: Any) -> Source:
        arguments = tuple(options.values())
        named = " ".join([subject, *map(str, arguments)])
        return HostReading(lambda now_s: value(computer.ask(now_s, every_s, named, read, *arguments)))

    return make


def _battery(read: Callable[[Battery], float]) -> Callable[..., Source]:
    return _shared(Battery, lambda battery: float(read(battery)))


def _listed(option: str, names: Callable[[HostPaths], Iterable[Any]]) -> Callable[[HostPaths], Iterable[Options]]:
    """Returns what lists the values of one option."""
    return lambda paths: [{option: name} for name in names(paths)]


def _cores(paths: HostPaths) -> List[Any]:
    return list(read_cpu_ticks(paths))


def _temperature_sensors(paths: HostPaths) -> List[str]:
    sensors = temperature_sensors(paths)
    return ["", *sensors] if sensors else []


def _nodes(paths: HostPaths) -> Iterable[Options]:
    names = processes.Processes(paths).scan(paths).nodes()
    # Without a node: how to select another process.
    return [{"node": name} for name in itertools.islice(names, 50)] or [{"command": "*/amcl *"}]


_CORE = Parameter("core", int, None, "core, counted from 0; left out: all cores together", 0, 65535)
_PATH = Parameter("path", str, "/", "mount point of the disk")
_SENSOR = Parameter("sensor", str, "", "sensor, as chip/label or chip/number; left out: the hottest of the CPU")
_FAN = Parameter("sensor", str, "", "fan, as chip/label; left out: the fastest")
_RAIL = Parameter("sensor", str, "", "voltage, as chip/label; left out: the first")
_INTERFACE = Parameter("interface", str, "", "network interface; left out: all together")
_CARRIER = Parameter("interface", str, "", "network interface; left out: any")
_WIFI = Parameter("interface", str, "", "Wi-Fi interface; left out: the first")
_CAN = Parameter("interface", str, "", "CAN interface; left out: all together")
_DISK = Parameter("device", str, "", "disk, such as sda; left out: the slowest")
_GPU = Parameter("device", int, 0, "number of the graphics processor", 0, 63)
_PROCESS = (
    Parameter("command", str, "", "pattern of the whole command line, with * and ?"),
    Parameter("node", str, "", "name of a ROS node: of __node:= or __name:=, or the executable"),
)
_REDUCE = Parameter("reduce", str, "sum", "of several processes", choices=tuple(processes.REDUCTIONS))


def _rate(fields: Tuple[str, ...], scale: float = 1.0) -> Callable[..., Source]:
    return partial(network.CounterRate, fields, scale)


def _can_rate(computer: Computer, interface: str = "") -> Source:
    return network.CounterRate(network.ERRORS, 1.0, computer, interface, network.can_interfaces)


def _space(value: Callable[[disks.Space], float]) -> Callable[..., Source]:
    return _asked("the disk at", 5.0, disks.read_space, value)


def _gpu(name: str) -> Callable[..., Source]:
    return _asked("graphics processor", 0.0, gpu.read_gpu, partial(_gpu_value, name))


def _gpu_value(name: str, found: gpu.Gpu) -> float:
    return gpu.gpu_value(found, name)


def _clock(value: Callable[[daemons.Clock], float]) -> Callable[..., Source]:
    return _asked("the time daemon", 5.0, daemons.read_clock, value)


def _memory(value: Callable[[bytes], float]) -> Callable[..., Source]:
    return _shared(operating_system.meminfo, value)


_ON_DISK = (_PATH,), _listed("path", disks.mount_points)
_OF_INTERFACE = (_INTERFACE,), _listed("interface", network.interfaces)
_OF_WIFI = (_WIFI,), _listed("interface", network.wifi_interfaces)
_OF_GPU = (_GPU,), _listed("device", gpu.gpus)

HOST_SOURCES: Mapping[str, HostSource] = {
    "cpu_percent": HostSource(
        "%", "CPU load", HostCpuUsage, (_CORE,),
        _listed("core", _cores),
    ),
    "load_1min": HostSource("", "load average over 1 minute", _reading(operating_system.load, 0)),
    "load_5min": HostSource("", "load average over 5 minutes", _reading(operating_system.load, 1)),
    "load_15min": HostSource("", "load average over 15 minutes", _reading(operating_system.load, 2)),
    "memory_percent": HostSource("%", "memory in use", _memory(operating_system.memory_percent)),
    "memory_available": HostSource("MB", "memory available to programs", _memory(operating_system.memory_available)),
    "swap_percent": HostSource("%", "swap in use", _memory(operating_system.swap_percent)),
    "pressure_cpu": HostSource(
        "%", "share of the last 10 s in which a process waited for the CPU",
        _reading(operating_system.pressure_percent, "cpu"),
    ),
    "pressure_memory": HostSource(
        "%", "share of the last 10 s in which a process waited for memory",
        _reading(operating_system.pressure_percent, "memory"),
    ),
    "pressure_io": HostSource(
        "%", "share of the last 10 s in which a process waited for a disk",
        _reading(operating_system.pressure_percent, "io"),
    ),
    "oom_kills": HostSource(
        "", "processes that were killed since the start because memory was used up",
        _reading(operating_system.oom_kills),
    ),
    "disk_percent": HostSource("%", "disk in use", _space(lambda space: space.percent), *_ON_DISK),
    "disk_free": HostSource("GB", "free disk space", _space(lambda space: space.free_gb), *_ON_DISK),
    "disk_inodes_percent": HostSource("%", "inodes in use: files and folders", _space(disks.inodes_percent), *_ON_DISK),
    "disk_read_only": HostSource(
        "", "1 while the disk cannot be written, else 0", _space(lambda space: float(space.is_read_only)), *_ON_DISK
    ),
    "disk_latency_ms": HostSource(
        "ms", "mean time of a request of the disk", disks.DiskLatency, (_DISK,), _listed("device", disks.devices)
    ),
    "temperature": HostSource(
        "degC", "temperature", lambda computer, sensor="": HostTemperature(sensor, computer.paths), (_SENSOR,),
        _listed("sensor", _temperature_sensors),
    ),
    "fan_rpm": HostSource(
        "rpm", "speed of a fan", _shared(read_chips, fan_rpm, "fan"), (_FAN,),
        _listed("sensor", lambda paths: read_chips(paths, "fan")),
    ),
    "voltage_rail": HostSource(
        "V", "voltage of a supply", _shared(read_chips, rail_volts, "in"), (_RAIL,),
        _listed("sensor", lambda paths: read_chips(paths, "in")),
    ),
    "throttled": HostSource(
        "", "1 while a Raspberry Pi is slowed down by its supply or temperature, else 0",
        _reading(operating_system.throttled),
    ),
    "gpu_percent": HostSource("%", "load of the graphics processor", _gpu("percent"), *_OF_GPU),
    "gpu_memory_percent": HostSource(
        "%", "memory of the graphics processor in use", _gpu("memory_percent"), *_OF_GPU
    ),
    "gpu_temperature": HostSource("degC", "temperature of the graphics processor", _gpu("celsius"), *_OF_GPU),
    "battery_percent": HostSource("%", "battery charge", _battery(Battery.percent)),
    "battery_plugged": HostSource("", "1 while the charger is connected, else 0", _battery(Battery.is_plugged)),
    "battery_voltage": HostSource("V", "battery voltage", _battery(Battery.volts)),
    "battery_current": HostSource("A", "battery current, negative when discharging", _battery(Battery.amperes)),
    "network_receive": HostSource("MB/s", "data received", _rate(("received",), 1e-6), *_OF_INTERFACE),
    "network_send": HostSource("MB/s", "data sent", _rate(("sent",), 1e-6), *_OF_INTERFACE),
    "network_errors": HostSource("1/s", "packets with errors", _rate(network.ERRORS), *_OF_INTERFACE),
    "network_drops": HostSource("1/s", "dropped packets", _rate(("drops_received", "drops_sent")), *_OF_INTERFACE),
    "network_carrier": HostSource(
        "", "1 while there is a carrier (cable connected, Wi-Fi associated), else 0", _reading(network.carrier),
        (_CARRIER,), _listed("interface", network.interfaces),
    ),
    "wifi_signal": HostSource("dBm", "signal of the Wi-Fi", _reading(network.signal_dbm), *_OF_WIFI),
    "wifi_bitrate": HostSource("Mbit/s", "bit rate of the Wi-Fi", _reading(network.bitrate), *_OF_WIFI),
    "can_errors": HostSource(
        "1/s", "errors of a CAN bus", _can_rate, (_CAN,), _listed("interface", network.can_interfaces)
    ),
    "clock_offset_ms": HostSource(
        "ms", "time of the servers minus that of this clock (chrony, systemd-timesyncd)",
        _clock(daemons.clock_offset_ms),
    ),
    "clock_synchronized": HostSource(
        "", "1 while the clock is synchronized, else 0", _clock(lambda clock: float(clock.is_synchronized))
    ),
    "systemd_failed": HostSource(
        "", "failed units of systemd", _asked("systemd", 10.0, daemons.failed_units, float)
    ),
    "process_cpu_percent": HostSource(
        "%", "CPU time, in % of one core", partial(ProcessSource, "process_cpu_percent"), (*_PROCESS, _REDUCE), _nodes,
        ("command", "node"),
    ),
    "process_memory": HostSource(
        "MB", "resident memory", partial(ProcessSource, "process_memory"), (*_PROCESS, _REDUCE), _nodes,
        ("command", "node"),
    ),
    "process_memory_growth": HostSource(
        "MB/h", "growth of the resident memory over the last 10 min; not before 2 min",
        partial(ProcessSource, "process_memory_growth"), (*_PROCESS, _REDUCE), _nodes, ("command", "node"),
    ),
    "process_threads": HostSource(
        "", "threads", partial(ProcessSource, "process_threads"), (*_PROCESS, _REDUCE), _nodes, ("command", "node")
    ),
    "process_files": HostSource(
        "", "open files and sockets", partial(ProcessSource, "process_files"), (*_PROCESS, _REDUCE), _nodes,
        ("command", "node"),
    ),
    "process_restarts": HostSource(
        "", "starts again since the monitor began", partial(ProcessSource, "process_restarts"), _PROCESS, _nodes,
        ("command", "node"),
    ),
    "process_running": HostSource(
        "", "1 while at least one runs, else 0", partial(ProcessSource, "process_running"), _PROCESS, _nodes,
        ("command", "node"),
    ),
}  # fmt: skip
"""Allowed values of `source` in the section `host` of battery_sensor."""
