"""aggregator on the in-process middleware, in virtual time; scores by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Mapping

import pytest
from harness.parameters import set_parameter
from harness.stage import Stage, status, values_of

from robot_health_monitor.core.config.monitor_config import DEFAULT_SIGNALS
from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.nodes import Aggregator
from robot_health_monitor.core.nodes.aggregator import has_inputs, health_score
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError


@pytest.fixture
def stage() -> Stage:
    return Stage()


def start(stage: Stage, **parameters: Any) -> tuple[list[float], list[Any]]:
    health, arrays = stage.listen("system_health", "data"), stage.listen("/diagnostics")
    Aggregator(stage.bus.node("aggregator", parameters=parameters))
    return health, arrays


def test_system_health_is_the_average_of_the_latest_three(stage: Stage) -> None:
    health, _ = start(stage)
    for value in (50.0, 80.0):
        stage.publish("battery_level", value)
    stage.publish("temperature", 60.0)
    stage.publish("cpu_usage", 10.0)
    stage.bus.run_until(1.0)
    assert health == [50.0]  # (80 + 60 + 10) / 3


def test_a_missing_input_is_named_instead_of_an_average_of_what_is_left(stage: Stage) -> None:
    health, arrays = start(stage)
    stage.publish("battery_level", 80.0)
    stage.publish("cpu_usage", 10.0)
    stage.bus.run_until(1.0)
    assert health == []
    own = status(arrays[-1], "aggregator: system_health")
    assert own["level"] == 3
    assert own["message"] == "not published: no fresh temperature"


def test_a_stale_input_ends_system_health(stage: Stage) -> None:
    health, arrays = start(stage)
    for topic in ("battery_level", "temperature", "cpu_usage"):
        stage.publish(topic, 30.0)
    stage.bus.run_until(4.0)
    stage.publish("battery_level", 30.0)
    stage.publish("temperature", 30.0)
    stage.bus.run_until(6.0)
    assert health == [30.0] * 5  # at 1 to 5 s; at 6 s the CPU's last value is older than 5 s
    assert values_of(status(arrays[-1], "aggregator: system_health"))["missing"] == "cpu_usage"


def test_a_score_maps_each_metric_to_0_to_100_by_its_thresholds_first(stage: Stage) -> None:
    health, _ = start(stage, method="score")
    stage.publish("battery_level", 60.0)  # halfway from the WARN bound 20 (50) to 100 (100): 75
    stage.publish("temperature", 80.0)  # the WARN bound: 50
    stage.publish("cpu_usage", 0.0)  # the healthy end: 100
    stage.bus.run_until(1.0)
    assert health == [75.0]


def test_the_statistics_of_the_window_are_in_diagnostics(stage: Stage) -> None:
    _, arrays = start(stage)
    for now_s, value in ((0.0, 10.0), (0.25, 15.0), (0.5, 20.0)):
        stage.bus.run_until(now_s)
        stage.publish("battery_level", value)
    stage.bus.run_until(1.0)
    values = values_of(status(arrays[-1], "aggregator: battery_level"))
    assert {key: values[key] for key in ("mean", "min", "max", "stddev", "rate", "frequency_hz")} == {
        "mean": "15",
        "min": "10",
        "max": "20",
        "stddev": "4.082",
        "rate": "20",
        "frequency_hz": "4",
    }


def test_only_the_configured_inputs_are_averaged(stage: Stage) -> None:
    health, arrays = start(stage, inputs=["battery_level", "arm/battery_level"])
    stage.publish("battery_level", 80.0)
    stage.publish("temperature", 0.0)
    stage.bus.run_until(1.0)
    assert health == []
    assert status(arrays[-1], "aggregator: system_health")["message"] == "not published: no fresh arm/battery_level"
    stage.publish("arm/battery_level", 60.0)
    stage.bus.run_until(2.0)
    assert health == [70.0]


def test_inputs_can_be_changed_while_the_node_runs(stage: Stage) -> None:
    health = stage.listen("system_health", "data")
    node = stage.bus.node("aggregator")
    Aggregator(node)
    assert set_parameter(node, "inputs", ["cpu_usage"]) == (
        "inputs: [battery_level, temperature, cpu_usage] -> [cpu_usage]"
    )
    stage.publish("cpu_usage", 25.0)
    stage.bus.run_until(1.0)
    assert health == [25.0]
    set_parameter(node, "inputs", ["battery_level", "cpu_usage"])
    stage.publish("battery_level", 75.0)
    stage.bus.run_until(2.0)
    assert health == [25.0, 50.0]


@pytest.mark.parametrize(
    "inputs", [["cpu_usage", "cpu_usage"], ["a b"], ["/"], [""], ["a/b", "a_b"], ["2nd"], "cpu_usage", [1.0]]
)
def test_inputs_that_are_not_topics_are_rejected(stage: Stage, inputs: Any) -> None:
    with pytest.raises(ConfigError, match=r"^inputs: expected"):
        start(stage, inputs=inputs)


def test_a_score_needs_thresholds_of_every_input(stage: Stage, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^inputs: expected signals with thresholds for method score, got wheel$"):
        start(stage, inputs=["wheel"], method="score")
    pytest.importorskip("yaml")
    file = tmp_path / "thresholds.yaml"
    file.write_text(
        "alert_system: {ros__parameters: {signals: {left: {topic: wheel, warn_above: 8.0, error_above: 10.0}}}}"
    )
    health, _ = start(stage, inputs=["wheel"], method="score", thresholds=str(file))
    stage.publish("wheel", 9.0)  # halfway from the WARN bound (50) to the ERROR bound (0)
    stage.bus.run_until(1.0)
    assert health == [25.0]


def test_a_rate_below_the_stale_limit_is_kept(stage: Stage) -> None:
    health, _ = start(stage, publish_rate=0.1)
    for now_s in range(41):
        stage.bus.run_until(float(now_s))
        for topic in ("battery_level", "temperature", "cpu_usage"):
            stage.publish(topic, 30.0)
    assert health == [30.0] * 4


def test_without_inputs_nothing_is_published_until_there_are_some(stage: Stage) -> None:
    health, arrays = stage.listen("system_health", "data"), stage.listen("/diagnostics")
    node = stage.bus.node("aggregator", parameters={"inputs": []})
    Aggregator(node)
    stage.publish("cpu_usage", 25.0)
    stage.bus.run_until(60.0)
    assert health == [] and arrays == []
    assert stage.log(Severity.INFO) == ["system_health is not published: inputs is empty"]
    set_parameter(node, "inputs", ["cpu_usage"])
    stage.publish("cpu_usage", 25.0)
    stage.bus.run_until(61.0)
    assert health == [25.0]
    assert set_parameter(node, "inputs", []) == "inputs: [cpu_usage] -> []"
    arrays.clear()
    stage.bus.run_until(70.0)
    assert health == [25.0] and arrays == []


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({}, True),
        ({"sensors": "host"}, True),
        ({"sensors": "none"}, False),
        ({"sensors": "none", "inputs": ["pack_level"]}, True),
        ({"sensors": "none", "inputs": []}, True),
    ],
)
def test_without_battery_sensor_only_configured_inputs_can_be_averaged(parameters: Any, expected: bool) -> None:
    assert has_inputs(parameters) is expected


def test_another_method_is_a_change(stage: Stage) -> None:
    node = stage.bus.node("aggregator")
    Aggregator(node)
    assert set_parameter(node, "method", "score") == "method: mean -> score"
    with pytest.raises(ConfigError, match="robot_name"):
        set_parameter(node, "robot_name", "other")


BATTERY = DEFAULT_SIGNALS["battery_level"]  # valid 0..100, WARN below 20, ERROR below 10
TEMPERATURE = DEFAULT_SIGNALS["temperature"]  # valid -40..150, WARN above 80, ERROR above 95
BOTH = {"valid_min": 0.0, "valid_max": 30.0, "warn_below": 10.0, "warn_above": 20.0, "error_above": 25.0}


@pytest.mark.parametrize(
    ("settings", "value", "score"),
    [
        (BATTERY, 100.0, 100.0),
        (BATTERY, 60.0, 75.0),
        (BATTERY, 20.0, 50.0),
        (BATTERY, 15.0, 25.0),
        (BATTERY, 10.0, 0.0),
        (BATTERY, 0.0, 0.0),
        (TEMPERATURE, -40.0, 100.0),
        (TEMPERATURE, 20.0, 75.0),
        (TEMPERATURE, 80.0, 50.0),
        (TEMPERATURE, 87.5, 25.0),
        (TEMPERATURE, 95.0, 0.0),
        (TEMPERATURE, 150.0, 0.0),
        ({"warn_below": 20.0, "valid_min": 0.0}, 10.0, 25.0),  # no ERROR bound: 0 at the end of the range
        ({"warn_below": 20.0}, 1e9, 100.0),  # no healthy end: fine is fine
        ({"warn_below": 20.0}, 20.0, 100.0),
        ({"warn_below": 20.0}, 19.0, 50.0),  # neither ERROR bound nor end: it never gets worse than WARN
        ({"error_below": 10.0}, 0.0, 100.0),  # a side without a WARN bound
        ({}, 5.0, 100.0),
        (BOTH, 10.0, 50.0),
        (BOTH, 20.0, 50.0),
        (BOTH, 15.0, 62.5),  # 5 of 20 above WARN low: 62.5; 5 of 20 below WARN high: 62.5
        (BOTH, 22.5, 25.0),
        (BOTH, 5.0, 25.0),
    ],
)
def test_score(settings: Mapping[str, Any], value: float, score: float) -> None:
    assert health_score(value, read_signal("a", settings)) == pytest.approx(score)


def test_equal_warn_and_error_bounds_fall_from_50_to_0_at_once() -> None:
    signal = read_signal("a", {"warn_below": 10.0, "error_below": 10.0, "valid_max": 20.0})
    assert health_score(10.0, signal) == 50.0
    assert health_score(9.999, signal) == 0.0
