"""What alert_system announces: outlets, /diagnostics, silences."""

from __future__ import annotations

from typing import Any, Mapping

import pytest
from harness.stage import FLOAT32, Stage, status, values_of

from robot_health_monitor.core.judge.monitor import Monitor
from robot_health_monitor.core.nodes import Aggregator, AlertSystem
from robot_health_monitor.core.nodes.outlets import Event, Notice
from robot_health_monitor.core.port.local import LocalBus, LogLine
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.model import Transition

LATCHING: Mapping[str, Any] = {
    "robot_name": "robot1",
    "signals": {"battery_level": {"warn_below": 20.0, "latch": True}, "temperature": {"warn_above": 80.0}},
}
BATTERY: Mapping[str, Any] = {"robot_name": "robot1", "signals": {"battery_level": {"unit": "%", "warn_below": 20.0}}}


@pytest.fixture
def stage() -> Stage:
    return Stage()


def test_diagnostics_come_every_second_and_at_once_on_a_transition(stage: Stage) -> None:
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
def test_no_report_is_made_without_subscribers(stage: Stage, node: Any, monkeypatch: Any) -> None:
    made: list[float] = []
    report = Monitor.report
    monkeypatch.setattr(Monitor, "report", lambda self, now_s: made.append(now_s) or report(self, now_s))
    node(stage.bus.node("watching"))
    stage.bus.run_until(3.0)
    assert made == []
    arrays = stage.listen("/diagnostics")
    stage.bus.run_until(5.0)
    assert made == [4.0, 5.0]
    assert len(arrays) == 2


def test_each_outlet_gets_each_transition_once_before_it_is_published(stage: Stage) -> None:
    order: list[str] = []
    stage.outside.subscribe("alerts", "", lambda value, now_s: order.append("alerts"), field="message")
    stage.alert_system(BATTERY, {"history": lambda event: order.append("history")})
    stage.publish("battery_level", 15.0)
    assert order == ["history", "alerts"]


def test_alerts_and_notices_are_not_logged_where_an_outlet_shows_them(stage: Stage) -> None:
    events: list[Event] = []
    _, middleware = stage.alert_system(BATTERY, {"screen": events.append}, log_alerts=False)
    stage.publish("battery_level", 15.0)
    middleware.faults.report("rosbridge", "port 9090 is in use")
    stage.bus.run_until(1.0)
    assert [type(event) for event in events] == [Transition, Notice]
    assert stage.log(Severity.WARN, Severity.ERROR) == []


def test_an_outlet_that_raises_stops_no_other_outlet_and_no_tick(stage: Stage) -> None:
    def fail(event: Event) -> None:
        raise OSError("No space left on device")

    alerts, arrays = stage.listen("alerts"), stage.listen("/diagnostics")
    stage.alert_system(BATTERY, {"history": fail})
    for level in (50.0, 15.0, 50.0):
        stage.publish("battery_level", level)
    assert [alert["level"] for alert in alerts] == [1, 0]
    stage.bus.run_until(6.0)
    assert [one["level"] for one in alerts if one["name"] == "alert_system: battery_level"] == [1, 0, 3]
    assert status(arrays[-1], "alert_system: monitor")["level"] == 2
    errors = stage.log(Severity.ERROR)
    assert errors == ["outlet history: OSError: No space left on device"]


def test_a_log_that_cannot_be_written_stops_nothing() -> None:
    def fail(line: LogLine) -> None:
        raise BrokenPipeError("Broken pipe")

    bus = LocalBus(on_log=fail)
    node = bus.node("alert_system", parameters=BATTERY)
    AlertSystem(node)
    alerts: list[Any] = []
    outside = bus.node("outside")
    outside.subscribe("alerts", "", lambda value, now_s: alerts.append(value), field="level")
    outside.advertise("battery_level", FLOAT32)
    for level in (50.0, 15.0, 5.0, 50.0):
        outside.publish("battery_level", {"data": level})
    bus.run_until(6.0)
    assert alerts[:2] == [1, 0] and alerts[-1] == 3
    assert node.faults.current()["log"].text == "BrokenPipeError: Broken pipe"


def test_a_silenced_signal_says_so_and_is_counted(stage: Stage) -> None:
    arrays, alerts = stage.listen("/diagnostics"), stage.listen("alerts")
    silences = {"battery_level": "until 14:00: battery swap (ann)"}
    stage.alert_system(LATCHING, silence_of=silences.get)
    stage.publish("battery_level", 15.0)
    stage.publish("temperature", 90.0)
    assert [values_of(alert).get("silenced") for alert in alerts] == ["until 14:00: battery swap (ann)", None]
    stage.bus.run_until(1.0)
    for array in arrays[0], arrays[-1]:
        battery = status(array, "alert_system: battery_level")
        assert values_of(battery)["silenced"] == "until 14:00: battery swap (ann)"
    assert "silenced" not in values_of(status(arrays[-1], "alert_system: temperature"))
    assert values_of(status(arrays[-1], "alert_system: monitor"))["silenced"] == "1"
    stage.publish("battery_level", 50.0)  # latched
    stage.bus.call_service("/alert_system/reset")
    stage.bus.run_until(2.0)
    assert values_of(status(arrays[-1], "alert_system: monitor"))["silenced"] == "0"
