"""Reads this machine: temperatures, fans, voltages and batteries from files below /sys, CPU load from /proc.

Formats: the kernel's Documentation/hwmon/sysfs-interface.rst (thousandths of a degree C) and
Documentation/ABI/testing/sysfs-class-power (microvolts, microamperes, microwatts); proc_stat(5). What cannot be read
raises SensorError. A driver may hang in each of these files: they are read with `Computer.ask`, and a sensor that is
named is read without the others. psutil reads all sensors at once, has no voltages, and counts the cores that are
online instead of naming them.
"""

from __future__ import annotations

import os
from typing import Counter, Mapping, Tuple

from ..values import list_text, printable
from .computer import HostPaths, chosen, read_bytes, read_float, read_text, sorted_paths
from .source import NoSuchSensor, SensorError

_CPU_CHIPS = ("coretemp", "k10temp", "zenpower", "cpu", "soc_thermal", "soc-thermal", "x86_pkg_temp", "via_cputemp")
"""Prefixes of the names of CPU temperature chips: Intel, AMD, ARM boards, thermal zones, VIA."""

CpuTicks = Tuple[int, int, int]
"""Ticks that were busy, idle, and waiting for a disk, which may step back."""


def read_cpu_ticks(paths: HostPaths) -> dict[int | None, CpuTicks]:
    """Returns the ticks of each core that is online, and of all together (None), as proc_stat(5) has them."""
    ticks: dict[int | None, CpuTicks] = {}
    for line in read_bytes(f"{paths.proc}/stat").splitlines():
        if not line.startswith(b"cpu"):
            break  # the lines of the cores come first
        name, *columns = line.split()
        # Irq, softirq and steal follow. The time of guests, in the columns behind these, is part of user and nice.
        user, nice, system, idle, iowait, *others = map(int, columns[:8])
        ticks[int(name[3:]) if name[3:] else None] = (user + nice + system + sum(others), idle, iowait)
    return ticks


def core_ticks(paths: HostPaths, core: int | None = None) -> dict[int | None, CpuTicks]:
    """Returns the ticks of a core that is online, without a number those of all together."""
    return chosen(read_cpu_ticks(paths), "core", core, [None])


def busy_percent(grown: list[list[float]], elapsed_s: float) -> float | None:
    """Returns the load in % of the growth of ticks; None if there is no tick."""
    ((busy, idle, iowait),) = grown
    return 100.0 * busy / (busy + idle + iowait) if busy + idle + iowait else None


def find_sensors(paths: HostPaths, kind: str) -> dict[str, str]:
    """Returns where the reading of each sensor of a kind (temp, fan, in) is, by its name. Reads no value.

    The name is chip/label; without a label that no other sensor has chip/fan1 or chip/in1 or, of a temperature,
    chip/number: the sensors of chips of this name are counted from 0. Boards such as Jetson have thermal zones only.
    """
    sensors: dict[str, str] = {}
    numbers: Counter[str] = Counter()

    def add(chip: str, label: str, path: str) -> None:
        name = f"{chip}/{label}"
        sensors.setdefault(name if label and name not in sensors else f"{chip}/{numbers[chip]}", path)
        numbers[chip] += 1

    for folder in sorted_paths(f"{paths.sys}/class/hwmon/hwmon*"):
        for chip in (folder, os.path.join(folder, "device")):
            inputs = sorted_paths(f"{chip}/{kind}[0-9]*_input")
            for path in inputs:
                file = os.path.basename(path)[: -len("_input")]
                add(_name(chip, "name"), _name(chip, f"{file}_label", "" if kind == "temp" else file), path)
            if inputs:
                break
    if kind == "temp" and not sensors:
        for zone in sorted_paths(f"{paths.sys}/class/thermal/thermal_zone*"):
            add(_name(zone, "type"), "", f"{zone}/temp")
    return sensors


def _sensors(paths: HostPaths, kind: str, noun: str, sensor: str) -> dict[str, str]:
    """Returns the sensors of a kind; only the one with a name, if it is given, so that no other is read."""
    sensors = find_sensors(paths, kind)
    if not sensors:
        raise NoSuchSensor(f"this machine has no {noun}, or no driver for it; set the source to simulated or none")
    return chosen(sensors, noun, sensor, sensors)


def _read(sensors: Mapping[str, str]) -> dict[str, float]:
    """Returns the numbers of the sensors that have one."""
    numbers = {name: read_float(path) for name, path in sensors.items()}
    return {name: number for name, number in numbers.items() if number is not None}


