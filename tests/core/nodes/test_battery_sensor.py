"""battery_sensor on the in-process middleware, in virtual time."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, Mapping

import pytest
from harness.machine import Machine
from harness.machines import LAPTOP, chip
from harness.parameters import set_parameter
from harness.port_conformance import levels_to
from harness.stage import Stage, status, values_of
from harness.waiting import wait_for

from robot_health_monitor.core.config.parameters import flatten, unflatten
from robot_health_monitor.core.nodes import AlertSystem, BatterySensor
from robot_health_monitor.core.port.local import LocalMiddleware
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.sensors import configuration
from robot_health_monitor.core.sensors.computer import HOST_PATHS, Computer, HostPaths
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.runtime.threads import DetachedCalls

BATTERY = {
    "/sys/class/power_supply/BAT0/capacity": "62",
    "/sys/class/power_supply/BAT0/status": "Discharging",
}
TEMPERATURE = {"/sys/class/hwmon/hwmon0/name": "cpu_thermal", "/sys/class/hwmon/hwmon0/temp1_input": "48680"}
HOST = {"battery_level": {"source": "host"}, "temperature": {"source": "host"}, "cpu_usage": {"source": "none"}}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.fixture
def stage() -> Stage:
    return Stage()


def start(stage: Stage, parameters: Mapping[str, Any], paths: HostPaths = HOST_PATHS) -> LocalMiddleware:
    middleware = stage.bus.node("battery_sensor", parameters=parameters)
    BatterySensor(middleware, Computer(paths))
    return middleware


def test_the_battery_loses_1_percent_per_second_and_is_published_at_1_hz(stage: Stage) -> None:
    levels = stage.listen("battery_level", "data")
    start(stage, {})
    stage.bus.run_until(4.0)
    assert levels == [100.0, 99.0, 98.0, 97.0]


def test_another_rate_takes_effect_and_does_not_charge_the_battery(stage: Stage) -> None:
    levels = stage.listen("battery_level", "data")
    middleware = start(stage, {})
    stage.bus.run_until(3.0)
    set_parameter(middleware, "publish_rate", 2.0)
    stage.bus.run_until(4.0)
    assert levels == [100.0, 99.0, 98.0, 97.5, 97.0]


def test_defaults_that_a_middleware_fills_in_are_no_change(stage: Stage) -> None:
    levels = stage.listen("battery_level", "data")
    middleware = start(stage, {})
    stage.bus.run_until(3.0)
    defaults = {
        f"{metric}.{parameter.name}": parameter.default
        for metric, parameters in configuration.METRIC_PARAMETERS.items()
        for parameter in parameters
    }
    middleware.set_parameters(unflatten({**dict(flatten({"sensor_name": "other"})), **defaults}))
    stage.bus.run_until(4.0)
    assert levels == [100.0, 99.0, 98.0, 97.0]


HANGING = {
    "rail": ({"source": "voltage_rail", "sensor": "pmbus/in2"}, "/sys/class/hwmon/hwmon3/in2_input", 5.0),
    "fan": ({"source": "fan_rpm"}, "/sys/class/hwmon/hwmon1/fan2_input", 5000.0),
    "nvme": ({"source": "temperature", "sensor": "nvme/Composite"}, "/sys/class/hwmon/hwmon2/temp1_input", 5.0),
    "volts": ({"source": "battery_voltage"}, "/sys/class/power_supply/BAT0/voltage_now", 0.005),
    "pressure": ({"source": "pressure_io"}, "/proc/pressure/io", None),
}
"""Sources whose files never answer, and what they read if that is 5000."""
ANSWERING = {
    "other_rail": {"source": "voltage_rail", "sensor": "pmbus/in1"},
    "cpu": {"source": "temperature"},
    "board": {"source": "temperature", "sensor": "thinkpad/0"},
    "charge": {"source": "battery_percent"},
    "amperes": {"source": "battery_current"},
    "waiting": {"source": "pressure_cpu"},
    "kills": {"source": "oom_kills"},
    "carrier": {"source": "network_carrier"},
}


@pytest.fixture
def hanging_machine(machine: Machine) -> Machine:
    """A laptop on which some files of the kernel never answer, as when an I2C bus hangs."""
    machine(LAPTOP, chip(3, "pmbus", in1="12000", in2="5000"))
    for _, path, _ in HANGING.values():
        file = machine.root / path.lstrip("/")
        file.unlink()
        os.mkfifo(file)
    return machine


def test_files_that_never_answer_are_stale_and_delay_no_other_metric(stage: Stage, hanging_machine: Machine) -> None:
    others = threading.active_count()  # of tests before this one
    host = {**{name: options for name, (options, _, _) in HANGING.items()}, **ANSWERING}
    off = {metric: {"source": "none"} for metric in configuration.METRICS}
    heard = {name: stage.listen(name, "data") for name in host}
    alerts: list[tuple[str, str]] = []
    stage.alert_system({"signals": {name: {} for name in host}}, {"test": levels_to(alerts)})
    calls = DetachedCalls("test", patience_s=0.2)
    computer = Computer(hanging_machine.paths, calls)
    BatterySensor(stage.bus.node("battery_sensor", parameters={**off, "host": host}), computer)
    stage.bus.run_until(20.0)
    counts = {name: len(values) for name, values in heard.items()}
    assert counts == {**dict.fromkeys(HANGING, 0), **dict.fromkeys(ANSWERING, 20)}
    (alert,) = alerts  # one for all: they were never heard
    assert alert == (f"/{next(iter(HANGING))}", "STALE")
    assert "volts is not published: no answer from the battery for more than 5 s" in stage.log(Severity.WARN)
    assert threading.active_count() - others < 11  # a thread per file that hangs, however often it is read
    for _, path, _ in HANGING.values():
        (hanging_machine.root / path.lstrip("/")).write_text("5000\n" if "pressure" not in path else "some avg10=1.5\n")
    wait_for(lambda: all(each.is_set() for each in calls._running))
    stage.bus.run_until(21.0)
    expected = {name: value for name, (_, _, value) in HANGING.items()}
    assert {name: heard[name][0] for name in HANGING} == pytest.approx({**expected, "pressure": 1.5})
    calls.close()


def test_files_that_never_answer_delay_neither_the_list_of_sources_nor_its_end(hanging_machine: Machine) -> None:
    code = """
