"""Graphics processors: a Jetson's files, and a library that answers as nvidia-ml-py does."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.gpu import gpus, read_gpu
from robot_health_monitor.core.sensors.source import NoSuchSensor, SensorError

DRIVER = {"/proc/driver/nvidia/version": "NVRM version: NVIDIA UNIX x86_64 Kernel Module  535.183.01"}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


class NVMLError(Exception):
    pass


@pytest.fixture
def nvml(monkeypatch: pytest.MonkeyPatch) -> Any:
    library = types.SimpleNamespace(
        NVMLError=NVMLError,
        nvmlInit=lambda: None,
        nvmlShutdown=lambda: None,
        nvmlDeviceGetCount=lambda: 2,
        nvmlDeviceGetHandleByIndex=lambda index: range(2)[index],
        nvmlDeviceGetMemoryInfo=lambda handle: types.SimpleNamespace(total=8 << 30, free=6 << 30, used=2 << 30),
        nvmlDeviceGetUtilizationRates=lambda handle: types.SimpleNamespace(gpu=37 + handle, memory=12),
        nvmlDeviceGetTemperature=lambda handle, sensor: 61,
    )
    monkeypatch.setitem(sys.modules, "pynvml", library)  # type: ignore[arg-type]
    return library


def test_nvidia(machine: Machine, nvml: Any) -> None:
    machine(DRIVER)
    assert read_gpu(machine.paths, 1) == {"gpu_percent": 38.0, "gpu_memory_percent": 25.0, "gpu_temperature": 61.0}
    assert list(gpus(machine.paths)) == [0, 1]


def test_a_driver_that_fails_is_named(machine: Machine, nvml: Any) -> None:
    machine(DRIVER)

    def fail(index: int) -> None:
        raise NVMLError("GPU is lost")

    nvml.nvmlDeviceGetHandleByIndex = fail
    with pytest.raises(SensorError, match=r"^the graphics processor cannot be read: NVMLError: GPU is lost$") as caught:
        HOST_SOURCES["gpu_percent"].make(machine.computer, device=0).read(0.0)
    assert not isinstance(caught.value, NoSuchSensor)
    assert gpus(machine.paths) == []


def test_without_the_library_it_is_said_what_to_install(machine: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    machine(DRIVER)
    monkeypatch.setitem(sys.modules, "pynvml", None)  # type: ignore[arg-type]
    with pytest.raises(SensorError, match=r"^nvidia-ml-py is not installed"):
        read_gpu(machine.paths, 0)


def test_a_computer_without_one_is_no_alert(machine: Machine) -> None:
    with pytest.raises(NoSuchSensor, match=r"^no graphics processor of NVIDIA"):
        read_gpu(machine.paths, 0)
    assert list(gpus(machine.paths)) == []


def test_a_jetson_has_load_and_temperature_and_shares_its_memory(machine: Machine) -> None:
    machine(
        {
            "/sys/devices/gpu.0/load": "437",
            "/sys/class/thermal/thermal_zone0/type": "CPU-therm",
            "/sys/class/thermal/thermal_zone0/temp": "39500",
            "/sys/class/thermal/thermal_zone1/type": "GPU-therm",
            "/sys/class/thermal/thermal_zone1/temp": "37000",
        }
    )
    assert read_gpu(machine.paths, 0) == {"gpu_percent": 43.7, "gpu_temperature": 37.0}
    with pytest.raises(NoSuchSensor, match=r"^this machine has no gpu_memory_percent$"):
        HOST_SOURCES["gpu_memory_percent"].make(machine.computer).read(0.0)
    machine({"/sys/class/thermal/thermal_zone1/temp": ""})
    with pytest.raises(SensorError, match=r"^gpu_temperature has not been measured yet$") as caught:
        HOST_SOURCES["gpu_temperature"].make(machine.computer).read(1.0)
    assert not isinstance(caught.value, NoSuchSensor)
