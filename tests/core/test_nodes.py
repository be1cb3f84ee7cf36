"""The three nodes on the in-process middleware, in virtual time."""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Tuple

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.monitor import Monitor
from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor
from robot_health_monitor.core.parameters import flatten, unflatten
from robot_health_monitor.core.sensors import configuration as sensing

FLOAT32 = "std_msgs/Float32"
LATCHING: Mapping[str, Any] = {
    "robot_name": "robot1",
    "signals": {"battery_level": {"warn_below": 20.0, "latch": True}, "temperature": {"warn_above": 80.0}},
}


class Stage:
    """A bus with a node that publishes by hand, and one that listens."""

    def __init__(self) -> None:
        self.bus = LocalBus()
        self.outside = self.bus.node("outside")
        self.heard: Dict[str, List[Any]] = {}

    def publish(self, topic: str, value: float) -> None:
        self.outside.advertise(topic, FLOAT32)
        self.outside.publish(topic, {"data": value})

    def listen(self, topic: str, field: str = "") -> List[Any]:
        messages: List[Any] = []
        self.outside.subscribe(topic, "", lambda value, now_s: messages.append(value), field=field)
        return messages

    def log(self, *severities: Severity) -> List[str]:
        return [line.text for line in self.bus.log_lines if line.severity in severities]

    def alert_system(self, parameters: Mapping[str, Any]) -> Tuple[AlertSystem, LocalMiddleware]:
        middleware = self.bus.node("alert_system", parameters=parameters)
        return AlertSystem(middleware), middleware


@pytest.fixture
def stage() -> Stage:
    return Stage()


def status(array: Any, name: str) -> Any:
    (found,) = [one for one in array["status"] if one["name"] == name]
    return found


def values_of(message: Any) -> Dict[str, str]:
    return {pair["key"]: pair["value"] for pair in message["values"]}


