"""The metrics of a machine, read from the files of other machines in a temporary folder.

The trees follow the kernel's Documentation/hwmon/sysfs-interface, Documentation/ABI/testing/sysfs-class-power and
proc(5): temperatures in thousandths of a degree, one value per file.
"""

from __future__ import annotations

import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import Computer
from robot_health_monitor.core.sensors.disks import mount_points
from robot_health_monitor.core.sensors.host import battery_percent, temperature
from robot_health_monitor.core.sensors.source import NotMeasuredYet, SensorError, Source

psutil = pytest.importorskip("psutil")

HWMON = "/sys/class/hwmon"
THERMAL = "/sys/class/thermal"
POWER = "/sys/class/power_supply"

INTEL_LAPTOP = {
    f"{HWMON}/hwmon0/name": "acpitz",
    f"{HWMON}/hwmon0/temp1_input": "27800",
    f"{HWMON}/hwmon1/name": "nvme",
    f"{HWMON}/hwmon1/temp1_input": "61850",
    f"{HWMON}/hwmon1/temp1_label": "Composite",
    f"{HWMON}/hwmon1/temp1_max": "83850",
    f"{HWMON}/hwmon1/temp1_min": "-273150",
    f"{HWMON}/hwmon1/temp2_input": "61850",
    f"{HWMON}/hwmon1/temp2_max": "65261850",
    f"{HWMON}/hwmon2/name": "coretemp",
    f"{HWMON}/hwmon2/temp1_input": "52000",
    f"{HWMON}/hwmon2/temp1_label": "Package id 0",
    f"{HWMON}/hwmon2/temp1_crit": "100000",
    f"{HWMON}/hwmon2/temp2_input": "53000",
    f"{HWMON}/hwmon2/temp2_label": "Core 0",
    f"{HWMON}/hwmon2/temp3_input": "49000",
    f"{HWMON}/hwmon2/temp3_label": "Core 1",
    f"{HWMON}/hwmon3/name": "thinkpad",
    f"{HWMON}/hwmon3/temp1_input": "52000",
    f"{HWMON}/hwmon3/temp2_input": "",
    f"{HWMON}/hwmon3/temp3_input": "-128000",
}
AMD_DESKTOP = {
    f"{HWMON}/hwmon0/name": "nct6798",
    f"{HWMON}/hwmon0/temp1_input": "33000",
    f"{HWMON}/hwmon0/temp4_input": "127000",
    f"{HWMON}/hwmon0/temp8_input": "0",
    f"{HWMON}/hwmon1/name": "amdgpu",
    f"{HWMON}/hwmon1/temp1_input": "71000",
    f"{HWMON}/hwmon2/name": "k10temp",
    f"{HWMON}/hwmon2/temp1_input": "55125",
    f"{HWMON}/hwmon2/temp1_label": "Tctl",
}
RASPBERRY_PI = {
    f"{HWMON}/hwmon0/name": "cpu_thermal",
    f"{HWMON}/hwmon0/temp1_input": "48680",
    f"{HWMON}/hwmon1/name": "rpi_volt",
    f"{HWMON}/hwmon1/in0_lcrit_alarm": "0",
}
JETSON_NANO = {
    f"{THERMAL}/thermal_zone0/type": "AO-therm",
    f"{THERMAL}/thermal_zone0/temp": "46500",
    f"{THERMAL}/thermal_zone1/type": "CPU-therm",
    f"{THERMAL}/thermal_zone1/temp": "37500",
    f"{THERMAL}/thermal_zone2/type": "PMIC-Die",
    f"{THERMAL}/thermal_zone2/temp": "100000",
}
BOARD_WITHOUT_CPU_SENSOR = {
    f"{HWMON}/hwmon0/name": "acpitz",
    f"{HWMON}/hwmon0/temp1_input": "41000",
    f"{HWMON}/hwmon1/name": "nvme",
    f"{HWMON}/hwmon1/temp1_input": "39850",
}
ONLY_PLACEHOLDERS = {
    f"{HWMON}/hwmon0/name": "acpitz",
    f"{HWMON}/hwmon0/temp1_input": "0",
    f"{HWMON}/hwmon1/name": "nct6798",
    f"{HWMON}/hwmon1/temp1_input": "-273150",
    f"{HWMON}/hwmon1/temp2_input": "127500",
}
LAPTOP_BATTERY = {
    f"{POWER}/AC/online": "0",
    f"{POWER}/AC/type": "Mains",
    f"{POWER}/BAT0/capacity": "62",
    f"{POWER}/BAT0/energy_full": "50220000",
    f"{POWER}/BAT0/energy_now": "31390000",
    f"{POWER}/BAT0/power_now": "7421000",
    f"{POWER}/BAT0/status": "Discharging",
    f"{POWER}/BAT0/type": "Battery",
}
GAMEPAD_BATTERY = {
    f"{POWER}/ps-controller-battery-a4:53:85:01:02:03/capacity": "15",
    f"{POWER}/ps-controller-battery-a4:53:85:01:02:03/scope": "Device",
    f"{POWER}/ps-controller-battery-a4:53:85:01:02:03/status": "Discharging",
    f"{POWER}/ps-controller-battery-a4:53:85:01:02:03/type": "Battery",
}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def stat(user: int, idle: int, iowait: int = 0, guest: int = 0) -> Any:
    """Returns /proc/stat of a machine with one processor; the numbers are ticks of 10 ms."""
    ticks = f"{user} 0 0 {idle} {iowait} 0 0 0 {guest} 0"
    return {"/proc/stat": f"cpu  {ticks}\ncpu0 {ticks}\nbtime 1700000000"}


