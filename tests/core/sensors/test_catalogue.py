"""Further metrics of a machine, read from the files of other machines in a temporary folder.

The trees follow proc(5), the kernel's Documentation/ABI/testing/sysfs-class-power and its hwmon documentation.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from harness.machine import Machine
from harness.port_conformance import levels_to

from robot_health_monitor.core.nodes import AlertSystem, BatterySensor
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import HOST_PATHS, Computer
from robot_health_monitor.core.sensors.source import NotMeasuredYet, SensorError

psutil = pytest.importorskip("psutil")

HWMON = "/sys/class/hwmon"
POWER = "/sys/class/power_supply"

# Two solid state disks of one kind, and a CPU whose second core sensor sleeps.
WORKSTATION = {
    f"{HWMON}/hwmon0/name": "coretemp",
    f"{HWMON}/hwmon0/temp1_input": "52000",
    f"{HWMON}/hwmon0/temp1_label": "Package id 0",
    f"{HWMON}/hwmon0/temp2_input": "49000",
    f"{HWMON}/hwmon0/temp2_label": "Core 0",
    f"{HWMON}/hwmon0/temp3_input": "0",
    f"{HWMON}/hwmon0/temp3_label": "Core 1",
    f"{HWMON}/hwmon1/name": "nvme",
    f"{HWMON}/hwmon1/temp1_input": "38850",
    f"{HWMON}/hwmon1/temp1_label": "Composite",
    f"{HWMON}/hwmon2/name": "nvme",
    f"{HWMON}/hwmon2/temp1_input": "61850",
    f"{HWMON}/hwmon2/temp1_label": "Composite",
    f"{HWMON}/hwmon3/name": "acpitz",
    f"{HWMON}/hwmon3/temp1_input": "27800",
}
MEMORY = {
    "/proc/meminfo": "\n".join(
        [
            "MemTotal:        8000000 kB",
            "MemFree:         1000000 kB",
            "MemAvailable:    2000000 kB",
            "Buffers:          200000 kB",
            "Cached:          1000000 kB",
            "Shmem:            100000 kB",
            "Active:          3000000 kB",
            "Inactive:        2000000 kB",
            "SwapTotal:       1000000 kB",
            "SwapFree:         750000 kB",
        ]
    ),
    "/proc/vmstat": "pswpin 10\npswpout 20",
    "/proc/zoneinfo": "Node 0, zone      DMA\n        low      28",
}
NO_SWAP = {
    "/proc/meminfo": MEMORY["/proc/meminfo"].replace("1000000 kB\nSwapFree:         750000", "0 kB\nSwapFree: 0")
}
# As a ThinkPad shows it, in microvolts and microwatts; it has no current_now.
DISCHARGING = {
    f"{POWER}/AC/online": "0",
    f"{POWER}/AC/type": "Mains",
    f"{POWER}/BAT0/energy_full": "50000000",
    f"{POWER}/BAT0/energy_now": "31000000",
    f"{POWER}/BAT0/power_now": "7400000",
    f"{POWER}/BAT0/status": "Discharging",
    f"{POWER}/BAT0/type": "Battery",
    f"{POWER}/BAT0/voltage_now": "11840000",
}
CHARGING = {f"{POWER}/AC/online": "1", f"{POWER}/BAT0/status": "Charging"}
# As a UPS board for the Raspberry Pi shows it (max17040): current in microamperes, no charger information.
UPS_BOARD = {
    f"{POWER}/battery/capacity": "87",
    f"{POWER}/battery/current_now": "-1250000",
    f"{POWER}/battery/status": "Discharging",
    f"{POWER}/battery/voltage_now": "3912000",
}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def source(kind: str, machine: Machine | None = None, **option: Any) -> Any:
    made = HOST_SOURCES[kind]
    options = {**{each.name: each.default for each in made.options}, **option}
    return made.make(Computer() if machine is None else Computer(machine.paths), **options)


def read(kind: str, machine: Machine | None = None, **option: Any) -> float:
    value = source(kind, machine, **option).read(0.0)
    assert type(value) is float
    return value


def begun(kind: str, machine: Machine, **option: Any) -> Any:
    """Returns a source of what grows after its first read."""
    made = source(kind, machine, **option)
    with pytest.raises(NotMeasuredYet):
        made.read(0.0)
    return made


def failure(kind: str, machine: Machine | None = None, **option: Any) -> str:
    with pytest.raises(SensorError) as caught:
        source(kind, machine, **option).read(0.0)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def processors(*ticks: str) -> dict[str, str]:
    """Returns /proc/stat of processors that have spent `user idle` ticks of 10 ms."""
    lines = [f"cpu{number} {user} 0 0 {idle} 0 0 0 0 0 0" for number, (user, idle) in enumerate(map(str.split, ticks))]
    return {"/proc/stat": "\n".join(["cpu  0 0 0 0 0 0 0 0 0 0", *lines, "btime 1700000000"])}


def interfaces(**counters: str) -> dict[str, str]:
    """Returns /proc/net/dev of interfaces that have counted `errors drops` on the way in, and 1 of each out."""
    directions = "bytes packets errs drop fifo frame compressed multicast", "bytes packets errs drop fifo colls carrier"
    head = ["Inter-| Receive | Transmit", f" face |{'|'.join(directions)} compressed"]
    lines = []
    for name, text in counters.items():
        errors, drops = text.split()
        lines.append(f"{name:>6}: 1000 10 {errors} {drops} 0 0 0 0 2000 20 1 1 0 0 0 0")
    return {"/proc/net/dev": "\n".join([*head, *lines])}


def test_the_load_of_one_core_is_its_own(machine: Machine) -> None:
    machine(processors("100 900", "100 900"))
    first, second = begun("cpu_percent", machine, core=0), begun("cpu_percent", machine, core=1)
    machine(processors("110 990", "190 910"))
    assert first.read(1.0) == pytest.approx(10.0)
    assert second.read(1.0) == pytest.approx(90.0)


def test_a_core_that_the_machine_does_not_have_is_named(machine: Machine) -> None:
    machine(processors("100 900", "100 900"))
    assert failure("cpu_percent", machine, core=2) == "this machine has no core 2; available: 0, 1"


def test_when_a_core_goes_offline_no_other_is_taken_for_it(machine: Machine) -> None:
    machine(processors("100 900", "100 900", "100 900"))
    second, third = begun("cpu_percent", machine, core=1), begun("cpu_percent", machine, core=2)
    machine({"/proc/stat": "cpu  20 0 0 180 0 0 0 0 0 0\ncpu0 10 0 0 90 0 0 0 0 0 0\ncpu2 110 0 0 990 0 0 0 0 0 0"})
    with pytest.raises(SensorError, match=r"^this machine has no core 1; available: 0, 2$"):
        second.read(1.0)
    assert third.read(1.0) == pytest.approx(10.0)
    machine(processors("100 900", "100 900", "100 900"))
    with pytest.raises(NotMeasuredYet):
        second.read(2.0)
    machine(processors("100 900", "150 950", "100 900"))
    assert second.read(3.0) == pytest.approx(50.0)


def test_the_first_look_at_a_core_is_no_zero(machine: Machine) -> None:
    machine(processors("100 900"))
    with pytest.raises(NotMeasuredYet):
        source("cpu_percent", machine, core=0).read(0.0)


@pytest.mark.parametrize(("kind", "load"), [("load_1min", 0.5), ("load_5min", 1.25), ("load_15min", 2.0)])
def test_load_is_that_of_its_minutes(kind: str, load: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getloadavg", lambda: (0.5, 1.25, 2.0))
    assert read(kind) == load


def test_memory_in_use_is_what_programs_can_no_longer_get(machine: Machine) -> None:
    machine(MEMORY)
    assert read("memory_percent", machine) == 75.0  # 2 of 8 GB are available
    assert read("memory_available", machine) == 2048.0  # 2,000,000 kB of 1,024 bytes are 2,048 MB


def test_swap_in_use(machine: Machine) -> None:
    machine(MEMORY)
    assert read("swap_percent", machine) == 25.0


def test_a_machine_without_swap_says_so_instead_of_0_percent(machine: Machine) -> None:
    machine(MEMORY, NO_SWAP)
    assert failure("swap_percent", machine) == "this machine has no swap"


@pytest.mark.parametrize(
    ("sensor", "celsius"),
    [
        ("", 52.0),
        ("coretemp/Core 0", 49.0),
        ("nvme/1", 61.85),
        ("nvme/Composite", 38.85),
        ("acpitz/0", 27.8),
    ],
)
def test_a_temperature_sensor_is_chosen_by_its_label_or_without_one_by_its_number(
    machine: Machine, sensor: str, celsius: float
) -> None:
    machine(WORKSTATION)
    assert read("temperature", machine, sensor=sensor) == celsius


def test_a_temperature_sensor_that_shows_a_placeholder_costs_its_reading(machine: Machine) -> None:
    machine(WORKSTATION)
    reason = failure("temperature", machine, sensor="coretemp/Core 1")
    assert reason.startswith("no plausible temperature: coretemp/Core 1 reads 0.0; ")


def test_a_temperature_sensor_that_is_not_there_is_named_with_those_that_are(machine: Machine) -> None:
    machine(WORKSTATION)
    assert failure("temperature", machine, sensor="k10temp/Tctl").startswith(
        "this machine has no temperature sensor k10temp/Tctl; available:"
        " coretemp/Package id 0, coretemp/Core 0, coretemp/Core 1, nvme/Composite, nvme/1, acpitz/0"
    )


def test_a_sensor_that_is_unplugged_costs_its_readings_and_comes_back(machine: Machine) -> None:
    machine(WORKSTATION)
    acpitz = source("temperature", machine, sensor="acpitz/0")
    assert acpitz.read(0.0) == 27.8
    machine({path: None for path in WORKSTATION if "hwmon3" in path})
    with pytest.raises(SensorError, match=r"^this machine has no temperature sensor acpitz/0"):
        acpitz.read(1.0)
    machine(WORKSTATION)
    assert acpitz.read(2.0) == 27.8


def test_a_battery_that_discharges(machine: Machine) -> None:
    machine(DISCHARGING)
    assert read("battery_percent", machine) == 62.0
    assert read("battery_plugged", machine) == 0.0
    assert read("battery_voltage", machine) == 11.84
    assert read("battery_current", machine) == pytest.approx(-0.625)  # 7.4 W at 11.84 V


def test_a_battery_that_is_charged(machine: Machine) -> None:
    machine(DISCHARGING, CHARGING)
    assert read("battery_plugged", machine) == 1.0
    assert read("battery_current", machine) == pytest.approx(0.625)


def test_a_battery_that_tells_its_current(machine: Machine) -> None:
    machine(UPS_BOARD)
    assert read("battery_percent", machine) == 87.0
    assert read("battery_plugged", machine) == 0.0
    assert read("battery_voltage", machine) == 3.912
    assert read("battery_current", machine) == -1.25


def test_what_a_battery_does_not_tell_is_said(machine: Machine) -> None:
    machine({f"{POWER}/BAT0/capacity": "50", f"{POWER}/BAT0/status": "Unknown"})
    assert failure("battery_plugged", machine) == "this machine does not report whether its charger is connected"
    assert failure("battery_voltage", machine) == "the battery of this machine has no voltage_now"
    assert failure("battery_current", machine) == "the battery of this machine has no voltage_now"
    machine({f"{POWER}/BAT0/voltage_now": "ENODEV"})
    assert failure("battery_voltage", machine) == "the battery of this machine has no voltage_now"
    machine({f"{POWER}/BAT0/voltage_now": "0"})
    assert failure("battery_current", machine) == (
        "the battery of this machine has no current_now, and its voltage is 0"
    )


@pytest.mark.parametrize("kind", ["battery_percent", "battery_plugged", "battery_voltage", "battery_current"])
def test_a_machine_without_a_battery_says_so(machine: Machine, kind: str) -> None:
    machine()
    assert failure(kind, machine).startswith(f"no battery in {machine.paths.sys}/class/power_supply; set the source to")


def test_network_errors_and_drops_are_counted_per_second_in_both_directions(machine: Machine) -> None:
    machine(interfaces(eth0="7 100", wlan0="0 0"))
    errors, drops, both = (
        source("network_errors", machine, interface="eth0"),
        source("network_drops", machine, interface="eth0"),
        source("network_errors", machine),
    )
    for made in (errors, drops, both):
        with pytest.raises(NotMeasuredYet):
            made.read(10.0)
    machine(interfaces(eth0="13 100", wlan0="4 0"))
    assert errors.read(12.0) == 3.0
    assert drops.read(12.0) == 0.0
    assert both.read(12.0) == 5.0


def test_a_read_without_time_in_between_repeats_the_last_rate(machine: Machine) -> None:
    machine(interfaces(eth0="0 0"))
    errors = source("network_errors", machine, interface="eth0")
    with pytest.raises(NotMeasuredYet):
        errors.read(0.0)
    machine(interfaces(eth0="2 0"))
    assert [errors.read(1.0), errors.read(1.0)] == [2.0, 2.0]


def test_when_time_goes_back_a_rate_goes_on_from_there(machine: Machine) -> None:
    machine(interfaces(eth0="0 0"))
    errors = source("network_errors", machine, interface="eth0")
    with pytest.raises(NotMeasuredYet):
        errors.read(100.0)
    machine(interfaces(eth0="2 0"))
    assert errors.read(101.0) == 2.0
    assert errors.read(5.0) == 2.0
    machine(interfaces(eth0="3 0"))
    assert errors.read(6.0) == 1.0


def test_counters_that_begin_again_give_no_negative_rate(machine: Machine) -> None:
    machine(interfaces(eth0="500 0"))
    errors = source("network_errors", machine, interface="eth0")
    with pytest.raises(NotMeasuredYet):
        errors.read(0.0)
    machine(interfaces(eth0="1 0"))
    assert errors.read(1.0) == 0.0


def test_an_interface_that_is_unplugged_is_named_and_comes_back(machine: Machine) -> None:
    machine(interfaces(eth0="0 0", wlan0="0 0"))
    errors = source("network_errors", machine, interface="wlan0")
    with pytest.raises(NotMeasuredYet):
        errors.read(0.0)
    machine(interfaces(eth0="0 0", lo="0 0"))
    with pytest.raises(SensorError, match=r"^this machine has no network interface wlan0; available: eth0, lo$"):
        errors.read(1.0)
    machine(interfaces(eth0="0 0", wlan0="50 0"))
    with pytest.raises(NotMeasuredYet):
        errors.read(2.0)
    machine(interfaces(eth0="0 0", wlan0="51 0"))
    assert errors.read(3.0) == 1.0


def test_the_disk_of_this_machine_is_used_between_0_and_100_percent() -> None:
    assert 0.0 < read("disk_percent") < 100.0
    assert read("disk_free") > 0.0


def test_an_unmounted_disk_is_not_taken_for_the_one_that_contains_its_folder(tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    assert failure("disk_percent", path=str(folder)) == f"no disk is mounted at {folder}"
    missing = tmp_path / "missing"
    assert failure("disk_free", path=str(missing)) == f"no disk is mounted at {missing}"


def test_a_disk_is_asked_every_five_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    plain = os.statvfs
    monkeypatch.setattr(os, "statvfs", lambda path: (asked.append(path), plain(path))[1])
    computer = Computer()
    percent, free = (HOST_SOURCES[name].make(computer, path="/") for name in ("disk_percent", "disk_free"))
    for now_s in (0.0, 1.0, 4.9, 5.0, 6.0):
        percent.read(now_s)
        free.read(now_s)
    assert asked == ["/", "/"]


def test_the_options_that_a_machine_has(machine: Machine) -> None:
    machine(WORKSTATION, processors("1 1", "1 1"), interfaces(lo="0 0", eth0="0 0", can0="0 0"))
    offered: dict[str, list[Any]] = {
        kind: list(made.names(machine.paths))
        for kind, made in HOST_SOURCES.items()
        if kind in ("cpu_percent", "temperature", "network_errors", "network_drops")
    }
    assert offered == {
        "cpu_percent": [None, 0, 1],
        "temperature": [
            "", "coretemp/Package id 0", "coretemp/Core 0", "coretemp/Core 1", "nvme/Composite", "nvme/1", "acpitz/0",
        ],
        "network_errors": ["can0", "eth0"],
        "network_drops": ["can0", "eth0"],
    }  # fmt: skip


def test_this_machine_has_a_root_disk() -> None:
    assert "/" in list(HOST_SOURCES["disk_percent"].names(HOST_PATHS))


def test_a_metric_that_vanishes_turns_stale_and_comes_back_while_the_others_go_on(machine: Machine) -> None:
    machine(WORKSTATION, MEMORY)
    bus = LocalBus()
    signals = {"board": {"unit": "degC", "warn_above": 60.0}, "memory": {"unit": "%", "warn_above": 90.0}}
    alerts: list[tuple[str, str]] = []
    AlertSystem(bus.node("alert_system", parameters={"signals": signals}), {"test": levels_to(alerts)})
    off = {metric: {"source": "none"} for metric in ("battery_level", "temperature", "cpu_usage")}
    host = {
        "board": {"source": "temperature", "sensor": "acpitz/0"},
        "memory": {"source": "memory_percent"},
        "nothing": {"source": "swap_percent"},
    }
    machine(NO_SWAP)
    BatterySensor(bus.node("battery_sensor", parameters={**off, "host": host}), machine.computer)
    bus.run_until(10.0)
    assert alerts == []
    machine({path: None for path in WORKSTATION if "hwmon3" in path})
    bus.run_until(20.0)
    assert alerts == [("board", "STALE")]
    machine(WORKSTATION)
    bus.run_until(22.0)
    assert alerts == [("board", "STALE"), ("board", "OK")]
    said = [
        (line.severity, line.text.partition(":")[0])
        for line in bus.log_lines
        if line.node == "/battery_sensor" and "started" not in line.text
    ]
    assert said == [
        (Severity.WARN, "nothing is not published"),
        (Severity.WARN, "board is not published"),
        (Severity.INFO, "board can be read again"),
    ]


def test_a_rate_that_is_not_measured_yet_is_no_failure(machine: Machine) -> None:
    machine(interfaces(eth0="0 0"))
    bus = LocalBus()
    off = {metric: {"source": "none"} for metric in ("battery_level", "temperature", "cpu_usage")}
    host = {"errors": {"source": "network_errors", "interface": "eth0"}}
    heard: list[float] = []
    bus.node("listener").subscribe("errors", "std_msgs/Float32", lambda value, now_s: heard.append(value), field="data")
    BatterySensor(bus.node("battery_sensor", parameters={**off, "host": host}), machine.computer)
    bus.run_until(1.0)
    machine(interfaces(eth0="5 0"))
    bus.run_until(3.0)
    assert heard == [5.0, 0.0]
    assert [line.text for line in bus.log_lines if line.severity > Severity.INFO] == []
