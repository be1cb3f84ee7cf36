"""This machine as a source: CPU load, temperature and battery, read with psutil.

psutil is imported when it is first needed. Whatever cannot be read raises SensorError with one line that says what is
missing, and where, and what would help.
"""

from __future__ import annotations

import os
import sys
from typing import Any, Dict, Iterable, Optional, Tuple


class SensorError(Exception):
    """A sensor that cannot be read now. `str()` is one line: what, where, what would help."""


class HostCpuUsage:
    """How busy all processors of this machine were since the read before, in %."""

    def __init__(self) -> None:
        """Notes where the counters stand, so that the first read has something to compare with."""
        # psutil.cpu_percent() is not used: it compares with the call before in the same thread, and rospy calls back
        # from others than the one that made the node; its first answer is a meaningless 0.0.
        self._last: Optional[Dict[str, float]] = None
        self._percent: Optional[float] = None
        try:
            self._last = _cpu_times()
        except SensorError:
            pass  # the first read will say so

    def read(self, now_s: float) -> float:
        """Returns the load in %; the last one when no time has passed since.

        Raises:
            SensorError: it cannot be read, or nothing has been measured yet.
        """
        times = _cpu_times()
        last, self._last = self._last, times
        if last is not None:
            # A counter may step back by a tick (iowait does, and a processor that is taken offline).
            spent = {kind: max(0.0, times[kind] - last.get(kind, times[kind])) for kind in times}
            total_s = sum(spent.values())
            if total_s > 0.0:
                self._percent = 100.0 * (total_s - spent.get("idle", 0.0) - spent.get("iowait", 0.0)) / total_s
        if self._percent is None:
            raise SensorError("no CPU load yet: it is measured from one read to the next")
        return self._percent


class HostTemperature:
    """The hottest CPU temperature of this machine in degrees C; where the CPU has none, the hottest of all."""

    def read(self, now_s: float) -> float:
        """Returns the temperature in degrees C.

        Raises:
            SensorError: there is no sensor, or none with a believable reading.
        """
        chips = _call_psutil("sensors_temperatures", "temperatures")
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


class HostBattery:
    """The charge of this machine's battery in %."""

    def read(self, now_s: float) -> float:
        """Returns the charge in %.

        Raises:
            SensorError: there is no battery, or its charge cannot be read.
        """
        battery = None if _lacks_battery() else _call_psutil("sensors_battery", "batteries")
        if battery is None:
            raise SensorError(
                f"this machine shows no battery of its own in {_POWER_SUPPLIES}; "
                "set the source to simulated or none, or publish the robot's battery from its driver"
            )
        # A battery that holds more than its nominal charge is full.
        return min(float(battery.percent), 100.0)


_CPU_CHIPS = ("coretemp", "k10temp", "zenpower", "cpu", "soc_thermal", "soc-thermal", "x86_pkg_temp", "via_cputemp")
"""How the names of chips begin that measure a CPU: Intel, AMD, ARM boards, thermal zones, VIA."""

_POWER_SUPPLIES = "/sys/class/power_supply"


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
    try:
        batteries = sorted(
            name for name in os.listdir(_POWER_SUPPLIES) if name[:3] == "BAT" or "battery" in name.lower()
        )
    except OSError:
        return True  # a kernel without this folder, on which psutil would stumble
    try:
        with open(os.path.join(_POWER_SUPPLIES, batteries[0], "scope"), encoding="ascii") as scope:
            return scope.read().strip() == "Device"
    except (OSError, ValueError, IndexError):
        return not batteries  # most batteries of the machine itself have no such file


def _cpu_times() -> Dict[str, float]:
    times: Dict[str, float] = _call_psutil("cpu_times", "CPU times")._asdict()
    # Linux counts the time of guests within user and nice as well.
    return {kind: seconds for kind, seconds in times.items() if kind not in ("guest", "guest_nice")}


def _call_psutil(function: str, what: str) -> Any:
    """Calls a function of psutil.

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
        return getattr(psutil, function)()
    except Exception as error:  # whatever a driver's file made psutil stumble over, it costs this reading only
        raise SensorError(f"psutil could not read {what}: {type(error).__name__}: {error}") from error
