"""The metrics of this machine that battery_sensor can publish, and how each is read.

    source = HOST_SOURCES["disk_percent"].make(Computer(), path="/")
    source.read(now_s)                      # % used, or SensorError

docs/signals.md is generated from this table, and `robot-health sources` lists it.
"""

from __future__ import annotations

import os
from functools import partial
from operator import itemgetter
from typing import Any, Callable, Iterable, Mapping, NamedTuple, Sequence

from ..config import Parameter
from ..values import JsonObject
from . import daemons, disks, gpu, host, network, operating_system, processes
from .computer import Computer, Growth, HostPaths, HostReading, load_psutil, part
from .source import Source

Options = JsonObject
_NONE: Options = {}


class HostSource(NamedTuple):
    """One kind of metric of a machine."""

    unit: str
    description: str
    make: Callable[..., Source]
    """Creates the source; takes the computer, and the options by their names."""
    options: tuple[Parameter, ...] = ()
    """Select one where a machine may have several, by the first of them."""
    names: Callable[[HostPaths], Iterable[Any]] = lambda paths: ()
    """Returns the values of the first option that this machine has; raises SensorError if they cannot be read."""
    example: Options = _NONE
    """Keys of which at least one must be given, with what is shown where `names` lists none."""


def _asked(
    subject: str, read: Callable[..., Any], value: Any = float, every_s: float = 0.0, kind: Any = HostReading
) -> Callable[..., Source]:
    """Returns what makes a source of what `read` returns, which gets the paths and the options.

    Sources with the same `read` and the same options share what it returns. `kind` is `HostReading`, which calls
    `value` with that, or `Growth`, which does with its growth.
    """

    def make(computer: Computer, **options: Any) -> Source:
        source: Source = kind(lambda now_s: computer.ask(now_s, every_s, subject, read, *options.values()), value)
        return source

    return make


def _pressure(resource: str) -> Callable[..., Source]:
    return _asked("the pressure", lambda paths: operating_system.pressure_percent(paths, resource))


def _nodes(paths: HostPaths) -> Iterable[str]:
    return processes.Processes().scan(paths).nodes()[:50]


_LOAD = partial(_asked, "the load", lambda paths: os.getloadavg())
_BATTERY = partial(_asked, "the battery")
_GPU = partial(_asked, "the graphics processor", gpu.read_gpu)
_SPACE = partial(_asked, "the disk", disks.read_space, every_s=5.0)
_CLOCK = partial(_asked, "the time daemon", daemons.read_clock, every_s=5.0)
_COMMAND = {"command": "*/amcl *", "node": ""}
_MEMORY = partial(_asked, "the memory", lambda paths: load_psutil(paths).virtual_memory())
_SWAP = _asked("the swap", lambda paths: load_psutil(paths).swap_memory(), operating_system.swap_percent)
_REDUCE = Parameter("reduce", str, "sum", "of several processes", choices=tuple(processes.REDUCTIONS))


def _process(metric: str, unit: str, description: str, *options: Parameter) -> tuple[Any, ...]:
    selecting = (
        Parameter("node", str, "", "name of a ROS node: of __node:= or __name:=, or the executable"),
        Parameter("command", str, "", "pattern of the whole command line, with * and ?"),
    )
    make = partial(processes.make_source, metric)
    return metric, unit, description, make, (*selecting, *options), _nodes, _COMMAND


def _traffic(counters: slice, scale: float = 1.0) -> Callable[..., Source]:
    return _asked("the network", network.read_counters, network.rate(counters, scale), kind=Growth)


_OF_CORE = Parameter("core", int, None, "core, counted from 0; left out: all cores together", 0, 65535)
_ON_DISK = (Parameter("path", str, "/", "mount point of the disk"),), disks.mount_points
_OF_DISK = (Parameter("device", str, "", "disk, such as sda; left out: the slowest"),), disks.read_requests
_OF_GPU = (Parameter("device", int, 0, "number of the graphics processor", 0, 63),), gpu.gpus


def _sensor(kind: str, description: str) -> Any:
    return (Parameter("sensor", str, "", description),), lambda paths: ["", *host.find_sensors(paths, kind)]


def _interface(description: str, names: Callable[[HostPaths], Iterable[str]] = network.read_counters) -> Any:
    return (Parameter("interface", str, "", description),), names


_OF_INTERFACE = _interface("network interface; left out: all together")
_OF_WIFI = _interface("Wi-Fi interface; left out: the first", network.wifi_signals)