def temperature(paths: HostPaths, sensor: str = "") -> float:
    """Returns a temperature in degrees C; without a name the hottest of the CPU or, if it has none, of all.

    Raises SensorError if there is no such sensor, or if its reading is implausible.
    """
    sensors = _sensors(paths, "temp", "temperature sensor", sensor)
    # A chip that is none of the CPU is not even read if one of the CPU answers.
    for group in ({name: path for name, path in sensors.items() if name.lower().startswith(_CPU_CHIPS)}, sensors):
        readings = {name: number / 1000.0 for name, number in _read(group).items()}
        plausible = [celsius for celsius in readings.values() if _is_plausible(celsius)]
        if plausible:
            return max(plausible)
    listed = list_text([f"{name} reads {readings.get(name, 'no number')}" for name in sensors], most=3)
    raise SensorError(f"no plausible temperature: {listed}; set the source to simulated or none")


def fan_rpm(paths: HostPaths, sensor: str = "") -> float:
    """Returns the speed of a fan, without a name that of the fastest: a connector without a fan reads 0."""
    return max(_read_some(paths, "fan", "fan", sensor))


def rail_volts(paths: HostPaths, sensor: str = "") -> float:
    """Returns a voltage, without a name the first, in V."""
    return _read_some(paths, "in", "voltage sensor", sensor)[0] / 1000.0


def _read_some(paths: HostPaths, kind: str, noun: str, sensor: str) -> list[float]:
    """Returns the readings of all sensors of a kind, of at least one; only that of `sensor` if there is a name."""
    readings = _read(_sensors(paths, kind, noun, sensor))
    if not readings:
        raise (SensorError if sensor else NoSuchSensor)(f"no {noun} has a number")
    return [*readings.values()]


def _is_plausible(celsius: float) -> bool:
    """Returns False for placeholders.

    An unconnected or sleeping sensor reads exactly 0, the limit of its register (-128, -62, 127, 255) or absolute
    zero. Electronics is specified from -55 to 125 degrees C.
    """
    return celsius != 0.0 and -55.0 <= celsius <= 125.0


def _name(folder: str, file: str, missing: str = "unknown") -> str:
    """Returns the name of a chip or sensor, as it can be shown; `missing` if it has none."""
    return printable((read_text(folder, file) or "")[:60]) or missing


def _battery(paths: HostPaths) -> str:
    """Returns the folder of the battery of this machine: the first by name that does not power a device."""
    supplies = os.path.join(paths.sys, "class", "power_supply")
    for folder in sorted_paths(f"{supplies}/*"):
        name = os.path.basename(folder)
        if (name.startswith("BAT") or "battery" in name.lower()) and read_text(folder, "scope") != "Device":
            return folder
    remedy = "set the source to simulated or none, or publish the battery of the robot from its driver"
    raise NoSuchSensor(f"no battery in {supplies}; {remedy}")


def battery_percent(paths: HostPaths) -> float:
    """Returns the charge in %, at most 100: a new battery may hold more than its nominal charge."""
    battery = _battery(paths)
    for kind in ("energy", "charge"):
        now, full = (read_float(battery, f"{kind}_{each}") for each in ("now", "full"))
        if now is not None and full:
            return min(100.0 * now / full, 100.0)
    return min(_number(battery, "capacity"), 100.0)


def battery_plugged(paths: HostPaths) -> float:
    """Returns 1 if a charger is connected, else 0."""
    battery = _battery(paths)
    for supply in sorted_paths(f"{os.path.dirname(battery)}/*"):
        online = read_text(supply, "online")
        if online in ("0", "1") and read_text(supply, "type") in ("Mains", None):
            return float(online)
    status = (read_text(battery, "status") or "").lower()
    if status not in ("charging", "discharging", "full"):
        raise SensorError("this machine does not report whether its charger is connected")
    return float(status != "discharging")


def battery_volts(paths: HostPaths) -> float:
    """Returns the voltage in V."""
    return _number(_battery(paths), "voltage_now") / 1e6


def battery_amperes(paths: HostPaths) -> float:
    """Returns the current in A, negative when discharging as in sensor_msgs/BatteryState."""
    battery = _battery(paths)
    current = read_float(battery, "current_now")
    if current is None:
        volts = battery_volts(paths)
        if not volts:
            raise SensorError("the battery of this machine has no current_now, and its voltage is 0")
        current = _number(battery, "power_now") / volts
    return (-1e-6 if read_text(battery, "status") == "Discharging" else 1e-6) * abs(current)


def _number(battery: str, file: str) -> float:
    number = read_float(battery, file)
    if number is None:
        raise SensorError(f"the battery of this machine has no {file}")
    return number
