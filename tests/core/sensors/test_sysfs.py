"""The kernel's files of several machines; test_host.py and test_catalogue.py have the sources that read them."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness.machine import Machine

from robot_health_monitor.core.sensors.host import battery_percent, battery_plugged, find_sensors, temperature
from robot_health_monitor.core.sensors.source import NoSuchSensor, SensorError

HWMON = "/sys/class/hwmon"
POWER = "/sys/class/power_supply"


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_sensors_are_in_the_order_of_their_numbers(machine: Machine) -> None:
    tree: dict[str, str] = {}
    for chip in (10, 2):
        tree[f"{HWMON}/hwmon{chip}/name"] = "nvme"
        for sensor in (10, 9, 1):
            tree[f"{HWMON}/hwmon{chip}/temp{sensor}_input"] = str(chip * 1000 + sensor * 100)
    machine(tree)
    found = [temperature(machine.paths, f"nvme/{number}") for number in range(6)]
    assert found == [2.1, 2.9, 3.0, 10.1, 10.9, 11.0]


def test_sensors_in_the_folder_of_the_device_are_read_where_the_chip_has_none(machine: Machine) -> None:
    machine({f"{HWMON}/hwmon0/device/name": "it87", f"{HWMON}/hwmon0/device/temp1_input": "41000"})
    assert temperature(machine.paths, "it87/0") == 41.0


@pytest.mark.parametrize("text", ["", "N/A", "1e"])
def test_a_sensor_without_a_number_does_not_hide_the_others(machine: Machine, text: str) -> None:
    machine({f"{HWMON}/hwmon0/temp1_input": text, f"{HWMON}/hwmon0/temp2_input": "41000"})
    assert temperature(machine.paths) == temperature(machine.paths, "unknown/1") == 41.0
    with pytest.raises(SensorError, match=r"^no plausible temperature: unknown/0 reads no number; set the source"):
        temperature(machine.paths, "unknown/0")


def test_a_label_that_is_no_text_is_readable(machine: Machine) -> None:
    machine({f"{HWMON}/hwmon0/name": "chip", f"{HWMON}/hwmon0/temp1_input": "41000"})
    (machine.root / "sys/class/hwmon/hwmon0/temp1_label").write_bytes(b"\xff\xfe\n")
    assert [*find_sensors(machine.paths, "temp")] == ["chip/" + "\N{REPLACEMENT CHARACTER}" * 2]


def test_a_machine_without_sys_has_no_sensors(tmp_path: Path, machine: Machine) -> None:
    paths = machine.paths._replace(sys=str(tmp_path / "missing"))
    assert find_sensors(paths, "temp") == {}
    with pytest.raises(NoSuchSensor, match=r"no battery in .*/missing/class/power_supply"):
        battery_percent(paths)


def test_the_battery_of_a_gamepad_is_not_that_of_the_machine(machine: Machine) -> None:
    gamepad = {f"{POWER}/BATTERY_pad/capacity": "15", f"{POWER}/BATTERY_pad/scope": "Device"}
    machine(gamepad)
    with pytest.raises(NoSuchSensor):
        battery_percent(machine.paths)
    machine({f"{POWER}/battery/capacity": "87", f"{POWER}/battery/scope": "System"})
    assert battery_percent(machine.paths) == 87.0


@pytest.mark.parametrize(
    ("files", "percent"),
    [
        ({"charge_now": "3000", "charge_full": "4000", "capacity": "70"}, 75.0),
        ({"energy_now": "3000", "energy_full": "0", "capacity": "70"}, 70.0),
        ({"energy_now": "5000", "energy_full": "4000"}, 100.0),
        ({"capacity": "104"}, 100.0),
    ],
)
def test_the_charge_is_that_of_the_most_precise_files(machine: Machine, files: dict[str, str], percent: float) -> None:
    machine({f"{POWER}/BAT0/{name}": text for name, text in files.items()})
    assert battery_percent(machine.paths) == percent


def test_a_battery_without_a_charge_is_an_error_but_not_a_missing_sensor(machine: Machine) -> None:
    machine({f"{POWER}/BAT0/status": "Unknown"})
    with pytest.raises(SensorError, match="has no capacity") as caught:
        battery_percent(machine.paths)
    assert not isinstance(caught.value, NoSuchSensor)


@pytest.mark.parametrize(
    ("files", "is_plugged"),
    [
        ({"ADP1/online": "1", "ADP1/type": "Mains", "BAT0/status": "Discharging"}, True),
        ({"ADP1/online": "0", "ADP1/type": "Mains", "BAT0/status": "Full"}, False),
        ({"BAT0/status": "Full"}, True),
        ({"BAT0/status": "Charging"}, True),
        ({"BAT0/status": "Discharging"}, False),
        ({"usb/online": "1", "usb/type": "USB", "BAT0/status": "Discharging"}, False),
    ],
)
def test_the_charger_is_connected_if_its_supply_or_the_battery_says_so(
    machine: Machine, files: dict[str, str], is_plugged: bool
) -> None:
    machine({f"{POWER}/{name}": text for name, text in files.items()})
    assert battery_plugged(machine.paths) == is_plugged
