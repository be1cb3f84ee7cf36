"""Reads this machine: temperatures, fans, voltages and batteries from files below /sys, CPU load from /proc.

Formats: the kernel's Documentation/hwmon/sysfs-interface.rst (thousandths of a degree C) and
Documentation/ABI/testing/sysfs-class-power (microvolts, microamperes, microwatts); proc_stat(5). What cannot be read
raises SensorError. A driver may hang in each of these files: they are read with `Computer.ask`, and a sensor that is
named is read without the others. psutil reads all sensors at once, has no voltages, and counts the cores that are
online instead of naming them.
"""

from __future__ import annotations

import math
import os
from typing import Dict, List, NamedTuple, Optional, Tuple

from ..values.formatting import list_text, printable
from .computer import Computer, HostPaths, read_bytes, read_float, read_text, sorted_paths
from .source import NoSuchSensor, NotMeasuredYet, SensorError

_CPU_CHIPS = ("coretemp", "k10temp", "zenpower", "cpu", "soc_thermal", "soc-thermal", "x86_pkg_temp", "via_cputemp")
"""Prefixes of the names of CPU temperature chips: Intel, AMD, ARM boards, thermal zones, VIA."""

CpuTicks = Tuple[int, ...]
"""Time in user, nice, system, idle, iowait, irq, softirq and steal, in ticks; old kernels end earlier."""

_LEAST_COLUMNS = 5


class HostCpuUsage:
    """CPU load of this machine since the previous read, in %."""

    def __init__(self, computer: Computer, core: Optional[int] = None) -> None:
        """Measures one core, counted from 0, or all of them together."""
        self._computer = computer
        self._core = core
        self._last: Optional[CpuTicks] = None
        self._percent: Optional[float] = None
        try:
            self._last = self._ticks(-math.inf)  # so that the first read can compare
        except SensorError:
            pass  # the first read reports it

    def read(self, now_s: float) -> float:
        """Returns the load in %; the previous one if no time has passed since. Raises SensorError."""
        ticks = self._ticks(now_s)
        last, self._last = self._last, ticks
        if last is not None:
            # A counter may step back: iowait does, and so do those of a core that goes offline.
            user, nice, system, idle, iowait, *others = [max(0, new - old) for new, old in zip(ticks, last)]
            busy = user + nice + system + sum(others)
            if busy + idle + iowait:
                self._percent = 100.0 * busy / (busy + idle + iowait)
        if self._percent is None:
            raise NotMeasuredYet("CPU load is not measured yet: it takes two reads")
        return self._percent

    def _ticks(self, now_s: float) -> CpuTicks:
        found = self._computer.ask(now_s, 0.0, "the CPU", read_cpu_ticks)
        if self._core not in found:
            online = list_text([str(core) for core in found if core is not None], most=12)
            raise SensorError(f"core {self._core} is not online; online: {online}")
        return found[self._core]


def read_cpu_ticks(paths: HostPaths) -> Dict[Optional[int], CpuTicks]:
    """Returns the ticks of each core that is online, and of all together (None), as proc_stat(5) has them."""
    file = os.path.join(paths.proc, "stat")
    found: Dict[Optional[int], CpuTicks] = {}
    try:
        for line in read_bytes(file).splitlines():
            if not line.startswith(b"cpu"):
                break  # the lines of the cores come first
            name, *columns = line.split()
            # The time of guests, in the columns behind these, is part of user and nice.
            found[int(name[3:]) if name[3:] else None] = tuple(map(int, columns[:8]))
    except OSError as error:
        raise SensorError(f"the CPU load cannot be read: {error}") from None
    except ValueError:
        found = {}
    if any(len(ticks) < _LEAST_COLUMNS for ticks in found.values()) or None not in found:
        raise SensorError(f"{file}: expected the ticks of each core")
    return found


