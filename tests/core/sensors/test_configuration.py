"""The configuration of battery_sensor says where each metric comes from."""

from __future__ import annotations

from typing import Any

import pytest
from harness.parameters import set_parameter

from robot_health_monitor.core.nodes import BatterySensor
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.sensors import configuration as sensing
from robot_health_monitor.core.sensors.catalogue import HOST_SOURCES
from robot_health_monitor.core.sensors.computer import Growth, HostReading
from robot_health_monitor.core.sensors.simulated import SimulatedBattery, SimulatedCpuUsage, SimulatedTemperature
from robot_health_monitor.core.values.errors import ConfigError


def test_everything_is_simulated_by_default() -> None:
    kinds = {metric: type(source) for metric, source in sensing.read_sources({}).items()}
    assert kinds == {
        "battery_level": SimulatedBattery,
        "temperature": SimulatedTemperature,
        "cpu_usage": SimulatedCpuUsage,
    }


def test_each_metric_can_come_from_this_machine() -> None:
    tree = {metric: {"source": "host"} for metric in sensing.METRICS}
    kinds = {metric: type(source) for metric, source in sensing.read_sources(tree).items()}
    assert kinds == {"battery_level": HostReading, "temperature": HostReading, "cpu_usage": Growth}


@pytest.mark.parametrize("nowhere", ["none", False])  # YAML reads `off` as false
def test_a_metric_without_a_source_is_left_out(nowhere: Any) -> None:
    assert list(sensing.read_sources({"temperature": {"source": nowhere}})) == ["battery_level", "cpu_usage"]


def test_the_sensor_of_the_chapters_example_is_a_matter_of_configuration() -> None:
    # section 5.4: 20.0 + random.uniform(-5.0, 5.0), and nothing else
    tree = {
        "sensor_name": "temp_sensor_1",
        "publish_rate": 2.0,
        "temperature": {"mean": 20.0, "spread": 5.0, "spike": 0.0},
        "battery_level": {"source": "none"},
        "cpu_usage": {"source": "none"},
    }
    sources = sensing.read_sources(tree)
    assert list(sources) == ["temperature"]
    assert all(15.0 <= sources["temperature"].read(tick / 2.0) <= 25.0 for tick in range(2000))


def test_the_keys_of_a_section_reach_its_source() -> None:
    tree = {"battery_level": {"discharge_rate": 10, "charge_rate": 45.0, "charge_at": 10.0}}
    battery = sensing.read_sources(tree)["battery_level"]
    assert [battery.read(float(second)) for second in (0, 1, 9, 10, 11, 12)] == [100.0, 90.0, 10.0, 55.0, 100.0, 90.0]


def values(tree: Any) -> Any:
    """Reads every source of a configuration for a minute."""
    sources = sensing.read_sources(tree)
    return [[source.read(float(second)) for second in range(60)] for source in sources.values()]


def test_the_same_seed_gives_the_same_values() -> None:
    assert values({"seed": 7}) == values({"seed": 7})
    assert values({"seed": 7}) != values({"seed": 8})


def test_without_a_seed_every_start_is_another() -> None:
    assert values({}) != values({})


@pytest.mark.parametrize(
    ("tree", "line"),
    [
        (
            {"battery_level": {"source": "hots"}},
            "battery_level.source: expected one of simulated, host, none, got 'hots'",
        ),
        (
            {"battery_level": {"discharge_rates": 1.0}},
            "battery_level.discharge_rates: unknown key; did you mean discharge_rate?",
        ),
        (
            {"battery_level": {"discharge_rate": -1.0}},
            "battery_level.discharge_rate: expected a number of at least 0, got -1.0",
        ),
        ({"temperature": "hot"}, "temperature: expected a mapping of keys to values, got 'hot'"),
        (
            {"temperature": {"spike_every_s": 0}},
            "temperature.spike_every_s: expected a number of at least 1, got 0",
        ),
        ({"cpu_usage": {"mean": 101}}, "cpu_usage.mean: expected a number from 0 to 100, got 101"),
        ({"cpu_usage": {"mean": float("nan")}}, "cpu_usage.mean: expected a number from 0 to 100, got nan"),
        ({"seed": "seven"}, "seed: expected a whole number, got 'seven'"),
    ],
)
def test_a_wrong_key_is_named_with_what_is_allowed(tree: Any, line: str) -> None:
    with pytest.raises(ConfigError) as caught:
        sensing.read_sources(tree)
    assert str(caught.value) == line


def test_every_parameter_has_a_description_and_a_default_that_it_allows() -> None:
    for metric, parameters in sensing.METRIC_PARAMETERS.items():
        for parameter in parameters:
            assert parameter.description
            assert parameter.read(parameter.default) == parameter.default, f"{metric}.{parameter.name}"


FIRST = (
    "cpu_percent, load_1min, load_5min, load_15min, memory_percent, memory_available, swap_percent, pressure_cpu, "
    "pressure_memory, pressure_io, oom_kills, disk_percent, ..."
)
"""The sources that a message names."""
MEMORY = {"source": "memory_percent"}


def test_further_metrics_of_this_machine_come_after_the_three() -> None:
    tree = {"host": {"memory": MEMORY, "disk_root": {"source": "disk_percent", "path": "/"}}}
    assert list(sensing.read_sources(tree)) == ["battery_level", "temperature", "cpu_usage", "memory", "disk_root"]