def cpu(computer: Computer) -> Source:
    """Returns the source of the CPU load after its first read."""
    source = HOST_SOURCES["cpu_percent"].make(computer)
    with pytest.raises(NotMeasuredYet):
        source.read(0.0)
    return source


def percent(number: int) -> Any:
    """Returns what compares equal to a percentage of counters that are floats."""
    return pytest.approx(number, abs=1e-9)


@pytest.mark.parametrize(
    ("tree", "celsius"),
    [
        pytest.param(INTEL_LAPTOP, 53.0, id="hottest of coretemp, though the disk is hotter"),
        pytest.param(AMD_DESKTOP, 55.125, id="k10temp, though the graphics card is hotter"),
        pytest.param(RASPBERRY_PI, 48.68, id="cpu_thermal"),
        pytest.param(JETSON_NANO, 37.5, id="thermal zones where there is no hwmon; PMIC-Die is a placeholder"),
        pytest.param(BOARD_WITHOUT_CPU_SENSOR, 41.0, id="hottest of all where no chip is the CPU's"),
    ],
)
def test_temperature_is_that_of_the_cpu_where_there_is_one(machine: Machine, tree: Any, celsius: float) -> None:
    machine(tree)
    assert temperature(machine.paths) == celsius


def test_temperature_follows_the_files(machine: Machine) -> None:
    machine(RASPBERRY_PI)
    assert temperature(machine.paths) == 48.68
    machine({f"{HWMON}/hwmon0/temp1_input": "81230"})
    assert temperature(machine.paths) == 81.23


def test_placeholders_are_not_taken_for_temperatures(machine: Machine) -> None:
    machine(ONLY_PLACEHOLDERS)
    with pytest.raises(SensorError) as caught:
        temperature(machine.paths)
    line = str(caught.value)
    assert line.startswith("no plausible temperature: ")
    assert "acpitz/0 reads 0.0" in line
    assert "\n" not in line


def test_a_placeholder_beside_a_measurement_does_not_hide_it(machine: Machine) -> None:
    machine(ONLY_PLACEHOLDERS, {f"{HWMON}/hwmon2/name": "nvme", f"{HWMON}/hwmon2/temp1_input": "38850"})
    assert temperature(machine.paths) == 38.85


def test_frost_is_a_temperature(machine: Machine) -> None:
    machine({f"{HWMON}/hwmon0/name": "cpu_thermal", f"{HWMON}/hwmon0/temp1_input": "-12500"})
    assert temperature(machine.paths) == -12.5


def test_a_machine_without_temperature_sensors_says_so(machine: Machine) -> None:
    machine()
    with pytest.raises(
        SensorError, match=r"^this machine has no temperature sensor, or no driver for it; set the source"
    ):
        temperature(machine.paths)


def test_battery_is_the_charge_in_percent(machine: Machine) -> None:
    machine(LAPTOP_BATTERY)
    assert battery_percent(machine.paths) == pytest.approx(62.5, abs=0.05)  # 31.39 Wh of 50.22 Wh


def test_battery_that_shows_its_capacity_only_is_read_too(machine: Machine) -> None:
    machine({f"{POWER}/BAT1/capacity": "7", f"{POWER}/BAT1/status": "Discharging"})
    assert battery_percent(machine.paths) == 7.0


def test_battery_that_holds_more_than_its_nominal_charge_is_full(machine: Machine) -> None:
    machine({**LAPTOP_BATTERY, f"{POWER}/BAT0/energy_now": "50900000"})
    assert battery_percent(machine.paths) == 100.0


@pytest.mark.parametrize("tree", [pytest.param({}, id="none"), pytest.param(GAMEPAD_BATTERY, id="a gamepad's")])
def test_a_machine_without_its_own_battery_reports_it(machine: Machine, tree: Any) -> None:
    machine(tree)
    with pytest.raises(SensorError, match=r"^no battery in .*/sys/class/power_supply; set"):
        battery_percent(machine.paths)