class ChipSensor(NamedTuple):
    """One sensor of a chip, or a thermal zone."""

    chip: str
    names: Tuple[str, ...]
    """Its names, the best one first: chip/label, chip/fan1 (temperatures do not have it), chip/number."""
    path: str
    """Where its reading is."""


def find_sensors(paths: HostPaths, kind: str) -> List[ChipSensor]:
    """Returns the sensors of a kind (temp, fan, in). Reads no value."""
    found: List[ChipSensor] = []

    def add(chip: str, path: str, *names: str) -> None:
        number = sum(each.chip == chip for each in found)
        found.append(ChipSensor(chip, tuple(f"{chip}/{name}" for name in (*filter(None, names), number)), path))

    for folder in sorted_paths(f"{paths.sys}/class/hwmon/hwmon*"):
        for chip in (folder, os.path.join(folder, "device")):
            inputs = sorted_paths(f"{chip}/{kind}[0-9]*_input")
            for path in inputs:
                file = os.path.basename(path)[: -len("_input")]
                add(_name(chip, "name"), path, _name(chip, f"{file}_label", ""), "" if kind == "temp" else file)
            if inputs:
                break
    if kind == "temp" and not found:  # boards such as Jetson have thermal zones only
        for zone in sorted_paths(f"{paths.sys}/class/thermal/thermal_zone*"):
            add(_name(zone, "type"), f"{zone}/temp")
    return found


def sensor_names(paths: HostPaths, kind: str) -> List[str]:
    """Returns the best name of each sensor of a kind that is not also the name of another one."""
    sensors = find_sensors(paths, kind)
    names = [name for each in sensors for name in each.names]
    return [next((name for name in each.names if names.count(name) == 1), each.names[-1]) for each in sensors]


def _read_one(paths: HostPaths, kind: str, noun: str, sensor: str) -> float:
    """Returns the reading of the sensor with a name, and reads no other."""
    sensors = find_sensors(paths, kind)
    paths_found = [each.path for rank in range(3) for each in sensors if sensor in each.names[rank : rank + 1]]
    if not paths_found:
        available = ", ".join(sensor_names(paths, kind)) or "none"
        raise SensorError(f"this machine has no {noun} {sensor}; available: {available}")
    number = read_float(paths_found[0])
    if number is None:
        raise SensorError(f"{sensor} cannot be read: {paths_found[0]} has no number")
    return number


def temperature(paths: HostPaths, sensor: str = "") -> float:
    """Returns a temperature in degrees C; without a name the hottest of the CPU or, if it has none, of all.

    Raises SensorError if there is no such sensor, or if its reading is implausible.
    """
    if sensor:
        celsius = _read_one(paths, "temp", "temperature sensor", sensor) / 1000.0
        if not _is_plausible(celsius):
            raise SensorError(f"no plausible temperature: {sensor} reads {celsius}")
        return celsius
    readings: List[Tuple[str, float]] = []
    # A chip that is none of the CPU is not even read if one of the CPU answers.
    for of_cpu in (True, False):
        for each in find_sensors(paths, "temp"):
            number = read_float(each.path) if each.chip.lower().startswith(_CPU_CHIPS) is of_cpu else None
            if number is not None:
                readings.append((each.chip, number / 1000.0))
        plausible = [celsius for _, celsius in readings if _is_plausible(celsius)]
        if plausible:
            return max(plausible)
    if readings:
        listed = list_text([f"{chip} reads {celsius}" for chip, celsius in readings], most=3)
        raise SensorError(f"no plausible temperature: {listed}; set the source to simulated or none")
    raise NoSuchSensor(
        f"no temperature sensor in {paths.sys}/class/hwmon or {paths.sys}/class/thermal (virtual machines and "
        "containers have none); load its driver (sensors-detect), or set the source to simulated or none"
    )


def fan_rpm(paths: HostPaths, sensor: str) -> float:
    """Returns the speed of a fan, without a name that of the fastest: a connector without a fan reads 0."""
    return max(_read_all(paths, "fan", "fan", sensor))


