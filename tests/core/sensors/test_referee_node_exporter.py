"""This computer, and trees of others, read as Debian's prometheus-node-exporter reads them."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import socket
import subprocess
import urllib.request
from pathlib import Path
from typing import Callable, Iterator, Mapping, Tuple

import pytest
from harness.machine import Machine
from harness.machines import MACHINES, disks, interfaces
from harness.waiting import wait_for

from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import HOST_PATHS, Computer, HostPaths
from robot_health_monitor.core.sensors.host import find_sensors
from robot_health_monitor.core.sensors.network import can_interfaces
from robot_health_monitor.core.sensors.source import NoSuchSensor, NotMeasuredYet, SensorError

pytest.importorskip("psutil")

EXPORTER = shutil.which("prometheus-node-exporter", path=os.pathsep.join([os.environ.get("PATH", ""), "/usr/bin"]))
pytestmark = [
    pytest.mark.newest_python,
    pytest.mark.skipif(EXPORTER is None, reason="prometheus-node-exporter is not installed"),
]
COLLECTORS = ["diskstats", "hwmon", "loadavg", "meminfo", "netclass", "netdev", "powersupplyclass", "thermal_zone"]
LIVE = ["filesystem"]
LINE = re.compile(r"(\w+)(?:\{(.*)\})? (\S+)\Z")

Metrics = Mapping[Tuple[str, Tuple[str, ...]], float]
"""Value by name and values of the labels, in the order of their names."""


@contextlib.contextmanager
def node_exporter(paths: HostPaths) -> Iterator[Callable[[], Metrics]]:
    """Runs node_exporter over folders; yields what reads all of its metrics."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    collectors = [*COLLECTORS, "vmstat", *(LIVE if paths == HOST_PATHS else [])]
    arguments = [f"--collector.{name}" for name in collectors]
    process = subprocess.Popen(
        [
            str(EXPORTER),
            f"--web.listen-address=127.0.0.1:{port}",
            f"--path.procfs={paths.proc}",
            f"--path.sysfs={paths.sys}",
            "--no-collector.netdev.netlink",
            "--collector.disable-defaults",
            *arguments,
        ],
        stderr=subprocess.DEVNULL,
    )
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))

    def scrape() -> Metrics:
        with opener.open(f"http://127.0.0.1:{port}/metrics", timeout=30.0) as answer:
            return dict(parse(answer.read().decode("utf-8")))

    def answers() -> bool:
        assert process.poll() is None
        with contextlib.suppress(OSError):
            scrape()
            return True
        return False

    try:
        wait_for(answers)
        yield scrape
    finally:
        process.terminate()
        process.wait()


def parse(text: str) -> Iterator[tuple[tuple[str, tuple[str, ...]], float]]:
    for line in text.splitlines():
        found = LINE.match(line)
        if found:
            labels = tuple(value for _, value in sorted(re.findall(r'(\w+)="([^"]*)"', found[2] or "")))
            yield (found[1], labels), float(found[3])


def family(metrics: Metrics, name: str) -> dict[tuple[str, ...], float]:
    return {labels: value for (found, labels), value in metrics.items() if found == name}


def read(kind: str, computer: Computer, now_s: float = 0.0, **options: str) -> float:
    made = HOST_SOURCES[kind]
    return made.make(computer, **{**{option.name: option.default for option in made.options}, **options}).read(now_s)


def values_or_none(kind: str, computer: Computer) -> float:
    try:
        return read(kind, computer)
    except NoSuchSensor:
        return 0.0


@pytest.mark.parametrize("name", MACHINES)
def test_a_machine_reads_as_node_exporter_reads_it(tmp_path: Path, name: str) -> None:
    machine = Machine(tmp_path)
    machine(MACHINES[name])
    # What it reads beside these, and fails without.
    machine({"/proc/loadavg": "0.50 1.25 2.00 1/100 4242", "/proc/stat": "cpu  1 0 0 9 0 0 0 0 0 0\nbtime 1"})
    paths, computer = machine.paths, machine.computer
    with node_exporter(paths) as scrape:
        metrics = scrape()
        temperatures = sorted(family(metrics, "node_hwmon_temp_celsius").values())
        zones = sorted(family(metrics, "node_thermal_zone_temp").values())
        celsius, fans, volts = (
            sorted(read(kind, computer, sensor=sensor) for sensor in find_sensors(paths, files))
            for kind, files in (("temperature", "temp"), ("fan_rpm", "fan"), ("voltage_rail", "in"))
        )
        assert celsius == pytest.approx(temperatures or zones)
        assert fans == sorted(family(metrics, "node_hwmon_fan_rpm").values())
        assert volts == pytest.approx(sorted(family(metrics, "node_hwmon_in_volts").values()))
        (available,) = family(metrics, "node_memory_MemAvailable_bytes").values()
        (total,) = family(metrics, "node_memory_MemTotal_bytes").values()
        assert read("memory_available", computer) == pytest.approx(available / 1e6)
        assert read("memory_percent", computer) == pytest.approx(100.0 * (1.0 - available / total), abs=0.06)
        (swap,) = family(metrics, "node_memory_SwapTotal_bytes").values()
        (swap_free,) = family(metrics, "node_memory_SwapFree_bytes").values()
        expected = 100.0 * (1.0 - swap_free / swap) if swap else 0.0
        assert values_or_none("swap_percent", computer) == pytest.approx(expected, abs=0.06)
        (kills,) = family(metrics, "node_vmstat_oom_kill").values()
        assert read("oom_kills", computer) == kills
        for (device,), carrier in family(metrics, "node_network_carrier").items():
            if device != "lo":
                assert read("network_carrier", computer, interface=device) == carrier
        for (supply,), volt in family(metrics, "node_power_supply_voltage_volt").items():
            assert supply == "BAT0"
            assert read("battery_voltage", computer) == pytest.approx(volt)
            assert -read("battery_current", computer) == pytest.approx(
                metrics["node_power_supply_current_ampere", ("BAT0",)]
            )
            assert read("battery_percent", computer) == metrics["node_power_supply_capacity", ("BAT0",)]
            assert read("battery_plugged", computer) == metrics["node_power_supply_online", ("AC",)]
        rates_agree(machine, metrics, scrape)