_TABLE: Sequence[tuple[Any, ...]] = (
    (
        "cpu_percent", "%", "CPU load", _asked("the CPU", host.core_ticks, host.busy_percent, kind=Growth),
        (_OF_CORE,), host.read_cpu_ticks,
    ),
    ("load_1min", "", "load average over 1 minute", _LOAD(itemgetter(0))),
    ("load_5min", "", "load average over 5 minutes", _LOAD(itemgetter(1))),
    ("load_15min", "", "load average over 15 minutes", _LOAD(itemgetter(2))),
    ("memory_percent", "%", "memory in use", _MEMORY(operating_system.memory_percent)),
    (
        "memory_available", "MB", "memory available to programs", _MEMORY(lambda memory: memory.available * 1e-6)
    ),
    ("swap_percent", "%", "swap in use", _SWAP),
    (
        "pressure_cpu", "%", "share of the last 10 s in which a process waited for the CPU",
        _pressure("cpu"),
    ),
    (
        "pressure_memory", "%", "share of the last 10 s in which a process waited for memory",
        _pressure("memory"),
    ),
    (
        "pressure_io", "%", "share of the last 10 s in which a process waited for a disk",
        _pressure("io"),
    ),
    (
        "oom_kills", "", "processes that were killed since the start because memory was used up",
        _asked("the kernel", operating_system.oom_kills),
    ),
    ("disk_percent", "%", "disk in use", _SPACE(part("disk_percent")), *_ON_DISK),
    ("disk_free", "GB", "free disk space", _SPACE(part("disk_free")), *_ON_DISK),
    ("disk_inodes_percent", "%", "inodes in use: files and folders", _SPACE(part("disk_inodes_percent")), *_ON_DISK),
    (
        "disk_read_only", "", "1 while the disk cannot be written, else 0",
        _SPACE(part("disk_read_only")), *_ON_DISK
    ),
    (
        "disk_latency_ms", "ms", "mean time of a request of the disk",
        _asked("the disks", disks.read_requests, disks.latency_ms, kind=Growth), *_OF_DISK,
    ),
    (
        "temperature", "degC", "temperature", _asked("the temperature sensor", host.temperature),
        *_sensor("temp", "sensor, as chip/label or chip/number; left out: the hottest of the CPU"),
    ),
    (
        "fan_rpm", "rpm", "speed of a fan",
        _asked("the fan", host.fan_rpm), *_sensor("fan", "fan, as chip/label or chip/fan1; left out: the fastest"),
    ),
    (
        "voltage_rail", "V", "voltage of a supply", _asked("the voltage sensor", host.rail_volts),
        *_sensor("in", "voltage, as chip/label or chip/in1; left out: the first"),
    ),
    (
        "throttled", "", "1 while a Raspberry Pi is slowed down by its supply or temperature, else 0",
        _asked("the firmware", operating_system.throttled),
    ),
    ("gpu_percent", "%", "load of the graphics processor", _GPU(part("gpu_percent")), *_OF_GPU),
    (
        "gpu_memory_percent", "%", "memory of the graphics processor in use", _GPU(part("gpu_memory_percent")), *_OF_GPU
    ),
    ("gpu_temperature", "degC", "temperature of the graphics processor", _GPU(part("gpu_temperature")), *_OF_GPU),
    ("battery_percent", "%", "battery charge", _BATTERY(host.battery_percent)),
    ("battery_plugged", "", "1 while the charger is connected, else 0", _BATTERY(host.battery_plugged)),
    ("battery_voltage", "V", "battery voltage", _BATTERY(host.battery_volts)),
    ("battery_current", "A", "battery current, negative when discharging", _BATTERY(host.battery_amperes)),
    ("network_receive", "MB/s", "data received", _traffic(network.RECEIVED, 1e-6), *_OF_INTERFACE),
    ("network_send", "MB/s", "data sent", _traffic(network.SENT, 1e-6), *_OF_INTERFACE),
    ("network_errors", "1/s", "packets with errors", _traffic(network.ERRORS), *_OF_INTERFACE),
    ("network_drops", "1/s", "dropped packets", _traffic(network.DROPS), *_OF_INTERFACE),
    (
        "network_carrier", "", "1 while there is a carrier (cable connected, Wi-Fi associated), else 0",
        _asked("the network", network.carrier), *_interface("network interface; left out: any"),
    ),
    ("wifi_signal", "dBm", "signal of the Wi-Fi", _asked("the Wi-Fi", network.signal_dbm), *_OF_WIFI),
    ("wifi_bitrate", "Mbit/s", "bit rate of the Wi-Fi", _asked("the Wi-Fi", network.bitrate), *_OF_WIFI),
    (
        "can_errors", "1/s", "errors of a CAN bus",
        _asked("the network", network.read_can_counters, network.rate(network.ERRORS), kind=Growth),
        *_interface("CAN interface; left out: all together", network.can_interfaces),
    ),
    (
        "clock_offset_ms", "ms", "time of the servers minus that of this clock (chrony, systemd-timesyncd)",
        _CLOCK(part("clock_offset_ms")),
    ),
    (
        "clock_synchronized", "", "1 while the clock is synchronized, else 0",
        _CLOCK(part("clock_synchronized"))
    ),
    (
        "systemd_failed", "", "failed units of systemd", _asked("systemd", daemons.failed_units, every_s=10.0)
    ),
    _process("process_cpu_percent", "%", "CPU time, in % of one core", _REDUCE),
    _process("process_memory", "MB", "resident memory", _REDUCE),
    _process("process_threads", "", "threads", _REDUCE),
    _process("process_files", "", "open files and sockets", _REDUCE),
    _process("process_restarts", "", "starts again since the monitor began"),
    _process("process_running", "", "1 while at least one runs, else 0"),
)  # fmt: skip
"""Name, unit, description, what makes the source, and what selects one where a machine may have several."""

HOST_SOURCES: Mapping[str, HostSource] = {name: HostSource(*row) for name, *row in _TABLE}
"""Allowed values of `source` in the section `host` of battery_sensor."""