def test_every_source_of_the_host_can_be_had_with_its_option_left_out() -> None:
    tree = {
        "host": {
            f"metric_{kind}": {"source": kind, **({"node": "amcl"} if made.example else {})}
            for kind, made in HOST_SOURCES.items()
        }
    }
    assert len(sensing.read_sources(tree)) == 3 + len(HOST_SOURCES)


@pytest.mark.parametrize(
    ("host", "error"),
    [
        ([MEMORY], "host: expected a mapping of keys to values, got [{'source': 'memory_percent'}]"),
        ({"memory": "memory_percent"}, "host.memory: expected a mapping of keys to values, got 'memory_percent'"),
        ({"memory": {}}, f"host.memory.source: is missing; expected one of {FIRST} (see `robot-health sources`)"),
        (
            {"memory": {"source": "ram"}},
            f"host.memory.source: expected one of {FIRST}, got 'ram'",
        ),
        (
            {"memory": {**MEMORY, "path": "/"}},
            "host.memory.path: unknown key; expected one of source",
        ),
        (
            {"disk": {"source": "disk_percent", "pth": "/"}},
            "host.disk.pth: unknown key; did you mean path?",
        ),
        (
            {"disk": {"source": "disk_percent", "path": 1}},
            "host.disk.path: expected printable text, got 1; quote it",
        ),
        (
            {"core": {"source": "cpu_percent", "core": -1}},
            "host.core.core: expected a whole number from 0 to 65535, got -1",
        ),
        ({"temperature": MEMORY}, "host.temperature: is the name of a standard metric; expected another name"),
        (
            {"0": MEMORY},
            "host.0: expected a name of letters, digits and _, starting with a letter",
        ),
        ({"a/b": MEMORY}, "host.a/b: expected a name of letters, digits and _, starting with a letter"),
    ],
)
def test_a_metric_of_the_host_that_cannot_be_used_is_refused(host: Any, error: str) -> None:
    with pytest.raises(ConfigError) as caught:
        sensing.read_sources({"host": host})
    assert str(caught.value) == error


def test_a_preset_adds_a_dozen_metrics_and_the_section_host_overrides_them() -> None:
    names = list(sensing.read_sources({"host_preset": "standard"}))[3:]
    assert 10 <= len(names) <= 14 and "disk_percent" in names
    tree = {"host_preset": "standard", "host": {"disk_percent": {"source": "disk_percent", "path": "/mnt"}}}
    assert list(sensing.read_sources(tree))[3:] == names
    assert sensing.settings_of(tree)["disk_percent"] == {"source": "disk_percent", "path": "/mnt"}
    assert sensing.settings_of(tree)["wifi_signal"] == {"source": "wifi_signal", "interface": ""}
    declared = [parameter.name for parameter in sensing.declared_parameters(tree)]
    assert "host.memory_percent.source" in declared and "host.disk_percent.path" in declared
    with pytest.raises(ConfigError, match=r"^host_preset: expected one of none, standard, got 'all'$"):
        sensing.read_sources({"host_preset": "all"})


def test_metrics_of_the_host_are_declared_with_the_keys_that_they_can_have() -> None:
    tree = {"host": {"memory": MEMORY, "disk": {"source": "disk_free"}}}
    names = [parameter.name for parameter in sensing.declared_parameters(tree)]
    assert names[-3:] == ["host.memory.source", "host.disk.source", "host.disk.path"]
    assert names[0] == "battery_level.source"


def test_metrics_of_the_host_come_and_go_while_the_node_runs() -> None:
    bus = LocalBus()
    node = bus.node("battery_sensor", parameters={"host": {"memory": MEMORY}})
    heard: dict[str, int] = {"memory": 0, "disk": 0}
    for topic in heard:

        def count(value: Any, now_s: float, topic: str = topic) -> None:
            heard[topic] += 1

        bus.node("listener").subscribe(topic, "std_msgs/Float32", count)
    BatterySensor(node)
    bus.run_until(2.0)
    assert heard == {"memory": 2, "disk": 0}
    node.set_parameters({"host": {"disk": {"source": "disk_free"}}})
    bus.run_until(5.0)
    assert heard == {"memory": 2, "disk": 3}
    with pytest.raises(ConfigError, match=r"^host\.disk\.path: expected printable text, got 5; quote it$"):
        set_parameter(node, "host.disk.path", 5)
    bus.run_until(6.0)
    assert heard == {"memory": 2, "disk": 4}


@pytest.mark.parametrize(
    ("sensors", "kinds"),
    [("", ["SimulatedBattery", "Growth"]), ("host", ["HostReading", "Growth"]), ("none", ["Growth"])],
)
def test_sensors_is_the_source_of_metrics_that_name_none(sensors: str, kinds: list) -> None:
    tree = {"sensors": sensors, "temperature": {"source": "none"}, "cpu_usage": {"source": "host"}}
    assert [type(source).__name__ for source in sensing.read_sources(tree).values()] == kinds


def test_the_parameter_sensors_is_the_source_of_metrics_without_one() -> None:
    tree = {"sensors": "host", "battery_level": {"source": "simulated"}}
    kinds = {metric: type(source) for metric, source in sensing.read_sources(tree).items()}
    assert kinds == {"battery_level": SimulatedBattery, "temperature": HostReading, "cpu_usage": Growth}
    assert [sensing.settings_of(tree)[metric]["source"] for metric in sensing.METRICS] == [
        "simulated",
        "host",
        "host",
    ]


def test_the_declared_default_of_a_source_is_that_of_the_parameter_sensors() -> None:
    declared = {parameter.name: parameter.default for parameter in sensing.declared_parameters({"sensors": "host"})}
    assert declared["temperature.source"] == "host"
