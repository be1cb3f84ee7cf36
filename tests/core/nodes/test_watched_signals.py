"""Which signals are watched: changes of the configuration, sensors that are simulated or missing."""

from __future__ import annotations

from typing import Any, Mapping

import pytest
from harness.parameters import set_parameter
from harness.stage import FLOAT32, Stage, status, values_of

from robot_health_monitor.core.nodes import AlertSystem, BatterySensor
from robot_health_monitor.core.port.local import LocalBus, LocalMiddleware
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError

LATCHING: Mapping[str, Any] = {
    "robot_name": "robot1",
    "signals": {"battery_level": {"warn_below": 20.0, "latch": True}, "temperature": {"warn_above": 80.0}},
}
BATTERY: Mapping[str, Any] = {"robot_name": "robot1", "signals": {"battery_level": {"unit": "%", "warn_below": 20.0}}}


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_a_new_topic_is_followed_and_the_old_one_left(stage: Stage) -> None:
    _, middleware = stage.alert_system(LATCHING)
    set_parameter(middleware, "signals.temperature.topic", "motor_temperature")
    stage.publish("temperature", 90.0)
    assert stage.log(Severity.WARN) == []
    stage.publish("motor_temperature", 90.0)
    assert len(stage.log(Severity.WARN)) == 1


def test_a_wrong_type_names_its_signal_and_nothing_stays_subscribed(stage: Stage) -> None:
    signals = {"battery_level": {"type": FLOAT32}, "temperature": {"type": "Float32"}}
    with pytest.raises(ConfigError, match=r"^signals\.temperature\.type: expected a type such as std_msgs/Float32"):
        stage.alert_system({"signals": signals})
    stage.publish("battery_level", float("nan"))
    assert stage.log(Severity.WARN, Severity.ERROR) == []


def test_a_change_of_a_default_signal_keeps_the_rest_of_it_and_the_other_default_signals() -> None:
    stage = Stage()
    alert_system, middleware = stage.alert_system({})
    assert set_parameter(middleware, "signals.battery_level.warn_below", 30.0) == "battery_level.warn_below: 20 -> 30"
    battery = alert_system.monitor.config.signals["battery_level"]
    assert (battery.warn_below, battery.error_below, battery.unit, battery.valid_max) == (30.0, 10.0, "%", 100.0)
    assert list(alert_system.monitor.config.signals) == ["battery_level", "temperature", "cpu_usage"]
    assert set_parameter(middleware, "signals.wheel.warn_above", 1.0) == "added wheel"
    with pytest.raises(ConfigError, match=r"signals\.battery_level: expected a mapping"):
        middleware.set_parameters({"signals": {"battery_level": 30.0}})


class TestSimulatedSensors:
    """Signals that battery_sensor lists as simulated."""

    def list_topics(self, stage: Stage, text: str) -> None:
        stage.outside.advertise("_simulated_sensors", "std_msgs/String", latched=True)
        stage.outside.publish("_simulated_sensors", {"data": text})

    def test_they_are_known_judged_and_shown(self, stage: Stage) -> None:
        arrays = stage.listen("/diagnostics")
        alert_system, _ = stage.alert_system(LATCHING)
        is_simulated = alert_system.watched.is_simulated
        assert not is_simulated("battery_level")
        self.list_topics(stage, "/battery_level, /other")
        assert is_simulated("battery_level") and not is_simulated("temperature")
        stage.publish("battery_level", 15.0)
        stage.bus.run_until(1.0)
        assert [line for line in stage.log(Severity.WARN) if "battery_level WARN" in line]
        assert values_of(status(arrays[-1], "alert_system: monitor"))["simulated"] == "battery_level"
        self.list_topics(stage, "")
        assert not is_simulated("battery_level")

    def test_a_list_that_came_before_is_known_at_once(self, stage: Stage) -> None:
        self.list_topics(stage, "/battery_level")
        alert_system, _ = stage.alert_system(BATTERY)
        is_simulated = alert_system.watched.is_simulated
        assert is_simulated("battery_level")

    def test_every_signal_on_a_simulated_topic_is_simulated(self, stage: Stage) -> None:
        self.list_topics(stage, "/power/level")
        signals = {"low": {"topic": "power/level"}, "rate": {"topic": "/power/level", "field": ""}}
        alert_system, middleware = stage.alert_system({"signals": signals})
        is_simulated = alert_system.watched.is_simulated
        assert is_simulated("low") and is_simulated("rate")
        assert is_simulated("low[7]")  # an element of an array
        set_parameter(middleware, "signals.low.topic", "real/level")
        assert not is_simulated("low") and is_simulated("rate")

    def test_names_follow_namespaces_and_remapping(self, stage: Stage) -> None:
        def node(name: str) -> LocalMiddleware:
            return stage.bus.node(name, namespace="robot1", remap={"/robot1/battery_level": "/power/level"})

        alert_system = AlertSystem(node("alert_system"))
        is_simulated = alert_system.watched.is_simulated
        BatterySensor(node("battery_sensor"))
        assert is_simulated("battery_level") and is_simulated("temperature")