import sys
from robot_health_monitor.cli.commands.sources_command import show_sources
from robot_health_monitor.core.sensors.computer import Computer, HostPaths
from robot_health_monitor.runtime.threads import DetachedCalls
show_sources(False, sys.stdout, Computer(HostPaths(*sys.argv[1:]), DetachedCalls("sources")))
"""
    arguments = [sys.executable, "-c", code, *hanging_machine.paths]
    done = subprocess.run(arguments, stdout=subprocess.PIPE, text=True, timeout=60, check=True)
    lines = done.stdout.splitlines()
    assert "{source: battery_percent}: 55 %" in lines
    assert "{source: battery_voltage}: no answer from the battery yet" in lines
    assert "{source: voltage_rail, sensor: pmbus/in1}: 12 V" in lines
    assert "{source: voltage_rail, sensor: pmbus/in2}: no answer from the voltage sensor yet" in lines


def test_a_node_that_dies_is_an_alert_and_its_other_metrics_are_stale(stage: Stage, machine: Machine) -> None:
    machine({"/proc/uptime": "100.0 1.0"})
    machine.runs(1, "/sbin/init")
    machine.runs(70, "/x/amcl")
    host = {
        "running": {"source": "process_running", "command": "*/amcl*"},
        "threads": {"source": "process_threads", "command": "*/amcl*"},
    }
    off = {metric: {"source": "none"} for metric in configuration.METRICS}
    alerts: list[tuple[str, str]] = []
    signals = {"running": {"error_below": 0.5}, "threads": {"warn_above": 10.0}}
    stage.alert_system({"signals": signals}, {"test": levels_to(alerts)})
    BatterySensor(stage.bus.node("battery_sensor", parameters={**off, "host": host}), machine.computer)
    stage.bus.run_until(10.0)
    assert alerts == []
    shutil.rmtree(machine.root / "proc" / "70")
    stage.bus.run_until(20.0)
    assert alerts == [("running", "ERROR"), ("threads", "STALE")]
    machine.runs(70, "/x/amcl")
    stage.bus.run_until(22.0)
    assert alerts[2:] == [("running", "OK"), ("threads", "OK")]


def test_a_metric_without_a_source_is_not_published(stage: Stage) -> None:
    levels, temperatures = stage.listen("battery_level", "data"), stage.listen("temperature", "data")
    start(stage, {"battery_level": {"source": "none"}})
    stage.bus.run_until(2.0)
    assert levels == []
    assert len(temperatures) == 2


def test_simulated_values_are_marked_in_the_log_and_on_diagnostics(stage: Stage) -> None:
    arrays = stage.listen("/diagnostics")
    start(stage, {"temperature": {"source": "none"}, "robot_name": "robot1"})
    stage.bus.run_until(3.0)
    assert stage.log(Severity.WARN) == ["simulated values: battery_level, cpu_usage"]
    own = status(arrays[-1], "battery_sensor: sensors")
    assert (own["level"], own["hardware_id"]) == (0, "robot1")
    assert values_of(own) == {
        "simulated": "true",
        "battery_level": "simulated",
        "temperature": "none",
        "cpu_usage": "simulated",
        "published_topics": "/_simulated_sensors, /battery_level, /cpu_usage",
        "fingerprint": values_of(own)["fingerprint"],
    }


def test_values_of_the_host_are_not_marked(stage: Stage, machine: Machine) -> None:
    machine(BATTERY, TEMPERATURE)
    levels, arrays = stage.listen("battery_level", "data"), stage.listen("/diagnostics")
    start(stage, HOST, machine.paths)
    stage.bus.run_until(2.0)
    assert levels == [62.0, 62.0]
    assert stage.log(Severity.WARN) == []
    assert values_of(status(arrays[-1], "battery_sensor: sensors"))["simulated"] == "false"


def test_a_host_without_a_battery_publishes_the_rest_reports_it_once_and_raises_no_alert(
    stage: Stage, machine: Machine
) -> None:
    machine(TEMPERATURE)
    alerts, temperatures = stage.listen("alerts"), stage.listen("temperature", "data")
    arrays = stage.listen("/diagnostics")
    signals = {"battery_level": {"warn_below": 20.0}, "temperature": {"warn_above": 80.0}}
    AlertSystem(stage.bus.node("alert_system", parameters={"signals": signals}))
    start(stage, HOST, machine.paths)
    stage.bus.run_until(60.0)
    assert len(temperatures) == 60
    assert alerts == []
    (line,) = stage.log(Severity.WARN, Severity.ERROR)
    assert line.startswith("battery_level is not published: no battery in ")
    own = status(arrays[-1], "battery_sensor: sensors")
    assert own["level"] == 0
    assert values_of(own)["battery_level"].startswith("not published: no battery in ")


def test_only_a_missing_sensor_that_was_asked_for_by_name_is_a_warning(stage: Stage, machine: Machine) -> None:
    machine(BATTERY, TEMPERATURE)
    start(stage, {**HOST, "host_preset": "standard", "host": {"wifi_signal": {"source": "wifi_signal"}}}, machine.paths)
    stage.bus.run_until(5.0)
    missing = "wifi_signal is not published: no Wi-Fi", "throttled is not published: no Raspberry Pi"
    for severity, wanted in ((Severity.WARN, missing[0]), (Severity.INFO, missing[1])):
        assert [line[: len(wanted)] for line in stage.log(severity) if line.startswith(missing)] == [wanted]


def test_a_source_that_fails_unexpectedly_stops_no_other(stage: Stage, machine: Machine) -> None:
    """A driver that reports a charge of 400 digits: more than a double holds."""
    machine(BATTERY, TEMPERATURE)
    machine({"/sys/class/power_supply/BAT0/capacity": "9" * 400})
    temperatures = stage.listen("temperature", "data")
    start(stage, HOST, machine.paths)
    stage.bus.run_until(5.0)
    assert len(temperatures) == 5
    (line,) = stage.log(Severity.WARN, Severity.ERROR)
    assert line == "battery_level is not published: the battery of this machine has no capacity"


def test_a_battery_that_is_removed_is_an_alert(stage: Stage, machine: Machine) -> None:
    machine(BATTERY, TEMPERATURE)
    arrays = stage.listen("/diagnostics")
    AlertSystem(stage.bus.node("alert_system", parameters={"signals": {"battery_level": {"warn_below": 20.0}}}))
    start(stage, HOST, machine.paths)
    stage.bus.run_until(5.0)
    machine(dict.fromkeys(BATTERY))
    (machine.root / "sys/class/power_supply/BAT0").rmdir()
    stage.bus.run_until(20.0)
    assert [text.partition(":")[0] for text in stage.log(Severity.WARN)] == [
        "battery_level is not published",
        "battery_level STALE",
    ]
    assert status(arrays[-1], "battery_sensor: sensors")["level"] == 1
    assert status(arrays[-1], "battery_sensor: sensors")["message"] == "cannot read battery_level"


def test_the_list_of_missing_sensors_is_published_only_for_a_host(stage: Stage, machine: Machine) -> None:
    start(stage, {})
    stage.bus.run_until(2.0)
    assert "/_unavailable_sensors" not in stage.bus.graph().topics
    other = Stage()
    missing = other.listen("_unavailable_sensors", "data")
    start(other, HOST, machine.paths)
    other.bus.run_until(3.0)
    assert missing[-1] == "battery_level, temperature"


def test_the_topics_of_simulated_values_are_listed_before_the_first_value_and_every_second(stage: Stage) -> None:
    listed: list[Any] = []
    stage.outside.subscribe("_simulated_sensors", "", lambda value, now_s: listed.append(value), field="data")
    node = stage.bus.node("battery_sensor", parameters={"cpu_usage": {"source": "host"}}, remap={"/temperature": "/t"})
    BatterySensor(node)
    assert listed == ["/battery_level, /t"]
    stage.bus.run_until(3.0)
    assert listed == ["/battery_level, /t"] * 4
    late: list[Any] = []
    stage.bus.node("late").subscribe(
        "_simulated_sensors", "", lambda value, now_s: late.append(value), field="data", latched=True
    )
    assert late == ["/battery_level, /t"]


def test_values_that_are_no_longer_simulated_are_no_longer_listed(stage: Stage, machine: Machine) -> None:
    listed = stage.listen("_simulated_sensors", "data")
    middleware = start(stage, {"temperature": {"source": "none"}, "cpu_usage": {"source": "none"}}, machine.paths)
    set_parameter(middleware, "battery_level.source", "host")
    assert listed == ["/battery_level", ""]


def test_the_response_of_a_change_lists_what_changed(stage: Stage) -> None:
    middleware = start(stage, {})
    assert set_parameter(middleware, "temperature.mean", 50.0) == "temperature.mean: 60 -> 50"
    assert set_parameter(middleware, "temperature.mean", 50.0) == "nothing changed"
    changes = middleware.set_parameters(
        {"temperature": {"mean": 50.0}, "host": {"memory": {"source": "memory_percent"}}, "publish_rate": 2.0}
    )
    assert changes == "publish_rate: 1 -> 2; added memory"
    with pytest.raises(ConfigError, match="robot_name"):
        set_parameter(middleware, "robot_name", "other")
