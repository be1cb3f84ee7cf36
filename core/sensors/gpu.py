"""Graphics processors of this computer, as sources: NVIDIA's by nvidia-ml-py, a Jetson's by the kernel's files.

NVIDIA's library waits for its driver, so `read_gpu` is called with `Computer.ask`.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple, Optional

from .computer import HostPaths, read_float, read_text, sorted_paths
from .source import NoSuchSensor, SensorError

_LOADS = ("devices/gpu.0/load", "devices/platform/gpu.0/load", "class/devfreq/*gpu*/device/load",
          "class/devfreq/*.g*1*b/device/load")  # fmt: skip
"""Where a Jetson's kernel has the load in thousandths: L4T 28 to 32, and Orin."""


class Gpu(NamedTuple):
    """What a graphics processor does."""

    percent: Optional[float]
    memory_percent: Optional[float]
    """None: it shares the memory of the computer."""
    celsius: Optional[float]


def read_gpu(paths: HostPaths, device: int) -> Gpu:
    """Returns what a graphics processor does, by its number; raises SensorError. May hang."""
    loads = [load for pattern in _LOADS for load in sorted_paths(os.path.join(paths.sys, pattern))]
    load = read_float(loads[0]) if loads and device == 0 else None
    if load is not None:
        return Gpu(load / 10.0, None, _jetson_celsius(paths))
    return _read_nvidia(paths, device)


def _jetson_celsius(paths: HostPaths) -> Optional[float]:
    for zone in sorted_paths(f"{paths.sys}/class/thermal/thermal_zone*"):
        if (read_text(zone, "type") or "").lower().startswith("gpu"):
            number = read_float(zone, "temp")
            return None if number is None else number / 1000.0
    return None


def _read_nvidia(paths: HostPaths, device: int) -> Gpu:
    if not os.path.exists(os.path.join(paths.proc, "driver", "nvidia")):
        raise NoSuchSensor("no graphics processor of NVIDIA: its driver is not loaded")
    nvml = _nvml()
    try:
        nvml.nvmlInit()
        try:
            handle = nvml.nvmlDeviceGetHandleByIndex(device)
            memory = nvml.nvmlDeviceGetMemoryInfo(handle)
            return Gpu(
                float(nvml.nvmlDeviceGetUtilizationRates(handle).gpu),
                100.0 * memory.used / memory.total,
                float(nvml.nvmlDeviceGetTemperature(handle, 0)),
            )
        finally:
            nvml.nvmlShutdown()
    except nvml.NVMLError as error:
        raise SensorError(f"graphics processor {device} cannot be read: {error}") from None


def _nvml() -> Any:
    try:
        import pynvml
    except ImportError:
        raise SensorError("nvidia-ml-py is not installed: install it with pip") from None
    return pynvml


def gpu_value(gpu: Gpu, name: str) -> float:
    """Returns one figure of a graphics processor by its name; raises NoSuchSensor if it does not have it."""
    value = getattr(gpu, name)
    if value is None:
        lacks = {"memory_percent": "shares the memory of the computer: see memory_percent"}
        raise NoSuchSensor(f"this graphics processor {lacks.get(name, 'does not have this figure')}")
    return float(value)


def gpus(paths: HostPaths) -> range:
    """Returns the numbers of the graphics processors."""
    try:
        read_gpu(paths, 0)
    except NoSuchSensor:
        return range(0)
    except SensorError:
        return range(1)
    number = 1
    try:
        nvml = _nvml()
        nvml.nvmlInit()
        number = nvml.nvmlDeviceGetCount()
        nvml.nvmlShutdown()
    except Exception:  # a Jetson has no such library: it has one
        pass
    return range(min(number, 16))