class TestUnavailableSensors:
    """Signals that battery_sensor lists as without a sensor."""

    def list_sensors(self, stage: Stage, text: str) -> None:
        stage.outside.advertise("_unavailable_sensors", "std_msgs/String")
        stage.outside.publish("_unavailable_sensors", {"data": text})

    def test_a_signal_without_a_sensor_never_becomes_stale(self, stage: Stage) -> None:
        arrays = stage.listen("/diagnostics")
        stage.alert_system({**LATCHING})
        self.list_sensors(stage, "battery_level, temperature")
        self.list_sensors(stage, "battery_level, temperature")
        stage.bus.run_until(60.0)
        assert stage.log(Severity.WARN, Severity.ERROR) == []
        (own,) = arrays[-1]["status"]
        assert values_of(own)["without_sensor"] == "battery_level, temperature"
        lines = [text for text in stage.log(Severity.INFO) if "no such sensor" in text]
        assert [line.partition(" ")[0] for line in lines] == ["battery_level", "temperature"]

    def test_a_sensor_that_had_a_sample_is_still_watched(self, stage: Stage) -> None:
        stage.alert_system(BATTERY)
        stage.publish("battery_level", 50.0)
        self.list_sensors(stage, "battery_level")
        stage.bus.run_until(10.0)
        assert [text.partition(":")[0] for text in stage.log(Severity.WARN)] == ["battery_level STALE"]

    def test_a_sample_brings_the_signal_back_at_once(self, stage: Stage) -> None:
        stage.alert_system(BATTERY)
        self.list_sensors(stage, "battery_level")
        stage.bus.run_until(20.0)
        stage.publish("battery_level", 15.0)
        assert [text.partition(":")[0] for text in stage.log(Severity.WARN)] == ["battery_level WARN"]

    def test_a_sensor_that_is_no_longer_listed_is_watched_again(self, stage: Stage) -> None:
        stage.alert_system(BATTERY)
        self.list_sensors(stage, "battery_level")
        stage.bus.run_until(20.0)
        self.list_sensors(stage, "")
        stage.bus.run_until(29.0)
        assert stage.log(Severity.WARN) == []
        stage.bus.run_until(31.0)
        assert [text.partition(":")[0] for text in stage.log(Severity.WARN)] == ["battery_level STALE"]

    def test_a_signal_on_another_topic_is_still_watched(self, stage: Stage) -> None:
        signals = {"battery_level": {"topic": "/driver/battery", "type": FLOAT32, "warn_below": 20.0}}
        stage.alert_system({"signals": signals})
        self.list_sensors(stage, "battery_level")
        stage.bus.run_until(20.0)
        assert len(stage.log(Severity.WARN)) == 1

    def test_a_change_of_parameters_keeps_it_unwatched(self, stage: Stage) -> None:
        _, middleware = stage.alert_system(LATCHING)
        self.list_sensors(stage, "battery_level")
        assert set_parameter(middleware, "signals.temperature.warn_above", 70.0) == "temperature.warn_above: 80 -> 70"
        stage.publish("temperature", 50.0)
        stage.bus.run_until(5.0)
        assert stage.log(Severity.WARN) == []


@pytest.mark.parametrize(("topic", "seen"), [("/tf_static", 1), ("/robot1/tf_static", 1), ("/no_tf_static", 0)])
def test_static_transforms_that_were_published_before_are_received(topic: str, seen: int) -> None:
    bus = LocalBus()
    publisher = bus.node("robot_state_publisher")
    publisher.advertise(topic, FLOAT32, latched=True)
    publisher.publish(topic, {"data": 1.0})
    signals = {"frames": {"topic": topic, "type": FLOAT32}}
    assert AlertSystem(bus.node("alert_system", parameters={"signals": signals})).samples == seen
