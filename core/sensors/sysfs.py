"""Reads temperature sensors and batteries from the kernel's files below /sys.

Formats: the kernel's Documentation/hwmon/sysfs-interface.rst (thousandths of a degree C) and
Documentation/ABI/testing/sysfs-class-power (microvolts, microamperes, microwatts).
"""

from __future__ import annotations

import glob
import os
import re
from typing import Dict, List, NamedTuple, Optional, Tuple

from .source import NoSuchSensor, SensorError


class HostPaths(NamedTuple):
    """Where the kernel's files are. Tests pass folders with the files of other machines."""

    proc: str = "/proc"
    sys: str = "/sys"


HOST_PATHS = HostPaths()
"""The files of this machine."""


class Temperature(NamedTuple):
    """One temperature sensor of a chip."""

    label: str
    """Its label, empty if it has none."""
    celsius: float
    """Its reading in degrees C, which may be a placeholder."""


def read_temperatures(paths: HostPaths = HOST_PATHS) -> Dict[str, List[Temperature]]:
    """Returns the temperature sensors of this machine by the name of their chip, or of their thermal zone."""
    chips: Dict[str, List[Temperature]] = {}
    for folder in _sorted(f"{paths.sys}/class/hwmon/hwmon*"):
        for chip in (folder, os.path.join(folder, "device")):
            temperatures = _chip_temperatures(chip)
            if temperatures:
                chips.setdefault(_text(os.path.join(chip, "name")) or "unknown", []).extend(temperatures)
                break
    if not chips:  # boards such as Jetson have thermal zones only
        for zone in _sorted(f"{paths.sys}/class/thermal/thermal_zone*"):
            celsius = _thousandths(os.path.join(zone, "temp"))
            if celsius is not None:
                chips.setdefault(_text(os.path.join(zone, "type")) or "unknown", []).append(Temperature("", celsius))
    return chips


class Battery:
    """The battery of this machine: the first by name that does not power a device such as a gamepad."""

    def __init__(self, paths: HostPaths = HOST_PATHS) -> None:
        """Finds the battery.

        Raises:
            NoSuchSensor: there is none.
        """
        self._supplies = os.path.join(paths.sys, "class", "power_supply")
        folder = self._find()
        if folder is None:
            raise NoSuchSensor(
                f"no battery in {self._supplies}; set the source to simulated or none, or publish the battery of the "
                "robot from its driver"
            )
        self._folder = folder

    def percent(self) -> float:
        """Returns the charge in %, at most 100: a new battery may hold more than its nominal charge.

        Raises:
            SensorError: it cannot be read.
        """
        for kind in ("energy", "charge"):
            now, full = self._find_number(f"{kind}_now"), self._find_number(f"{kind}_full")
            if now is not None and full:
                return min(100.0 * now / full, 100.0)
        return min(float(self._number("capacity")), 100.0)

    def is_plugged(self) -> bool:
        """Returns whether a charger is connected.

        Raises:
            SensorError: it cannot be read.
        """
        for supply in _sorted(f"{self._supplies}/*"):
            online = _text(os.path.join(supply, "online"))
            if online in ("0", "1") and _text(os.path.join(supply, "type")) in ("Mains", None):
                return online == "1"
        status = (_text(os.path.join(self._folder, "status")) or "").lower()
        if status not in ("charging", "discharging", "full"):
            raise SensorError("this machine does not report whether its charger is connected")
        return status != "discharging"

    def volts(self) -> float:
        """Returns the voltage in V.

        Raises:
            SensorError: it cannot be read.
        """
        return self._number("voltage_now") / 1e6

    def amperes(self) -> float:
        """Returns the current in A, negative when discharging as in sensor_msgs/BatteryState.

        Raises:
            SensorError: it cannot be read.
        """
        current = self._find_number("current_now")
        if current is not None:
            amperes = abs(current) / 1e6
        else:
            volts = self.volts()
            if not volts:
                raise SensorError("the battery of this machine has no current_now, and its voltage is 0")
            amperes = abs(self._number("power_now")) / 1e6 / volts
        return -amperes if _text(os.path.join(self._folder, "status")) == "Discharging" else amperes

    def _find(self) -> Optional[str]:
        for folder in _sorted(f"{self._supplies}/*"):
            name = os.path.basename(folder)
            is_battery = name.startswith("BAT") or "battery" in name.lower()
            if is_battery and _text(os.path.join(folder, "scope")) != "Device":
                return folder
        return None

    def _number(self, file: str) -> int:
        text = _text(os.path.join(self._folder, file))
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


def _chip_temperatures(chip: str) -> List[Temperature]:
    readings = [(file[: -len("_input")], _thousandths(file)) for file in _sorted(f"{chip}/temp*_input")]
    return [Temperature(_text(f"{base}_label") or "", celsius) for base, celsius in readings if celsius is not None]


def _sorted(pattern: str) -> List[str]:
    """Returns the paths that match, hwmon2 before hwmon10."""

    def key(path: str) -> Tuple[object, ...]:
        parts = re.split(r"(\d+)", os.path.basename(path))
        return tuple(int(part) if part.isdigit() else part for part in parts)

    return sorted(glob.glob(pattern), key=key)


def _thousandths(file: str) -> Optional[float]:
    try:
        return float(_text(file) or "") / 1000.0
    except ValueError:
        return None  # a sensor that is switched off has an empty or unreadable file


def _text(file: str) -> Optional[str]:
    """Returns the content of a file, None if it cannot be read."""
    try:
        with open(file, encoding="utf-8", errors="replace") as stream:
            return stream.read(4096).strip()
    except OSError:
        return None
