"""The three metrics of this machine: CPU load, temperature, battery.

psutil reads /proc and is imported when it is first needed. What cannot be read raises SensorError.
"""

from __future__ import annotations

from typing import Any, Dict, Iterable, List, Mapping, Optional, Sequence, Tuple

from .source import NoSuchSensor, NotMeasuredYet, SensorError
from .sysfs import HOST_PATHS, Battery, HostPaths, Temperature, read_temperatures


class HostCpuUsage:
    """CPU load of this machine since the previous read, in %."""

    def __init__(self, core: Optional[int] = None, paths: HostPaths = HOST_PATHS) -> None:
        """Reads the counters, so that the first `read` has something to compare with.

        Args:
            core: a core, counted from 0; None: all cores together.
            paths: where the kernel's files are.
        """
        # Not psutil.cpu_percent(): it compares with the previous call in the same thread, and rospy calls back from
        # other threads than the one that made the node. Its first answer is a meaningless 0.0.
        self._core = core
        self._paths = paths
        self._cores: Optional[int] = None
        self._last: Optional[Dict[str, float]] = None
        self._percent: Optional[float] = None
        try:
            self._last = self._cpu_times()
        except SensorError:
            pass  # the first read reports it

    def read(self, now_s: float) -> float:
        """Returns the load in %; the previous one if no time has passed since.

        Raises:
            SensorError: it cannot be read, or it has not been measured yet.
        """
        times = self._cpu_times()
        last, self._last = self._last, times
        if last is not None:
            # A counter may step back: iowait does, and so do those of a core that goes offline.
            spent = {kind: max(0.0, times[kind] - last.get(kind, times[kind])) for kind in times}
            total_s = sum(spent.values())
            if total_s > 0.0:
                self._percent = 100.0 * (total_s - spent.get("idle", 0.0) - spent.get("iowait", 0.0)) / total_s
        if self._percent is None:
            raise NotMeasuredYet("CPU load is not measured yet: it takes two reads")
        return self._percent

    def _cpu_times(self) -> Dict[str, float]:
        if self._core is None:
            return _named_times(call_psutil("cpu_times", "CPU times", self._paths))
        cores = call_psutil("cpu_times", "CPU times", self._paths, percpu=True)
        if self._cores is None:
            self._cores = len(cores)
        if self._core >= self._cores:
            raise SensorError(f"this machine has no core {self._core}, the last one is {self._cores - 1}")
        if len(cores) != self._cores:  # the list is renumbered when a core goes offline
            raise SensorError(f"{len(cores)} of {self._cores} cores are online: core {self._core} is ambiguous")
        return _named_times(cores[self._core])


class HostTemperature:
    """A temperature of this machine in degrees C.

    Without a sensor's name: the hottest sensor of the CPU; if the CPU has none, the hottest of all.
    """

    def __init__(self, sensor: str = "", paths: HostPaths = HOST_PATHS) -> None:
        """Reads nothing yet.

        Args:
            sensor: `chip/label` or `chip/number` as `robot-health sources` lists them; empty: see above.
            paths: where the kernel's files are.
        """
        self._sensor = sensor
        self._paths = paths

    def read(self, now_s: float) -> float:
        """Returns the temperature in degrees C.

        Raises:
            SensorError: there is no such sensor, or it has no plausible reading.
        """
        chips = read_temperatures(self._paths)
        return self._hottest(chips) if self._sensor == "" else self._one(chips)

    def _hottest(self, chips: Mapping[str, Sequence[Temperature]]) -> float:
        readings = [(chip, sensor.celsius) for chip, sensors in chips.items() for sensor in sensors]
        plausible = [(chip, celsius) for chip, celsius in readings if _is_plausible(celsius)]
        of_cpu = [celsius for chip, celsius in plausible if chip.lower().startswith(_CPU_CHIPS)]
        candidates = of_cpu or [celsius for _, celsius in plausible]
        if candidates:
            return max(candidates)
        if readings:
            raise SensorError(
                f"no plausible temperature: {_list_readings(readings)}; set the source to simulated or none"
            )
        raise NoSuchSensor(
            f"no temperature sensor in {self._paths.sys}/class/hwmon or {self._paths.sys}/class/thermal (virtual "
            "machines and containers have none); load its driver (sensors-detect), or set the source to simulated or "
            "none"
        )

    def _one(self, chips: Mapping[str, Sequence[Temperature]]) -> float:
        celsius = _by_name(chips).get(self._sensor)
        if celsius is None:
            available = ", ".join(temperature_sensors(self._paths)) or "none"
            raise SensorError(f"this machine has no temperature sensor {self._sensor}; available: {available}")
        if not _is_plausible(celsius):
            raise SensorError(f"no plausible temperature: {self._sensor} reads {celsius}")
        return celsius