def rail_volts(paths: HostPaths, sensor: str) -> float:
    """Returns a voltage, without a name the first, in V."""
    return _read_all(paths, "in", "voltage sensor", sensor)[0] / 1000.0


def _read_all(paths: HostPaths, kind: str, noun: str, sensor: str) -> List[float]:
    """Returns the readings of all sensors of a kind, of at least one; only that of `sensor` if there is a name."""
    sensors = find_sensors(paths, kind)
    if sensor and sensors:
        return [_read_one(paths, kind, noun, sensor)]
    numbers = [read_float(each.path) for each in sensors]
    found = [number for number in numbers if number is not None]
    if not found:
        raise NoSuchSensor(f"this machine has no {noun}, or no driver for it")
    return found


def _is_plausible(celsius: float) -> bool:
    """Returns False for placeholders.

    An unconnected or sleeping sensor reads exactly 0, the limit of its register (-128, -62, 127, 255) or absolute
    zero. Electronics is specified from -55 to 125 degrees C.
    """
    return celsius != 0.0 and -55.0 <= celsius <= 125.0


def _name(folder: str, file: str, missing: str = "unknown") -> str:
    """Returns the name of a chip or sensor, as it can be shown; `missing` if it has none."""
    return printable((read_text(folder, file) or "")[:60]) or missing


class Battery:
    """The battery of this machine: the first by name that does not power a device such as a gamepad.

    Each method reads only the files that it needs, and raises SensorError if its value cannot be read.
    """

    def __init__(self, paths: HostPaths) -> None:
        """Finds the battery; raises NoSuchSensor if there is none."""
        supplies = os.path.join(paths.sys, "class", "power_supply")
        self._supplies = sorted_paths(f"{supplies}/*")
        for folder in self._supplies:
            name = os.path.basename(folder)
            is_battery = name.startswith("BAT") or "battery" in name.lower()
            if is_battery and read_text(folder, "scope") != "Device":
                self._folder = folder
                return
        remedy = "set the source to simulated or none, or publish the battery of the robot from its driver"
        raise NoSuchSensor(f"no battery in {supplies}; {remedy}")

    def percent(self) -> float:
        """Returns the charge in %, at most 100: a new battery may hold more than its nominal charge."""
        for kind in ("energy", "charge"):
            now, full = (read_float(self._folder, f"{kind}_{each}") for each in ("now", "full"))
            if now is not None and full:
                return min(100.0 * now / full, 100.0)
        return min(self._number("capacity"), 100.0)

    def is_plugged(self) -> bool:
        """Returns whether a charger is connected."""
        for supply in self._supplies:
            online = read_text(supply, "online")
            if online in ("0", "1") and read_text(supply, "type") in ("Mains", None):
                return online == "1"
        status = (read_text(self._folder, "status") or "").lower()
        if status not in ("charging", "discharging", "full"):
            raise SensorError("this machine does not report whether its charger is connected")
        return status != "discharging"

    def volts(self) -> float:
        """Returns the voltage in V."""
        return self._number("voltage_now") / 1e6

    def amperes(self) -> float:
        """Returns the current in A, negative when discharging as in sensor_msgs/BatteryState."""
        current = read_float(self._folder, "current_now")
        if current is not None:
            amperes = abs(current) / 1e6
        else:
            volts = self.volts()
            if not volts:
                raise SensorError("the battery of this machine has no current_now, and its voltage is 0")
            amperes = abs(self._number("power_now")) / 1e6 / volts
        return -amperes if read_text(self._folder, "status") == "Discharging" else amperes

    def _number(self, file: str) -> float:
        text = read_text(self._folder, file)
        try:
            return float(int(text or ""))
        except ValueError:
            expected = "" if text is None else f": expected a number, got {text!r}"
            raise SensorError(f"the battery of this machine has no {file}{expected}") from None
