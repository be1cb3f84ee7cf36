"""What battery_sensor reads of typical computers; expected values by hand."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any, Mapping

import pytest
from harness.machine import Machine
from harness.machines import MACHINES

from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import Computer
from robot_health_monitor.core.sensors.source import NoSuchSensor, NotMeasuredYet, SensorError

pytest.importorskip("psutil")

NONE = "none"
"""The machine does not have this sensor: no alert."""

EXPECTED: Mapping[str, Mapping[str, float | str]] = {
    "Raspberry Pi 4": {
        "memory_percent": 25.0,
        "memory_available": 2982.912,
        "swap_percent": 50.0,
        "oom_kills": 1.0,
        "pressure_cpu": NONE,
        "temperature": 81.79,
        "throttled": 1.0,
        "fan_rpm": NONE,
        "voltage_rail": NONE,
        "gpu_percent": NONE,
        "battery_percent": NONE,
        "network_carrier": 1.0,
        "network_carrier interface=eth0": 0.0,
        "wifi_signal": -61.0,
        "can_errors": NONE,
        "clock_synchronized": NONE,
        "systemd_failed": NONE,
    },
    "Jetson Xavier NX": {
        "memory_percent": 100.0 * 4_794_000 / 6_894_000,
        "swap_percent": 0.0,
        "oom_kills": 0.0,
        "temperature": 48.5,
        "temperature sensor=GPU-therm/0": 47.0,
        "throttled": NONE,
        "fan_rpm": 2930.0,
        "voltage_rail": 5.04,
        "voltage_rail sensor=ina3221x/VDD_CPU_GPU_CV": 4.992,
        "voltage_rail sensor=ina3221x/VDD_SOC": 5.008,
        "gpu_percent": 68.3,
        "gpu_memory_percent": NONE,
        "gpu_temperature": 47.0,
        "network_carrier interface=can0": 1.0,
        "network_carrier interface=dummy0": 0.0,
        "wifi_signal": NONE,
        "wifi_bitrate": NONE,
    },
    "laptop": {
        "memory_percent": 75.0,
        "swap_percent": 10.0,
        "pressure_cpu": 3.21,
        "pressure_memory": 0.0,
        "pressure_io": 1.5,
        "temperature": 58.0,
        "temperature sensor=nvme/Composite": 41.85,
        "fan_rpm": 3120.0,
        "fan_rpm sensor=thinkpad/fan2": 0.0,
        "battery_percent": 55.0,
        "battery_plugged": 0.0,
        "battery_voltage": 11.71,
        "battery_current": -1.15,
        "wifi_signal interface=wlp3s0": -48.0,
    },
    "server": {
        "memory_percent": 25.0,
        "swap_percent": NONE,
        "oom_kills": 7.0,
        "pressure_cpu": 12.0,
        "pressure_io": 35.75,
        "temperature": 44.0,
        "fan_rpm": NONE,
        "voltage_rail": NONE,
        "throttled": NONE,
        "battery_percent": NONE,
        "network_carrier interface=eno2": 0.0,
        "gpu_percent": NONE,
    },
}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def read(kind: str, computer: Computer, text: str = "") -> float:
    """Reads a source with an option `name=value`, the others left out."""
    made = HOST_SOURCES[kind]
    options: dict[str, Any] = {option.name: option.default for option in made.options}
    if text:
        name, _, value = text.partition("=")
        options[name] = value
    return made.make(computer, **options).read(0.0)


@pytest.mark.parametrize(
    ("name", "source", "expected"),
    [(name, source, value) for name, values in EXPECTED.items() for source, value in values.items()],
)
def test_a_machine_reads_as_expected(machine: Machine, name: str, source: str, expected: Any) -> None:
    machine(MACHINES[name])
    kind, _, option = source.partition(" ")
    if expected == NONE:
        with pytest.raises(NoSuchSensor) as caught:
            read(kind, machine.computer, option)
        assert str(caught.value).isprintable()
    else:
        assert read(kind, machine.computer, option) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", MACHINES)
def test_every_source_of_a_machine_has_a_value_or_one_line_with_the_reason(machine: Machine, name: str) -> None:
    machine(MACHINES[name], {"/proc/uptime": "100.00 200.00", "/proc/stat": "cpu  1 0 0 9 0 0 0 0 0 0\nbtime 1"})
    for made in HOST_SOURCES.values():
        options: dict[str, Any] = {option.name: option.default for option in made.options}
        if made.example:
            options["node"] = "amcl"
        source = made.make(machine.computer, **options)
        for now_s in (0.0, 1.0):
            try:
                assert type(source.read(now_s)) is float
            except NotMeasuredYet:
                continue
            except SensorError as error:
                reason = str(error)
            else:
                continue
            assert reason.isprintable() and 10 < len(reason) < 300


WRONG = [
    b"",
    b"\n",
    b"\0" * 9,
    b"\xff\xfe",
    b"nan",
    b"-1",
    b"9" * 5000,
    b"1e999",
    b"a b",
    b": : :",
    b"=",
    b"some avg10=\n",
    b"x" * 70_000,
]


@pytest.mark.parametrize("name", MACHINES)
def test_a_kernel_that_writes_anything_breaks_no_source(machine: Machine, name: str) -> None:
    noise = random.Random(name)
    machine(MACHINES[name], {"/proc/uptime": "100.00 200.00"})
    machine.runs(70, "/x/amcl")
    files = sorted(path for path in machine.root.rglob("*") if path.is_file())
    sources = []
    for made in HOST_SOURCES.values():
        options: dict[str, Any] = {option.name: option.default for option in made.options}
        if made.example:
            options["command"] = "*amcl*"
        sources.append(made.make(machine.computer, **options))
    for step in range(60):
        for file in noise.sample(files, 3):
            content = file.read_bytes()
            cut = noise.randrange(len(content) + 1)
            file.write_bytes(noise.choice([content[:cut], content[:cut] + noise.choice(WRONG), noise.choice(WRONG)]))
        for source in sources:
            try:
                source.read(float(step))
            except SensorError as error:
                reason = str(error)
            else:
                continue
            assert reason.isprintable() and len(reason) < 1000
