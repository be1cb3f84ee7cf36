"""This machine as a source: CPU load, temperature and battery, read with psutil.

psutil is imported when it is first needed. Whatever cannot be read raises SensorError with one line that says what is
missing, and where, and what would help.
"""

from __future__ import annotations

import os
import sys
from typing import Any, Dict, Iterable, List, Mapping, Optional, Tuple

from .source import NotYet, SensorError


class HostCpuUsage:
    """How busy the processors of this machine were since the read before, in %."""

    def __init__(self, core: Optional[int] = None) -> None:
        """Notes where the counters stand, so that the first read has something to compare with.

        Args:
            core: which one, counted from 0; None: all together.
        """
        # psutil.cpu_percent() is not used: it compares with the call before in the same thread, and rospy calls back
        # from others than the one that made the node; its first answer is a meaningless 0.0.
        self._core = core
        self._cores: Optional[int] = None
        self._last: Optional[Dict[str, float]] = None
        self._percent: Optional[float] = None
        try:
            self._last = self._cpu_times()
        except SensorError:
            pass  # the first read will say so

    def read(self, now_s: float) -> float:
        """Returns the load in %; the last one when no time has passed since.

        Raises:
            SensorError: it cannot be read, or nothing has been measured yet.
        """
        times = self._cpu_times()
        last, self._last = self._last, times
        if last is not None:
            # A counter may step back by a tick (iowait does, and a processor that is taken offline).
            spent = {kind: max(0.0, times[kind] - last.get(kind, times[kind])) for kind in times}
            total_s = sum(spent.values())
            if total_s > 0.0:
                self._percent = 100.0 * (total_s - spent.get("idle", 0.0) - spent.get("iowait", 0.0)) / total_s
        if self._percent is None:
            raise NotYet("no CPU load yet: it is measured from one read to the next")
        return self._percent

    def _cpu_times(self) -> Dict[str, float]:
        if self._core is None:
            return _named_times(call_psutil("cpu_times", "CPU times"))
        cores = call_psutil("cpu_times", "CPU times", percpu=True)
        if self._cores is None:
            self._cores = len(cores)
        if self._core >= self._cores:
            raise SensorError(f"this machine has no core {self._core}, the last is {self._cores - 1}")
        if len(cores) != self._cores:  # those that are left move up in the list
            raise SensorError(
                f"{len(cores)} cores run, {self._cores} did at the start: which one is core {self._core}?"
            )
        return _named_times(cores[self._core])


class HostTemperature:
    """A temperature of this machine in degrees C.

    Without a sensor's name: the hottest of the CPU; where the CPU has none, the hottest of all.
    """

    def __init__(self, sensor: str = "") -> None:
        """Reads nothing yet.

        Args:
            sensor: `chip/label` or `chip/number` as `robot-health sources` shows them; empty: see above.
        """
        self._sensor = sensor

    def read(self, now_s: float) -> float:
        """Returns the temperature in degrees C.

        Raises:
            SensorError: there is no sensor, or none with a believable reading.
        """
        chips = call_psutil("sensors_temperatures", "temperatures")
        return self._hottest(chips) if self._sensor == "" else self._one(chips)

    def _hottest(self, chips: Mapping[str, Any]) -> float:
        readings = [(chip, reading.current) for chip, sensors in chips.items() for reading in sensors]
        plausible = [(chip, celsius) for chip, celsius in readings if _is_plausible(celsius)]
        of_cpu = [celsius for chip, celsius in plausible if chip.lower().startswith(_CPU_CHIPS)]
        candidates = of_cpu or [celsius for _, celsius in plausible]
        if candidates:
            return float(max(candidates))
        if readings:
            raise SensorError(
                f"no believable temperature: {_name_readings(readings)}; set the source to simulated or none"
            )
        raise SensorError(
            "this machine shows no temperature sensor in /sys/class/hwmon or /sys/class/thermal (virtual machines and "
            "containers have none); load its driver (sensors-detect), or set the source to simulated or none"
        )

    def _one(self, chips: Mapping[str, Any]) -> float:
        readings = _named_readings(chips)
        if self._sensor not in readings:
            there = ", ".join(temperature_sensors()) or "none"
            raise SensorError(f"this machine shows no temperature sensor {self._sensor}; there are {there}")
        celsius = readings[self._sensor]
        if celsius is None or not _is_plausible(celsius):
            raise SensorError(f"no believable temperature: {self._sensor} shows {celsius}")
        return float(celsius)


