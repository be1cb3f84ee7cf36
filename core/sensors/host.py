"""Reads this machine: temperatures and batteries from the kernel's files below /sys, CPU load from /proc.

Formats: the kernel's Documentation/hwmon/sysfs-interface.rst (thousandths of a degree C) and
Documentation/ABI/testing/sysfs-class-power (microvolts, microamperes, microwatts); proc_stat(5). What cannot be read
raises SensorError.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from ..formatting import list_text, printable
from .computer import HOST_PATHS, Computer, HostPaths, read_bytes, read_float, read_text, sorted_paths
from .source import NoSuchSensor, NotMeasuredYet, SensorError

_CPU_CHIPS = ("coretemp", "k10temp", "zenpower", "cpu", "soc_thermal", "soc-thermal", "x86_pkg_temp", "via_cputemp")
"""Prefixes of the names of CPU temperature chips: Intel, AMD, ARM boards, thermal zones, VIA."""

CpuTicks = Tuple[int, ...]
"""Time in user, nice, system, idle, iowait, irq, softirq and steal, in ticks; old kernels end earlier."""

_LEAST_COLUMNS = 5


class HostCpuUsage:
    """CPU load of this machine since the previous read, in %."""

    def __init__(self, computer: Computer, core: Optional[int] = None) -> None:
        """Reads the counters of one core, counted from 0, or of all, so that the first `read` can compare."""
        # Not psutil.cpu_percent(): it compares with the previous call in the same thread, and rospy calls back from
        # other threads than the one that made the node. Its first answer is a meaningless 0.0.
        self._computer = computer
        self._core = core
        self._last: Optional[CpuTicks] = None
        self._percent: Optional[float] = None
        try:
            self._last = self._ticks(read_cpu_ticks(computer.paths))
        except SensorError:
            pass  # the first read reports it

    def read(self, now_s: float) -> float:
        """Returns the load in %; the previous one if no time has passed since. Raises SensorError."""
        ticks = self._ticks(self._computer.once(now_s, read_cpu_ticks))
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

    def _ticks(self, found: Mapping[Optional[int], CpuTicks]) -> CpuTicks:
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


@dataclass(frozen=True)
class HostTemperature:
    """A temperature of this machine in degrees C."""

    sensor: str = ""
    """`chip/label` or `chip/number`, as `robot-health sources` lists them; empty: the hottest sensor of the CPU, or if
    the CPU has none, the hottest of all."""
    paths: HostPaths = HOST_PATHS

    def read(self, now_s: float) -> float:
        """Returns the temperature; raises SensorError if there is no such sensor, or if its reading is implausible."""
        chips = read_temperatures(self.paths)
        return self._one(chips) if self.sensor else self._hottest(chips)

    def _hottest(self, chips: Mapping[str, Sequence[Temperature]]) -> float:
        readings = [(chip, sensor.celsius) for chip, sensors in chips.items() for sensor in sensors]
        plausible = [(chip, celsius) for chip, celsius in readings if _is_plausible(celsius)]
        of_cpu = [celsius for chip, celsius in plausible if chip.lower().startswith(_CPU_CHIPS)]
        candidates = of_cpu or [celsius for _, celsius in plausible]
        if candidates:
            return max(candidates)
        if readings:
            listed = list_text([f"{chip} reads {celsius}" for chip, celsius in readings], most=3)
            raise SensorError(f"no plausible temperature: {listed}; set the source to simulated or none")
        raise NoSuchSensor(
            f"no temperature sensor in {self.paths.sys}/class/hwmon or {self.paths.sys}/class/thermal (virtual "
            "machines and containers have none); load its driver (sensors-detect), or set the source to simulated or "
            "none"
        )

    def _one(self, chips: Mapping[str, Sequence[Temperature]]) -> float:
        celsius = _by_name(chips).get(self.sensor)
        if celsius is None:
            available = ", ".join(temperature_sensors(self.paths)) or "none"
            raise SensorError(f"this machine has no temperature sensor {self.sensor}; available: {available}")
        if not _is_plausible(celsius):
            raise SensorError(f"no plausible temperature: {self.sensor} reads {celsius}")
        return celsius


class Temperature(NamedTuple):
    """One temperature sensor of a chip."""

    label: str
    """Its label, empty if it has none."""
    celsius: float
    """Its reading in degrees C, which may be a placeholder."""


def read_temperatures(paths: HostPaths = HOST_PATHS) -> Dict[str, List[Temperature]]:
    """Returns the temperature sensors of this machine by the name of their chip, or of their thermal zone."""
    chips: Dict[str, List[Temperature]] = {}
    for folder in sorted_paths(f"{paths.sys}/class/hwmon/hwmon*"):
        for chip in (folder, os.path.join(folder, "device")):
            temperatures = _chip_temperatures(chip)
            if temperatures:
                chips.setdefault(_name(chip, "name") or "unknown", []).extend(temperatures)
                break
    if not chips:  # boards such as Jetson have thermal zones only
        for zone in sorted_paths(f"{paths.sys}/class/thermal/thermal_zone*"):
            number = read_float(zone, "temp")
            if number is not None:
                name = _name(zone, "type") or "unknown"
                chips.setdefault(name, []).append(Temperature("", number / 1000.0))
    return chips


def temperature_sensors(paths: HostPaths = HOST_PATHS) -> List[str]:
    """Returns the names of this machine's temperature sensors, those with implausible readings included."""
    names = []
    for chip, sensors in read_temperatures(paths).items():
        labels = [sensor.label for sensor in sensors]
        for number, label in enumerate(labels):
            names.append(f"{chip}/{label if label and labels.count(label) == 1 else number}")
    return names


