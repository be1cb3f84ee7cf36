"""battery_sensor on the in-process middleware, in virtual time."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, Callable, List, Mapping, Tuple

import pytest
from harness.machine import Machine
from harness.parameters import set_parameter
from harness.port_conformance import levels_to
from harness.stage import Stage, status, values_of

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LocalMiddleware
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.nodes import AlertSystem, BatterySensor
from robot_health_monitor.core.parameters import flatten, unflatten
from robot_health_monitor.core.sensors import configuration
from robot_health_monitor.core.sensors.computer import HOST_PATHS, Computer, HostPaths

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


def test_a_disk_that_hangs_is_stale_and_delays_no_other_metric(stage: Stage, machine: Machine) -> None:
    machine({"/proc/vmstat": "nr_free_pages 1\noom_kill 0"})
    started: List[Callable[[], None]] = []

    def background(function: Callable[[], None]) -> bool:
        """A thread whose disk hangs from the second read on, until it is let go on."""
        started.append(function)
        if len(started) != 2:
            function()
        return len(started) != 2

    host = {"disk": {"source": "disk_free"}, "kills": {"source": "oom_kills"}}
    off = {metric: {"source": "none"} for metric in configuration.METRICS}
    disk, kills = stage.listen("disk", "data"), stage.listen("kills", "data")
    alerts: List[Tuple[str, str]] = []
    stage.alert_system({"signals": {"disk": {}, "kills": {}}}, {"test": levels_to(alerts)})
    node = stage.bus.node("battery_sensor", parameters={**off, "host": host})
    BatterySensor(node, Computer(machine.paths, background))
    stage.bus.run_until(20.0)
    assert (len(disk), len(kills)) == (5, 20)
    assert alerts == [("disk", "STALE")]
    line = "disk is not published: no answer from the disk at / for more than 5 s"
    assert stage.log(Severity.WARN).count(line) == 1
    started[1]()
    stage.bus.run_until(22.0)
    assert alerts == [("disk", "STALE"), ("disk", "OK")]
    assert len(started) == 3  # one thread hung, however often the disk was to be read


def test_a_node_that_dies_is_an_alert_and_its_other_metrics_are_stale(stage: Stage, machine: Machine) -> None:
    stat = "S 1 1 1 0 -1 4194560 0 0 0 0 5 5 0 0 20 0 3 0 500 0 5000 1 0 0"
    amcl = {"/proc/70/stat": f"70 (amcl) {stat}", "/proc/70/cmdline": "/x/amcl"}
    machine({"/proc/uptime": "100.0 1.0", "/proc/1/stat": f"1 (init) {stat}", "/proc/1/cmdline": "/sbin/init"}, amcl)
    host = {
        "running": {"source": "process_running", "command": "*/amcl*"},
        "threads": {"source": "process_threads", "command": "*/amcl*"},
    }
    off = {metric: {"source": "none"} for metric in configuration.METRICS}
    alerts: List[Tuple[str, str]] = []
    signals = {"running": {"error_below": 0.5}, "threads": {"warn_above": 10.0}}
    stage.alert_system({"signals": signals}, {"test": levels_to(alerts)})
    BatterySensor(stage.bus.node("battery_sensor", parameters={**off, "host": host}), machine.computer)
    stage.bus.run_until(10.0)
    assert alerts == []
    shutil.rmtree(machine.root / "proc" / "70")
    stage.bus.run_until(20.0)
    assert alerts == [("running", "ERROR"), ("threads", "STALE")]
    machine(amcl)
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
    assert line == "battery_level is not published: OverflowError: int too large to convert to float"


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
    assert "/unavailable_sensors" not in stage.bus.types
    other = Stage()
    missing = other.listen("unavailable_sensors", "data")
    start(other, HOST, machine.paths)
    other.bus.run_until(3.0)
    assert missing[-1] == "battery_level, temperature"


def test_the_topics_of_simulated_values_are_listed_before_the_first_value_and_every_second(stage: Stage) -> None:
    listed: List[Any] = []
    stage.outside.subscribe("simulated_sensors", "", lambda value, now_s: listed.append(value), field="data")
    node = stage.bus.node("battery_sensor", parameters={"cpu_usage": {"source": "host"}}, remap={"/temperature": "/t"})
    BatterySensor(node)
    assert listed == ["/battery_level, /t"]
    stage.bus.run_until(3.0)
    assert listed == ["/battery_level, /t"] * 4
    late: List[Any] = []
    stage.bus.node("late").subscribe(
        "simulated_sensors", "", lambda value, now_s: late.append(value), field="data", latched=True
    )
    assert late == ["/battery_level, /t"]


def test_values_that_are_no_longer_simulated_are_no_longer_listed(stage: Stage, machine: Machine) -> None:
    listed = stage.listen("simulated_sensors", "data")
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