def test_the_gamepad_does_not_hide_the_battery_of_the_machine(machine: Machine) -> None:
    machine(GAMEPAD_BATTERY, LAPTOP_BATTERY)
    assert battery_percent(machine.paths) == pytest.approx(62.5, abs=0.05)


def test_cpu_usage_is_what_was_busy_since_the_read_before(machine: Machine) -> None:
    machine(stat(user=1000, idle=9000))
    source = cpu(machine.computer)
    machine(stat(user=1030, idle=9070))
    assert source.read(1.0) == percent(30)
    machine(stat(user=1130, idle=9070))
    assert source.read(2.0) == percent(100)


def test_waiting_for_the_disk_is_not_being_busy(machine: Machine) -> None:
    machine(stat(user=0, idle=0))
    source = cpu(machine.computer)
    machine(stat(user=25, idle=50, iowait=25))
    assert source.read(1.0) == percent(25)


def test_the_time_of_guests_is_not_counted_twice(machine: Machine) -> None:
    machine(stat(user=0, idle=0))
    source = cpu(machine.computer)
    machine(stat(user=50, idle=50, guest=50))  # proc(5): guest time is part of user time
    assert source.read(1.0) == percent(50)


def test_before_anything_was_measured_there_is_no_cpu_usage_instead_of_a_zero(machine: Machine) -> None:
    machine(stat(user=1000, idle=9000))
    source = HOST_SOURCES["cpu_percent"].make(machine.computer)
    with pytest.raises(NotMeasuredYet, match=r"^not measured yet"):
        source.read(0.0)
    with pytest.raises(NotMeasuredYet):
        source.read(1.0)  # no tick of the kernel has passed
    machine(stat(user=1050, idle=9050))
    assert source.read(2.0) == percent(50)
    assert source.read(3.0) == percent(50)  # nor here


def test_a_read_without_time_in_between_repeats_the_last_cpu_usage(machine: Machine) -> None:
    machine(stat(user=0, idle=0))
    source = cpu(machine.computer)
    machine(stat(user=40, idle=60))
    assert [source.read(1.0), source.read(1.0)] == [percent(40), percent(40)]


def test_a_counter_that_steps_back_gives_no_impossible_cpu_usage(machine: Machine) -> None:
    machine(stat(user=0, idle=0, iowait=50))
    source = cpu(machine.computer)
    machine(stat(user=20, idle=80, iowait=49))
    assert source.read(1.0) == percent(20)


def test_cpu_usage_may_be_read_in_another_thread_than_the_one_that_made_it(machine: Machine) -> None:
    machine(stat(user=0, idle=0))
    source = cpu(machine.computer)
    machine(stat(user=70, idle=30))
    seen: list[float] = []
    thread = threading.Thread(target=lambda: seen.append(source.read(1.0)))
    thread.start()
    thread.join(10.0)
    assert seen == [percent(70)]


def test_without_psutil_the_disks_cannot_be_listed_and_the_others_are_read(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine(INTEL_LAPTOP, LAPTOP_BATTERY, stat(user=0, idle=0))
    monkeypatch.setitem(sys.modules, "psutil", None)
    with pytest.raises(SensorError, match=r"^psutil is not installed.*python3-psutil"):
        mount_points(machine.paths)
    load = cpu(machine.computer)
    machine(stat(user=10, idle=90))
    assert load.read(1.0) == percent(10)
    assert temperature(machine.paths) == 53.0
    assert battery_percent(machine.paths) == pytest.approx(62.5, abs=0.05)


def test_a_proc_that_cannot_be_read_costs_the_reading_and_is_named(machine: Machine) -> None:
    machine()
    source = HOST_SOURCES["cpu_percent"].make(machine.computer)
    with pytest.raises(SensorError, match=r"^the CPU cannot be read: FileNotFoundError: .*/proc/stat"):
        source.read(0.0)
    machine(stat(user=0, idle=0))
    with pytest.raises(NotMeasuredYet):
        source.read(1.0)
    machine(stat(user=10, idle=90))
    assert source.read(2.0) == percent(10)


@pytest.mark.parametrize(
    "content", ["", "cpu", "cpu  1 2 3", "cpu  a b c d e", "cpu0 1 2 3 4 5", "intr 5", "cpux 1 2 3 4 5\ncpu  1 2 3 4 5"]
)
def test_counters_of_another_form_are_an_error(machine: Machine, content: str) -> None:
    machine({"/proc/stat": content})
    source = HOST_SOURCES["cpu_percent"].make(machine.computer)
    with pytest.raises(SensorError, match=r"^the CPU cannot be read: "):
        source.read(0.0)


def test_the_load_of_this_machine_is_a_percentage() -> None:
    source = cpu(Computer())
    busy_until_s = sum(psutil.cpu_times()) + 0.1
    while sum(psutil.cpu_times()) < busy_until_s:
        pass
    assert 0.0 <= source.read(1.0) <= 100.0