def read_chips(paths: HostPaths, kind: str) -> Dict[str, float]:
    """Returns the readings of all sensors of a kind (fan, in) by chip/label, or by chip/name without a unique label."""
    found: Dict[str, float] = {}
    for folder in sorted_paths(f"{paths.sys}/class/hwmon/hwmon*"):
        chip = _name(folder, "name") or "unknown"
        for file in sorted_paths(f"{folder}/{kind}[0-9]*_input"):
            number = read_float(file)
            if number is not None:
                sensor = os.path.basename(file)[: -len("_input")]
                name = f"{chip}/{_name(folder, f'{sensor}_label') or sensor}"
                found[name if name not in found else f"{chip}{len(found)}/{sensor}"] = number
    return found


def fan_rpm(readings: Mapping[str, float], sensor: str) -> float:
    """Returns the speed of a fan, without a name that of the fastest: a connector without a fan reads 0."""
    return max(readings.values()) if readings and not sensor else _reading_of("fan", readings, sensor)


def rail_volts(readings: Mapping[str, float], sensor: str) -> float:
    """Returns a voltage, without a name the first, in V."""
    first = next(iter(readings), "")
    return _reading_of("voltage sensor", readings, sensor or first) / 1000.0


def _reading_of(noun: str, readings: Mapping[str, float], sensor: str) -> float:
    if not readings:
        raise NoSuchSensor(f"this machine has no {noun}, or no driver for it")
    if sensor not in readings:
        raise SensorError(f"this machine has no {noun} {sensor}; available: {', '.join(readings)}")
    return readings[sensor]


class Battery:
    """The battery of this machine: the first by name that does not power a device such as a gamepad.

    Each method raises SensorError if its value cannot be read.
    """

    def __init__(self, paths: HostPaths = HOST_PATHS) -> None:
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
            now, full = self._find_number(f"{kind}_now"), self._find_number(f"{kind}_full")
            if now is not None and full:
                return min(100.0 * now / full, 100.0)
        return min(float(self._number("capacity")), 100.0)

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
        current = self._find_number("current_now")
        if current is not None:
            amperes = abs(current) / 1e6
        else:
            volts = self.volts()
            if not volts:
                raise SensorError("the battery of this machine has no current_now, and its voltage is 0")
            amperes = abs(self._number("power_now")) / 1e6 / volts
        return -amperes if read_text(self._folder, "status") == "Discharging" else amperes

    def _number(self, file: str) -> int:
        text = read_text(self._folder, file)
        if text is None:
            raise SensorError(f"the battery of this machine has no {file}")
        try:
            return int(text)
        except ValueError:
            raise SensorError(f"the battery of this machine has no {file}: expected a number, got {text!r}") from None

    def _find_number(self, file: str) -> Optional[int]:
        try:
            return self._number(file)
        except SensorError:
            return None


def _is_plausible(celsius: float) -> bool:
    """Returns False for placeholders.

    An unconnected or sleeping sensor reads exactly 0, the limit of its register (-128, -62, 127, 255) or absolute
    zero. Electronics is specified from -55 to 125 degrees C.
    """
    return celsius != 0.0 and -55.0 <= celsius <= 125.0


def _by_name(chips: Mapping[str, Sequence[Temperature]]) -> Dict[str, float]:
    """Returns the readings by every name of their sensor."""
    readings: Dict[str, float] = {}
    for chip, sensors in chips.items():
        readings.update((f"{chip}/{number}", sensor.celsius) for number, sensor in enumerate(sensors))
        # The first of those with the same label wins.
        readings.update((f"{chip}/{sensor.label}", sensor.celsius) for sensor in reversed(sensors) if sensor.label)
    return readings


def _chip_temperatures(chip: str) -> List[Temperature]:
    names = [os.path.basename(file)[: -len("_input")] for file in sorted_paths(f"{chip}/temp*_input")]
    readings = [(_name(chip, f"{name}_label"), read_float(chip, f"{name}_input")) for name in names]
    return [Temperature(label, number / 1000.0) for label, number in readings if number is not None]


def _name(folder: str, file: str) -> str:
    """Returns the name of a chip or sensor, as it can be shown; empty if it has none."""
    return printable((read_text(folder, file) or "")[:60])
