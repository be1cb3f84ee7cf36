"""Two monitors that watch the /diagnostics of each other: their own statuses are no signals, so nothing feeds back."""

from __future__ import annotations

from typing import Any, Mapping

import pytest
from harness.stage import Stage

from robot_health_monitor.core.nodes import Aggregator, AlertSystem, BatterySensor
from robot_health_monitor.core.port.middleware import Severity

ALL: Mapping[str, Any] = {
    "topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]', "stale_after_s": 0.0,
}  # fmt: skip


def watch(stage: Stage, name: str, **signals: Any) -> AlertSystem:
    return AlertSystem(stage.bus.node(name, parameters={"robot_name": name, "signals": signals}))


def send(stage: Stage, name: str, level: int, message: str) -> None:
    stage.outside.advertise("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    status: dict[str, Any] = {"name": name, "level": level, "message": message, "hardware_id": "", "values": []}
    stage.outside.publish("/diagnostics", {"status": [status]})


@pytest.mark.newest_python
@pytest.mark.parametrize("names", [("alert_system", "alert_system2"), ("left", "right")])
def test_neither_watches_the_other_nor_itself(names: Any) -> None:
    stage = Stage()
    Aggregator(stage.bus.node("robot/averages"))
    BatterySensor(stage.bus.node("robot/sensor"))
    systems = [watch(stage, name, drivers=ALL, battery={"stale_after_s": 1.0}) for name in names]
    arrays = stage.listen("/diagnostics")
    sizes: list[int] = []
    for second in range(1, 121):
        send(stage, "lidar: scan", 2 if second % 40 > 20 else 0, "no returns" if second % 40 > 20 else "fine")
        stage.bus.run_until(float(second))
        sizes.append(sum(len(each["status"]) for each in arrays))
        arrays.clear()
    for system in systems:
        assert list(system.monitor.signals()) == ["drivers", "drivers[lidar: scan]", "battery"]
    # Per second: the driver, two monitors with four statuses each, aggregator and sensor; a transition is one more.
    assert max(sizes) <= 1 + 2 * 4 + 1 + 2 * 5 + 2
    lines = [line for line in stage.log(Severity.ERROR) if "drivers" in line]
    assert len(lines) == 2 * 3  # two monitors, three times


def test_a_status_of_another_monitor_can_be_watched_by_its_full_name() -> None:
    stage = Stage()
    other = watch(stage, "alert_system", battery={"warn_below": 20.0, "type": "std_msgs/Float32"})
    watch(stage, "second", other={**ALL, "field": 'status["alert_system: battery"]'})
    stage.bus.run_until(1.0)
    stage.publish("battery", 15.0)
    stage.bus.run_until(3.0)
    assert other.monitor.levels()["battery"][0].name == "WARN"
    assert [line for line in stage.log(Severity.WARN) if line.startswith("other")] == [
        "other STALE: reported as stale: waiting for the first sample (was unknown for 0 s)",
        "other WARN: 15 is below 20 (was STALE for 0 s)",
    ]


def test_alerts_of_another_monitor_are_no_elements_either() -> None:
    stage = Stage()
    watch(stage, "first", battery={"warn_below": 20.0, "type": "std_msgs/Float32"})
    keys = {"topic": "alerts", "type": "diagnostic_msgs/DiagnosticStatus", "stale_after_s": 0.0}
    second = watch(stage, "second", alerts={**keys, "field": '["*"]'}, one={**keys, "field": '["first: battery"]'})
    stage.publish("battery", 15.0)
    stage.bus.run_until(3.0)
    assert {name: state for name, (_, state) in second.monitor.levels().items()} == {
        "alerts": "waiting",
        "one": "firing",
    }