def temperature_sensors() -> List[str]:
    """Returns the names of this machine's temperature sensors, those with unbelievable readings included.

    Raises:
        SensorError: they cannot be read.
    """
    names = []
    for chip, sensors in call_psutil("sensors_temperatures", "temperatures").items():
        labels = [reading.label for reading in sensors]
        for number, label in enumerate(labels):
            names.append(f"{chip}/{label if label and labels.count(label) == 1 else number}")
    return names


class HostBattery:
    """The charge of this machine's battery in %."""

    def read(self, now_s: float) -> float:
        """Returns the charge in %.

        Raises:
            SensorError: there is no battery, or its charge cannot be read.
        """
        # A battery that holds more than its nominal charge is full.
        return min(float(read_battery().percent), 100.0)


def read_battery() -> Any:
    """Returns what psutil says of this machine's battery.

    Raises:
        SensorError: there is none, or it cannot be read.
    """
    battery = None if _lacks_battery() else call_psutil("sensors_battery", "batteries")
    if battery is None:
        raise SensorError(
            f"this machine shows no battery of its own in {POWER_SUPPLIES}; "
            "set the source to simulated or none, or publish the robot's battery from its driver"
        )
    return battery


def battery_folder() -> Optional[str]:
    """Returns the folder of the battery that psutil reads, the first by name; None when there is none."""
    try:
        names = sorted(name for name in os.listdir(POWER_SUPPLIES) if name[:3] == "BAT" or "battery" in name.lower())
    except OSError:
        return None  # a kernel without it, on which psutil would stumble
    return os.path.join(POWER_SUPPLIES, names[0]) if names else None


_CPU_CHIPS = ("coretemp", "k10temp", "zenpower", "cpu", "soc_thermal", "soc-thermal", "x86_pkg_temp", "via_cputemp")
"""How the names of chips begin that measure a CPU: Intel, AMD, ARM boards, thermal zones, VIA."""

POWER_SUPPLIES = "/sys/class/power_supply"
"""Where Linux shows batteries and chargers."""


def _is_plausible(celsius: Optional[float]) -> bool:
    """Tells a measurement from a placeholder.

    An unconnected or sleeping sensor shows exactly 0, the least or the greatest number of its register (-128, -62,
    127, 255) or absolute zero; electronics is specified from -55 to 125 degrees C.
    """
    return celsius is not None and celsius != 0.0 and -55.0 <= celsius <= 125.0


def _name_readings(readings: Iterable[Tuple[str, Optional[float]]]) -> str:
    texts = [f"{chip} shows {celsius}" for chip, celsius in readings]
    return ", ".join(texts[:3]) + (" and others" if len(texts) > 3 else "")


def _lacks_battery() -> bool:
    """Tells whether there is nothing for psutil to read, or what it takes (the first by name) powers a gamepad."""
    if not sys.platform.startswith("linux"):
        return False
    folder = battery_folder()
    if folder is None:
        return True
    try:
        with open(os.path.join(folder, "scope"), encoding="ascii") as scope:
            return scope.read().strip() == "Device"
    except (OSError, ValueError):
        return False  # most batteries of the machine itself have no such file


def _named_times(times: Any) -> Dict[str, float]:
    # Linux counts the time of guests within user and nice as well.
    return {kind: seconds for kind, seconds in times._asdict().items() if kind not in ("guest", "guest_nice")}


def _named_readings(chips: Mapping[str, Any]) -> Dict[str, Optional[float]]:
    """Returns every temperature by the names that it can be asked for."""
    readings: Dict[str, Optional[float]] = {}
    for chip, sensors in chips.items():
        for number, reading in enumerate(sensors):
            readings[f"{chip}/{number}"] = reading.current
        for reading in reversed(sensors):  # of those with the same label the first
            if reading.label:
                readings[f"{chip}/{reading.label}"] = reading.current
    return readings


def call_psutil(function: str, what: str, *arguments: Any, **options: Any) -> Any:
    """Calls a function of psutil.

    Args:
        function: its name.
        what: what it reads, for errors.
        arguments: for the function.
        options: for the function.

    Raises:
        SensorError: psutil is not there, does not have it on this system, or could not read.
    """
    try:
        import psutil
    except ImportError:
        raise SensorError(
            "psutil is not installed, which reads this machine: install python3-psutil with apt or psutil with pip"
        ) from None
    if not hasattr(psutil, function):
        raise SensorError(f"psutil reads no {what} on this system; set the source to simulated or none")
    try:
        return getattr(psutil, function)(*arguments, **options)
    except Exception as error:  # whatever a driver's file made psutil stumble over, it costs this reading only
        raise SensorError(f"psutil could not read {what}: {type(error).__name__}: {error}") from error
