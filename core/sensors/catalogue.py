"""The metrics of this machine that battery_sensor can publish, and how each is read.

    source = HOST_SOURCES["disk_percent"].make(Computer(), path="/")
    source.read(now_s)                      # % used, or SensorError

docs/signals.md is generated from this table, and `robot-health sources` lists it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Dict, Iterable, List, Mapping, NamedTuple, Tuple

from ..config.parameters import Parameter
from . import daemons, disks, gpu, network, operating_system, processes
from .computer import Computer, HostPaths, call_psutil
from .host import Battery, HostCpuUsage, fan_rpm, rail_volts, read_cpu_ticks, sensor_names, temperature
from .processes import ProcessSource
from .source import Source

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
    def example(self) -> Options:
        """The options shown where `available` lists none: what a user may write, whose error gives the reason."""
        if self.required:
            return {"command": "*/amcl *"}
        return {option.name: option.default for option in self.options[:1]}

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


def _asked(
    subject: str, read: Callable[..., Any], value: Callable[[Any], float] = float, every_s: float = 0.0
) -> Callable[..., Source]:
    """Returns what makes a source of a part of what `read` returns, which gets the paths and the options.

    Sources with the same `read` and the same options share what it returns.
    """

    def make(computer: Computer, **options: Any) -> Source:
        arguments = tuple(options.values())
        named = " ".join([subject, *map(str, arguments)]).rstrip()
        return HostReading(lambda now_s: value(computer.ask(now_s, every_s, named, read, *arguments)))

    return make


def _battery(read: Callable[[Battery], float]) -> Callable[..., Source]:
    return _asked("the battery", lambda paths: read(Battery(paths)))


def _load(index: int) -> Callable[..., Source]:
    return _asked("the load", lambda paths: os.getloadavg()[index])


def _pressure(resource: str) -> Callable[..., Source]:
    return _asked("the pressure", lambda paths: operating_system.pressure_percent(paths, resource))


def _listed(option: str, names: Callable[[HostPaths], Iterable[Any]]) -> Callable[[HostPaths], Iterable[Options]]:
    """Returns what lists the values of one option."""
    return lambda paths: [{option: name} for name in names(paths)]


def _sensors(kind: str) -> Callable[[HostPaths], Iterable[Options]]:
    return _listed("sensor", lambda paths: sensor_names(paths, kind))


def _temperatures(paths: HostPaths) -> List[str]:
    names = sensor_names(paths, "temp")
    return ["", *names] if names else []


def _nodes(paths: HostPaths) -> Iterable[Options]:
    return [{"node": name} for name in processes.Processes(paths).scan(paths).nodes()[:50]]


_MEMORY = partial(call_psutil, "virtual_memory", "the memory")
_SWAP = partial(call_psutil, "swap_memory", "the swap")
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
_REDUCE = Parameter("reduce", str, "sum", "of several processes", choices=tuple(processes.REDUCTIONS))


def _process(metric: str, unit: str, description: str, *options: Parameter) -> HostSource:
    selecting = (
        Parameter("command", str, "", "pattern of the whole command line, with * and ?"),
        Parameter("node", str, "", "name of a ROS node: of __node:= or __name:=, or the executable"),
    )
    make = partial(ProcessSource, metric)
    return HostSource(unit, description, make, (*selecting, *options), _nodes, ("command", "node"))


def _rate(fields: Tuple[str, ...], scale: float = 1.0, **options: Any) -> Callable[..., Source]:
    return partial(network.CounterRate, fields, scale, **options)


def _space(value: Callable[[disks.Space], float]) -> Callable[..., Source]:
    return _asked("the disk at", disks.read_space, value, 5.0)


def _gpu(name: str) -> Callable[..., Source]:
    return _asked("graphics processor", gpu.read_gpu, lambda found: gpu.gpu_value(found, name))


def _clock(value: Callable[[daemons.Clock], float]) -> Callable[..., Source]:
    return _asked("the time daemon", daemons.read_clock, value, 5.0)


_ON_DISK = (_PATH,), _listed("path", disks.mount_points)
_OF_INTERFACE = (_INTERFACE,), _listed("interface", network.interfaces)
_OF_WIFI = (_WIFI,), _listed("interface", network.wifi_interfaces)
_OF_GPU = (_GPU,), _listed("device", gpu.gpus)

HOST_SOURCES: Mapping[str, HostSource] = {
    "cpu_percent": HostSource(
        "%", "CPU load", HostCpuUsage, (_CORE,),
        _listed("core", read_cpu_ticks),
    ),
    "load_1min": HostSource("", "load average over 1 minute", _load(0)),
    "load_5min": HostSource("", "load average over 5 minutes", _load(1)),
    "load_15min": HostSource("", "load average over 15 minutes", _load(2)),
    "memory_percent": HostSource("%", "memory in use", _asked("the memory", _MEMORY, operating_system.memory_percent)),
    "memory_available": HostSource(
        "MB", "memory available to programs", _asked("the memory", _MEMORY, lambda memory: memory.available * 1e-6)
    ),
    "swap_percent": HostSource("%", "swap in use", _asked("the swap", _SWAP, operating_system.swap_percent)),
    "pressure_cpu": HostSource(
        "%", "share of the last 10 s in which a process waited for the CPU",
        _pressure("cpu"),
    ),
    "pressure_memory": HostSource(
        "%", "share of the last 10 s in which a process waited for memory",
        _pressure("memory"),
    ),
    "pressure_io": HostSource(
        "%", "share of the last 10 s in which a process waited for a disk",
        _pressure("io"),
    ),
    "oom_kills": HostSource(
        "", "processes that were killed since the start because memory was used up",
        _asked("the kernel", operating_system.oom_kills),
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
        "degC", "temperature", _asked("temperature sensor", temperature), (_SENSOR,),
        _listed("sensor", _temperatures),
    ),
    "fan_rpm": HostSource(
        "rpm", "speed of a fan", _asked("fan", fan_rpm), (_FAN,), _sensors("fan"),
    ),
    "voltage_rail": HostSource(
        "V", "voltage of a supply", _asked("voltage sensor", rail_volts), (_RAIL,), _sensors("in"),
    ),
    "throttled": HostSource(
        "", "1 while a Raspberry Pi is slowed down by its supply or temperature, else 0",
        _asked("the firmware", operating_system.throttled),
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
    "network_receive": HostSource("MB/s", "data received", _rate(("bytes_recv",), 1e-6), *_OF_INTERFACE),
    "network_send": HostSource("MB/s", "data sent", _rate(("bytes_sent",), 1e-6), *_OF_INTERFACE),
    "network_errors": HostSource("1/s", "packets with errors", _rate(("errin", "errout")), *_OF_INTERFACE),
    "network_drops": HostSource("1/s", "dropped packets", _rate(("dropin", "dropout")), *_OF_INTERFACE),
    "network_carrier": HostSource(
        "", "1 while there is a carrier (cable connected, Wi-Fi associated), else 0",
        _asked("the network", network.carrier), (_CARRIER,), _listed("interface", network.interfaces),
    ),
    "wifi_signal": HostSource("dBm", "signal of the Wi-Fi", _asked("the Wi-Fi", network.signal_dbm), *_OF_WIFI),
    "wifi_bitrate": HostSource("Mbit/s", "bit rate of the Wi-Fi", _asked("the Wi-Fi", network.bitrate), *_OF_WIFI),
    "can_errors": HostSource(
        "1/s", "errors of a CAN bus", _rate(("errin", "errout"), among=network.can_interfaces), (_CAN,),
        _listed("interface", network.can_interfaces),
    ),
    "clock_offset_ms": HostSource(
        "ms", "time of the servers minus that of this clock (chrony, systemd-timesyncd)",
        _clock(daemons.clock_offset_ms),
    ),
    "clock_synchronized": HostSource(
        "", "1 while the clock is synchronized, else 0", _clock(lambda clock: float(clock.is_synchronized))
    ),
    "systemd_failed": HostSource(
        "", "failed units of systemd", _asked("systemd", daemons.failed_units, every_s=10.0)
    ),
    "process_cpu_percent": _process("process_cpu_percent", "%", "CPU time, in % of one core", _REDUCE),
    "process_memory": _process("process_memory", "MB", "resident memory", _REDUCE),
    "process_threads": _process("process_threads", "", "threads", _REDUCE),
    "process_files": _process("process_files", "", "open files and sockets", _REDUCE),
    "process_restarts": _process("process_restarts", "", "starts again since the monitor began"),
    "process_running": _process("process_running", "", "1 while at least one runs, else 0"),
}  # fmt: skip
"""Allowed values of `source` in the section `host` of battery_sensor."""