FIELDS = {
    "network_receive": (("node_network_receive_bytes_total",), 1e-6),
    "network_send": (("node_network_transmit_bytes_total",), 1e-6),
    "network_errors": (("node_network_receive_errs_total", "node_network_transmit_errs_total"), 1.0),
    "network_drops": (("node_network_receive_drop_total", "node_network_transmit_drop_total"), 1.0),
}


def rates_agree(machine: Machine, before: Metrics, scrape: Callable[[], Metrics]) -> None:
    """Lets the counters grow by 4 s of traffic, and compares the rates."""
    names = sorted(labels[0] for labels in family(before, "node_network_receive_bytes_total"))
    devices = sorted(labels[0] for labels in family(before, "node_disk_reads_completed_total"))
    sources = {
        (kind, name): HOST_SOURCES[kind].make(machine.computer, interface=name) for kind in FIELDS for name in names
    }
    slow = {name: HOST_SOURCES["disk_latency_ms"].make(machine.computer, device=name) for name in devices}
    for source in (*sources.values(), *slow.values()):
        with pytest.raises(NotMeasuredYet):
            source.read(10.0)
    machine(
        interfaces(
            **{name: f"{10**9 + 7 * number} {10**9 + 9} {100 + number} 300" for number, name in enumerate(names)}
        ),
        disks(**{name: f"{10**5 + number} 200000 {10**5} 500000" for number, name in enumerate(devices)}),
    )
    after = scrape()
    for (kind, name), source in sources.items():
        fields, scale = FIELDS[kind]
        grown = sum(after[field, (name,)] - before[field, (name,)] for field in fields)
        assert source.read(14.0) == pytest.approx(scale * grown / 4.0), (kind, name)
    for name, source in slow.items():
        taken = [f"node_disk_{each}_time_seconds_total" for each in ("read", "write")]
        done = [f"node_disk_{each}_completed_total" for each in ("reads", "writes")]
        spent_s, requests = (
            sum(after[field, (name,)] - before[field, (name,)] for field in fields) for fields in (taken, done)
        )
        assert source.read(14.0) == pytest.approx(1000.0 * spent_s / requests), name
    try:
        can = can_interfaces(machine.paths)
    except NoSuchSensor:
        can = []
    assert can == [name for name in names if name.startswith("can")]


def test_this_computer_reads_as_node_exporter_reads_it() -> None:
    computer = Computer()
    with node_exporter(HOST_PATHS) as scrape:

        def load() -> dict[str, float]:
            return {minutes: read(f"load_{minutes}min", computer) for minutes in ("1", "5", "15")}

        # Values that change are between two reads of the other.
        before, loads, after = scrape(), load(), scrape()
        for minutes, found in loads.items():
            assert found == pytest.approx(before[f"node_load{minutes}", ()], abs=0.006) or found == pytest.approx(
                after[f"node_load{minutes}", ()], abs=0.006
            )
        mounted = {labels[2]: labels for labels in family(before, "node_filesystem_files")}
        for path, labels in mounted.items():
            if not os.path.ismount(path):
                continue
            try:
                inodes = read("disk_inodes_percent", computer, path=path)
            except SensorError:
                inodes = 0.0
            files, free = before["node_filesystem_files", labels], before["node_filesystem_files_free", labels]
            assert inodes == pytest.approx(100.0 * (files - free) / files if files else 0.0, abs=1.0)
            space = before["node_filesystem_avail_bytes", labels] / 1e9
            assert read("disk_free", computer, path=path) == pytest.approx(space, abs=1.0)
            assert read("disk_read_only", computer, path=path) == before["node_filesystem_readonly", labels]
        for (device,), carrier in family(before, "node_network_carrier").items():
            if device != "lo":
                assert read("network_carrier", computer, interface=device) == carrier
        assert before["node_vmstat_oom_kill", ()] <= read("oom_kills", computer) <= scrape()["node_vmstat_oom_kill", ()]
        available = read("memory_available", computer)
        assert available == pytest.approx(before["node_memory_MemAvailable_bytes", ()] / 1e6, rel=0.2)