class TestAlertSystem:
    def test_exactly_20_percent_and_80_degrees_are_fine(self, stage: Stage) -> None:
        stage.alert_system({})
        stage.publish("battery_level", 20.0)
        stage.publish("temperature", 80.0)
        assert stage.log(Severity.WARN, Severity.ERROR) == []

    def test_an_hour_of_low_battery_is_one_line_and_one_alert(self, stage: Stage) -> None:
        alerts = stage.listen("alerts")
        stage.alert_system({"signals": {"battery_level": {"unit": "%", "warn_below": 20.0}}, "robot_name": "robot1"})
        stage.publish("battery_level", 25.0)
        for now_s in range(312, 3912):
            stage.bus.run_until(float(now_s))
            stage.publish("battery_level", 19.5)
        lines = [text for text in stage.log(Severity.WARN) if " WARN: " in text]
        assert lines == ["battery_level WARN: 19.5 % is below 20 % (was STALE for 306 s)"]
        (alert,) = [one for one in alerts if one["level"] == 1]
        assert alert["name"] == "alert_system: battery_level"
        assert alert["message"] == lines[0]
        assert alert["hardware_id"] == "robot1"

    def test_diagnostics_come_every_second_and_at_once_on_a_transition(self, stage: Stage) -> None:
        arrays = stage.listen("/diagnostics")
        stage.alert_system(LATCHING)
        stage.bus.run_until(3.0)
        assert len(arrays) == 3
        stage.publish("battery_level", 19.0)
        assert len(arrays) == 4
        assert status(arrays[-1], "alert_system: battery_level")["level"] == 1
        stage.bus.run_until(4.0)
        assert [one["name"] for one in arrays[-1]["status"]] == [
            "alert_system: battery_level",
            "alert_system: temperature",
            "alert_system: monitor",
        ]

    @pytest.mark.parametrize("node", [AlertSystem, Aggregator])
    def test_no_report_is_made_while_nobody_listens(self, stage: Stage, node: Any, monkeypatch: Any) -> None:
        made: List[float] = []
        report = Monitor.report
        monkeypatch.setattr(Monitor, "report", lambda self, now_s: made.append(now_s) or report(self, now_s))
        node(stage.bus.node("watching"))
        stage.bus.run_until(3.0)
        assert made == []
        arrays = stage.listen("/diagnostics")
        stage.bus.run_until(5.0)
        assert made == [4.0, 5.0]
        assert len(arrays) == 2

    def test_reset_clears_a_latched_alert_and_says_which(self, stage: Stage) -> None:
        stage.alert_system(LATCHING)
        stage.publish("battery_level", 19.0)
        stage.publish("battery_level", 50.0)
        assert stage.bus.call_service("/alert_system/reset") == {"success": True, "message": "reset: battery_level"}
        assert stage.log(Severity.INFO)[-1].startswith("battery_level OK: 50")
        assert stage.bus.call_service("/alert_system/reset")["message"] == "reset: nothing was latched"

    def test_a_changed_bound_is_judged_by_at_once(self, stage: Stage) -> None:
        _, middleware = stage.alert_system(LATCHING)
        stage.publish("temperature", 75.0)
        middleware.set_parameter("signals.temperature.warn_above", 70.0)
        assert stage.log(Severity.WARN) == ["temperature WARN: 75 is above 70 (was OK for 0 s)"]

    def test_a_contradiction_is_refused_and_the_old_bounds_stay(self, stage: Stage) -> None:
        _, middleware = stage.alert_system(LATCHING)
        with pytest.raises(ConfigError, match=r"signals\.battery_level\.error_below: expected at most"):
            middleware.set_parameter("signals.battery_level.error_below", 30.0)
        stage.publish("battery_level", 25.0)
        assert stage.log(Severity.WARN, Severity.ERROR) == []

    def test_a_change_of_one_signal_does_not_disturb_the_pending_duration_of_another(self, stage: Stage) -> None:
        signals = {"battery_level": {"warn_below": 20.0, "for_s": 3.0}, "temperature": {"warn_above": 80.0}}
        _, middleware = stage.alert_system({"signals": signals})
        stage.publish("battery_level", 19.0)
        stage.bus.run_until(2.0)
        middleware.set_parameter("signals.temperature.warn_above", 70.0)
        stage.bus.run_until(3.0)
        assert stage.log(Severity.WARN) == ["battery_level WARN: 19 is below 20 (was OK for 3 s)"]

    def test_a_new_topic_is_followed_and_the_old_one_left(self, stage: Stage) -> None:
        _, middleware = stage.alert_system(LATCHING)
        middleware.set_parameter("signals.temperature.topic", "motor_temperature")
        stage.publish("temperature", 90.0)
        assert stage.log(Severity.WARN) == []
        stage.publish("motor_temperature", 90.0)
        assert len(stage.log(Severity.WARN)) == 1

    def test_the_robots_name_can_only_be_given_at_the_start(self, stage: Stage) -> None:
        _, middleware = stage.alert_system(LATCHING)
        with pytest.raises(ConfigError, match="robot_name"):
            middleware.set_parameter("robot_name", "robot2")

    def test_a_wrong_type_names_its_signal_and_nothing_stays_subscribed(self, stage: Stage) -> None:
        signals = {"battery_level": {"type": FLOAT32}, "temperature": {"type": "Float32"}}
        with pytest.raises(ConfigError, match=r"^signals\.temperature\.type: expected a type such as std_msgs/Float32"):
            stage.alert_system({"signals": signals})
        stage.publish("battery_level", float("nan"))
        assert stage.log(Severity.WARN, Severity.ERROR) == []

    def test_time_that_goes_back_is_one_info_line(self, stage: Stage) -> None:
        stage.alert_system(LATCHING)
        stage.bus.run_until(100.0)
        stage.bus.run_until(40.0)
        stage.bus.run_until(45.0)
        lines = [text for text in stage.log(Severity.INFO) if "went back" in text]
        assert lines == ["time went back by 59.000 s: windows, pending timers and staleness restart"]


