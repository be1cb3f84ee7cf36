"""Graphics processors of this computer, as sources: NVIDIA's by nvidia-ml-py, a Jetson's by the kernel's files.

NVIDIA's library waits for its driver, so `read_gpu` is called with `Computer.ask`.
"""

from __future__ import annotations

import os

from .computer import HostPaths, read_float, read_text, sorted_paths
from .source import NoSuchSensor, SensorError

_LOADS = ("devices/gpu.0/load", "devices/platform/gpu.0/load", "class/devfreq/*gpu*/device/load",
          "class/devfreq/*.g*1*b/device/load")  # fmt: skip
"""Where a Jetson's kernel has the load in thousandths: L4T 28 to 32, and Orin."""


def read_gpu(paths: HostPaths, device: int = 0) -> dict[str, float | None]:
    """Returns what a graphics processor does, by its number and the names of the sources; raises SensorError. May hang.

    A Jetson shares the memory of the computer.
    """
    loads = [read_float(load) for pattern in _LOADS for load in sorted_paths(os.path.join(paths.sys, pattern))]
    if device == 0 and loads and loads[0] is not None:
        return {"gpu_percent": loads[0] / 10.0, **_jetson_celsius(paths)}
    if not os.path.exists(os.path.join(paths.proc, "driver", "nvidia")):
        raise NoSuchSensor("no graphics processor of NVIDIA: its driver is not loaded")
    try:
        import pynvml as nvml
    except ImportError:
        raise SensorError("nvidia-ml-py is not installed: install it with pip") from None
    nvml.nvmlInit()
    try:
        handle = nvml.nvmlDeviceGetHandleByIndex(device)
        memory = nvml.nvmlDeviceGetMemoryInfo(handle)
        return {
            "gpu_percent": float(nvml.nvmlDeviceGetUtilizationRates(handle).gpu),
            "gpu_memory_percent": 100.0 * memory.used / memory.total,
            "gpu_temperature": float(nvml.nvmlDeviceGetTemperature(handle, 0)),
        }
    finally:
        nvml.nvmlShutdown()


def _jetson_celsius(paths: HostPaths) -> dict[str, float | None]:
    for zone in sorted_paths(f"{paths.sys}/class/thermal/thermal_zone*"):
        if (read_text(zone, "type") or "").lower().startswith("gpu"):
            number = read_float(zone, "temp")
            return {"gpu_temperature": None if number is None else number / 1000.0}
    return {}


def gpus(paths: HostPaths) -> list[int]:
    """Returns the numbers of the graphics processors that can be read."""
    numbers: list[int] = []
    try:
        while len(numbers) < 16:
            read_gpu(paths, len(numbers))
            numbers.append(len(numbers))
    except Exception:  # there is no further one; or why the first cannot be read is shown when it is
        pass
    return numbers
