"""`robot-health sources`: the sources of a machine as lines to copy and as JSON."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from harness.machine import Machine

from robot_health_monitor.cli.commands.sources_command import show_sources
from robot_health_monitor.core.proposal.thresholds_file import yaml_text
from robot_health_monitor.core.sensors import configuration as sensing
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES

yaml = pytest.importorskip("yaml")
pytest.importorskip("psutil")

MACHINE = {
    "/sys/class/hwmon/hwmon0/name": "coretemp",
    "/sys/class/hwmon/hwmon0/temp1_input": "52000",
    "/sys/class/hwmon/hwmon0/temp1_label": "Package id 0",
    "/sys/class/power_supply/BAT0/capacity": "62",
    "/sys/class/power_supply/BAT0/status": "Discharging",
}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def lines_of(stream: io.StringIO, machine: Machine, as_json: bool = False) -> list[str]:
    show_sources(as_json, stream, machine.computer)
    return stream.getvalue().splitlines()


def test_there_is_a_line_per_source_with_its_value_or_what_is_missing(machine: Machine) -> None:
    machine(MACHINE)
    lines = lines_of(io.StringIO(), machine)
    assert "{source: temperature, sensor: coretemp/Package id 0}: 52 degC" in lines
    assert "{source: battery_percent}: 62 %" in lines
    assert "{source: battery_plugged}: 0" in lines
    assert any(
        line.startswith("{source: battery_voltage}: the battery of this machine has no voltage_now") for line in lines
    )


def test_utf_8_shows_the_degree_sign(machine: Machine) -> None:
    machine(MACHINE)
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    show_sources(False, stream, machine.computer)
    stream.seek(0)
    assert "{source: temperature, sensor: coretemp/Package id 0}: 52 °C" in stream.read().splitlines()


def test_json_is_an_object_per_source(machine: Machine) -> None:
    machine(MACHINE)
    found = [json.loads(line) for line in lines_of(io.StringIO(), machine, as_json=True)]
    assert {"source": "battery_percent", "value": 62.0, "unit": "%", "problem": None} in found
    (chip,) = (item for item in found if item.get("sensor"))
    assert chip == {
        "source": "temperature",
        "sensor": "coretemp/Package id 0",
        "value": 52.0,
        "unit": "degC",
        "problem": None,
    }
    (voltage,) = (item for item in found if item["source"] == "battery_voltage")
    assert voltage["value"] is None and "voltage_now" in voltage["problem"]


def test_every_kind_of_source_is_listed_whatever_the_machine_lacks(machine: Machine) -> None:
    found = [json.loads(line) for line in lines_of(io.StringIO(), machine, as_json=True)]
    assert {item["source"] for item in found} == set(HOST_SOURCES)
    assert all((item["value"] is None) == (item["problem"] is not None) for item in found)


def test_processes_are_listed_by_the_nodes_that_run(machine: Machine) -> None:
    machine({"/proc/uptime": "100.0 1.0"})
    machine.runs(70, "/x/amcl __name:=localization")
    lines = lines_of(io.StringIO(), machine)
    assert "{source: process_running, node: localization}: 1" in lines
    assert "{source: process_threads, node: localization}: 1" in lines


def test_what_is_missing_is_said_with_the_reason(machine: Machine) -> None:
    machine({"/proc/uptime": "100.0 1.0"})
    machine.runs(1, "/sbin/init")
    lines = lines_of(io.StringIO(), machine)
    assert "{source: process_memory, command: '*/amcl *'}: no process matches command */amcl *" in lines
    for kind, reason in (
        ("throttled", "no Raspberry Pi: there is no "),
        ("can_errors", "this machine has no CAN interface"),
        ("gpu_percent", "no graphics processor of NVIDIA: its driver is not loaded"),
        ("clock_offset_ms", "no time daemon: "),
        ("fan_rpm", "this machine has no fan"),
        ("pressure_io", "this kernel does not measure pressure: "),
    ):
        assert any(line.startswith(f"{{source: {kind}}}: {reason}") for line in lines), kind


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"core": 0},
        {"path": "/mnt/a b"},
        {"path": "/"},
        {"sensor": 'x/"y": {z}'},
        {"sensor": "no"},
        {"sensor": "1"},
        {"sensor": "a\x1b\x9b\u202eb"},
    ],
)
def test_what_is_shown_can_be_copied_into_the_configuration(options: dict[str, Any]) -> None:
    text = yaml_text({"source": "disk_percent", **options})
    assert text.isprintable()
    assert yaml.safe_load(text) == {"source": "disk_percent", **options}


def test_this_machine_is_listed_within_the_command_line_and_every_line_is_a_configuration() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "robot_health_monitor", "sources"],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stderr == ""
    lines = done.stdout.splitlines()
    host = {f"metric{number}": yaml.safe_load(line[: line.index("}: ") + 1]) for number, line in enumerate(lines)}
    assert len(sensing.read_sources({"host": host})) == 3 + len(lines)
    assert any(line.startswith("{source: cpu_percent}: ") and line.endswith(" %") for line in lines)


def test_every_line_is_a_configuration_where_nothing_can_be_listed(machine: Machine) -> None:
    """Such as processes, on a machine so busy that their list takes too long."""
    lines = lines_of(io.StringIO(), machine)
    assert any(line.startswith("{source: process_running, command: '*/amcl *'}: ") for line in lines)
    host = {f"metric{number}": yaml.safe_load(line[: line.index("}: ") + 1]) for number, line in enumerate(lines)}
    assert len(sensing.read_sources({"host": host})) == 3 + len(lines)