class TestAggregator:
    def start(self, stage: Stage, **parameters: Any) -> Tuple[List[float], List[Any]]:
        health, arrays = stage.listen("system_health", "data"), stage.listen("/diagnostics")
        Aggregator(stage.bus.node("aggregator", parameters=parameters))
        return health, arrays

    def test_system_health_is_the_average_of_the_latest_three(self, stage: Stage) -> None:
        health, _ = self.start(stage)
        for value in (50.0, 80.0):
            stage.publish("battery_level", value)
        stage.publish("temperature", 60.0)
        stage.publish("cpu_usage", 10.0)
        stage.bus.run_until(1.0)
        assert health == [50.0]  # (80 + 60 + 10) / 3

    def test_a_missing_input_is_named_instead_of_an_average_of_what_is_left(self, stage: Stage) -> None:
        health, arrays = self.start(stage)
        stage.publish("battery_level", 80.0)
        stage.publish("cpu_usage", 10.0)
        stage.bus.run_until(1.0)
        assert health == []
        told = status(arrays[-1], "aggregator: system_health")
        assert told["level"] == 3
        assert told["message"] == "not published: no fresh temperature"

    def test_a_stale_input_ends_system_health(self, stage: Stage) -> None:
        health, arrays = self.start(stage)
        for topic in ("battery_level", "temperature", "cpu_usage"):
            stage.publish(topic, 30.0)
        stage.bus.run_until(4.0)
        stage.publish("battery_level", 30.0)
        stage.publish("temperature", 30.0)
        stage.bus.run_until(6.0)
        assert health == [30.0] * 5  # at 1 to 5 s; at 6 s the CPU's last value is older than 5 s
        assert values_of(status(arrays[-1], "aggregator: system_health"))["missing"] == "cpu_usage"

    def test_a_score_maps_each_metric_to_0_to_100_by_its_thresholds_first(self, stage: Stage) -> None:
        health, _ = self.start(stage, method="score")
        stage.publish("battery_level", 60.0)  # halfway from the WARN bound 20 (50) to 100 (100): 75
        stage.publish("temperature", 80.0)  # the WARN bound: 50
        stage.publish("cpu_usage", 0.0)  # the healthy end: 100
        stage.bus.run_until(1.0)
        assert health == [75.0]

    def test_the_statistics_of_the_window_are_in_diagnostics(self, stage: Stage) -> None:
        _, arrays = self.start(stage)
        for now_s, value in ((0.0, 10.0), (0.5, 20.0)):
            stage.bus.run_until(now_s)
            stage.publish("battery_level", value)
        stage.bus.run_until(1.0)
        values = values_of(status(arrays[-1], "aggregator: battery_level"))
        assert {key: values[key] for key in ("mean", "min", "max", "stddev", "rate", "frequency_hz")} == {
            "mean": "15",
            "min": "10",
            "max": "20",
            "stddev": "5",
            "rate": "20",
            "frequency_hz": "2",
        }


class TestBatterySensor:
    def start(self, stage: Stage, parameters: Mapping[str, Any]) -> LocalMiddleware:
        middleware = stage.bus.node("battery_sensor", parameters=parameters)
        BatterySensor(middleware)
        return middleware

    def test_the_battery_loses_1_percent_per_second_and_is_published_at_1_hz(self, stage: Stage) -> None:
        levels = stage.listen("battery_level", "data")
        self.start(stage, {})
        stage.bus.run_until(4.0)
        assert levels == [100.0, 99.0, 98.0, 97.0]

    def test_another_rate_takes_effect_and_does_not_charge_the_battery(self, stage: Stage) -> None:
        levels = stage.listen("battery_level", "data")
        middleware = self.start(stage, {})
        stage.bus.run_until(3.0)
        middleware.set_parameter("publish_rate", 2.0)
        stage.bus.run_until(4.0)
        assert levels == [100.0, 99.0, 98.0, 97.5, 97.0]

    def test_defaults_that_a_middleware_fills_in_are_no_change(self, stage: Stage) -> None:
        levels = stage.listen("battery_level", "data")
        middleware = self.start(stage, {})
        stage.bus.run_until(3.0)
        defaults = {
            f"{metric}.{parameter.name}": parameter.default
            for metric, parameters in sensing.METRIC_PARAMETERS.items()
            for parameter in parameters
        }
        middleware.set_parameters(unflatten({**dict(flatten({"sensor_name": "other"})), **defaults}))
        stage.bus.run_until(4.0)
        assert levels == [100.0, 99.0, 98.0, 97.0]

    def test_a_metric_without_a_source_is_not_published(self, stage: Stage) -> None:
        levels, temperatures = stage.listen("battery_level", "data"), stage.listen("temperature", "data")
        self.start(stage, {"battery_level": {"source": "none"}})
        stage.bus.run_until(2.0)
        assert levels == []
        assert len(temperatures) == 2