class HostBattery:
    """Charge of this machine's battery in %."""

    def __init__(self, paths: HostPaths = HOST_PATHS) -> None:
        """Reads nothing yet.

        Args:
            paths: where the kernel's files are.
        """
        self._paths = paths

    def read(self, now_s: float) -> float:
        """Returns the charge in %.

        Raises:
            SensorError: there is no battery, or its charge cannot be read.
        """
        return Battery(self._paths).percent()


def temperature_sensors(paths: HostPaths = HOST_PATHS) -> List[str]:
    """Returns the names of this machine's temperature sensors, those with implausible readings included."""
    names = []
    for chip, sensors in read_temperatures(paths).items():
        labels = [sensor.label for sensor in sensors]
        for number, label in enumerate(labels):
            names.append(f"{chip}/{label if label and labels.count(label) == 1 else number}")
    return names


def call_psutil(function: str, subject: str, paths: HostPaths, *arguments: Any, **options: Any) -> Any:
    """Calls a function of psutil.

    Args:
        function: its name.
        subject: what it reads, for error messages.
        paths: where the kernel's files are.
        arguments: for the function.
        options: for the function.

    Raises:
        SensorError: psutil is not installed, lacks the function on this system, or failed.
    """
    try:
        import psutil
    except ImportError:
        raise SensorError("psutil is not installed: install python3-psutil with apt or psutil with pip") from None
    if not hasattr(psutil, function):
        raise SensorError(f"psutil cannot read {subject} on this system; set the source to simulated or none")
    psutil.PROCFS_PATH = paths.proc
    try:
        return getattr(psutil, function)(*arguments, **options)
    except Exception as error:  # psutil raises anything when a driver's file is odd
        raise SensorError(f"psutil cannot read {subject}: {type(error).__name__}: {error}") from error


_CPU_CHIPS = ("coretemp", "k10temp", "zenpower", "cpu", "soc_thermal", "soc-thermal", "x86_pkg_temp", "via_cputemp")
"""Prefixes of the names of CPU temperature chips: Intel, AMD, ARM boards, thermal zones, VIA."""


def _is_plausible(celsius: float) -> bool:
    """Returns False for placeholders.

    An unconnected or sleeping sensor reads exactly 0, the limit of its register (-128, -62, 127, 255) or absolute
    zero. Electronics is specified from -55 to 125 degrees C.
    """
    return celsius != 0.0 and -55.0 <= celsius <= 125.0


def _list_readings(readings: Iterable[Tuple[str, float]]) -> str:
    texts = [f"{chip} reads {celsius}" for chip, celsius in readings]
    return ", ".join(texts[:3]) + (", ..." if len(texts) > 3 else "")


def _named_times(times: Any) -> Dict[str, float]:
    # Linux counts the time of guests in user and nice as well.
    return {kind: seconds for kind, seconds in times._asdict().items() if kind not in ("guest", "guest_nice")}


def _by_name(chips: Mapping[str, Sequence[Temperature]]) -> Dict[str, float]:
    """Returns the readings by every name of their sensor."""
    readings: Dict[str, float] = {}
    for chip, sensors in chips.items():
        for number, sensor in enumerate(sensors):
            readings[f"{chip}/{number}"] = sensor.celsius
        for sensor in reversed(sensors):  # the first of those with the same label wins
            if sensor.label:
                readings[f"{chip}/{sensor.label}"] = sensor.celsius
    return readings
