"""Pressure, killed processes and throttling, from files as the kernel writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors import operating_system
from robot_health_monitor.core.sensors.source import NoSuchSensor

THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_pressure_is_the_average_of_ten_seconds_of_some(machine: Machine) -> None:
    machine(
        {
            "/proc/pressure/memory": "some avg10=12.34 avg60=5.00 avg300=1.00 total=123456\n"
            "full avg10=9.87 avg60=4.00 avg300=0.50 total=65432",
            "/proc/pressure/io": "full avg10=9.87",
        }
    )
    assert operating_system.pressure_percent(machine.paths, "memory") == 12.34
    with pytest.raises(NoSuchSensor, match=r"pressure/io has no some avg10$"):
        operating_system.pressure_percent(machine.paths, "io")
    with pytest.raises(NoSuchSensor, match=r"this kernel does not measure pressure: .*/pressure/cpu has no some avg10"):
        operating_system.pressure_percent(machine.paths, "cpu")
    machine({"/proc/pressure/cpu": "some avg10=x"})
    with pytest.raises(ValueError, match="'x'"):
        operating_system.pressure_percent(machine.paths, "cpu")


def test_killed_processes_are_counted_by_the_kernel(machine: Machine) -> None:
    machine({"/proc/vmstat": "nr_free_pages 1\noom_kill 3\nnr_unstable 0"})
    assert operating_system.oom_kills(machine.paths) == 3.0
    machine({"/proc/vmstat": "nr_free_pages 1"})
    with pytest.raises(NoSuchSensor, match=r"has no oom_kill"):
        operating_system.oom_kills(machine.paths)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0", 0.0),
        ("50000", 0.0),  # under-voltage and throttling in the past
        ("50005", 1.0),  # and now
        ("80008", 1.0),  # soft temperature limit
        ("2", 1.0),
    ],
)
def test_a_raspberry_pi_is_throttled_now_or_was(machine: Machine, text: str, value: float) -> None:
    machine({THROTTLED: text})
    assert operating_system.throttled(machine.paths) == value


def test_a_firmware_that_is_not_understood_is_no_zero(machine: Machine) -> None:
    with pytest.raises(NoSuchSensor, match=r"^no Raspberry Pi"):
        operating_system.throttled(machine.paths)
    machine({THROTTLED: "?"})
    with pytest.raises(ValueError, match=r"'\?'"):
        operating_system.throttled(machine.paths)


@pytest.mark.parametrize("read", [operating_system.oom_kills, operating_system.throttled])
def test_a_computer_without_these_files_is_no_alert(machine: Machine, read: Callable[..., float]) -> None:
    with pytest.raises(NoSuchSensor):
        read(machine.paths)
