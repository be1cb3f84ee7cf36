"""alert_system with a signal per element, on the in-process middleware, in virtual time."""

from __future__ import annotations

from typing import Any, Mapping

import pytest
from harness.kept_history import KeptHistory
from harness.stage import Stage, status, values_of

from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.model import Level

CELLS: Mapping[str, Any] = {
    "robot_name": "robot1",
    "signals": {
        "cells": {
            "topic": "battery", "type": "sensor_msgs/BatteryState", "field": "cell_voltage[*]", "unit": "V",
            "warn_below": 3.2, "max_elements": 3,
        }
    },
}  # fmt: skip


@pytest.fixture
def stage() -> Stage:
    return Stage()


def send(stage: Stage, voltages: list[float]) -> None:
    stage.outside.advertise("battery", "sensor_msgs/BatteryState")
    stage.outside.publish("battery", {"cell_voltage": voltages})


def test_each_cell_is_a_status_and_an_alert_of_its_own(stage: Stage) -> None:
    alerts, arrays = stage.listen("alerts"), stage.listen("/diagnostics")
    stage.alert_system(CELLS)
    stage.bus.run_until(4.0)
    send(stage, [3.9, 3.1])
    assert [one["name"] for one in alerts] == ["alert_system: cells[1]"]
    stage.bus.run_until(5.0)
    assert [(one["name"], one["level"], one["message"]) for one in arrays[-1]["status"]] == [
        ("alert_system: cells", 0, "2 elements"),
        ("alert_system: cells[0]", 0, "3.9 V"),
        ("alert_system: cells[1]", 1, "3.1 V is below 3.2 V"),
        ("alert_system: monitor", 0, "no faults"),
    ]
    assert stage.log(Severity.WARN) == ["cells[1] WARN: 3.1 V is below 3.2 V (was unknown for 3 s)"]


def test_a_template_without_publisher_has_a_hint(stage: Stage) -> None:
    stage.alert_system(CELLS)
    stage.bus.run_until(12.0)
    assert stage.log(Severity.WARN) == [
        "cells STALE: no sample since the start 11 s ago (limit 10 s) (was unknown for 11 s) [no publisher on /battery]"
    ]


def test_too_many_elements_are_one_fault_with_their_number(stage: Stage) -> None:
    alert_system, _ = stage.alert_system(CELLS)
    arrays = stage.listen("/diagnostics")
    for second in range(1, 10):
        send(stage, [3.9] * 8)
        stage.bus.run_until(float(second))
    text = "8 elements, the first 3 are watched (max_elements)"
    assert alert_system.own_faults() == {"elements of cells": (Level.WARN, text)}
    assert stage.log(Severity.WARN) == [f"elements of cells: {text}"]
    assert values_of(status(arrays[-1], "alert_system: monitor"))["fault: elements of cells"] == text
    for second in range(10, 80):
        send(stage, [3.9] * 3)
        stage.bus.run_until(float(second))
    assert alert_system.own_faults() == {}
    assert stage.log(Severity.INFO)[-1] == "elements of cells works again"


def test_saved_states_of_elements_that_are_gone_are_not_kept(stage: Stage) -> None:
    history = KeptHistory(stage)
    drivers = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'}
    signals = {"drivers": {**drivers, "stale_after_s": 1.0, "forget_after_s": 2.0, "max_elements": 5}}
    alert_system, _ = stage.alert_system({"robot_name": "robot1", "signals": signals}, history=history)
    stage.outside.advertise("/diagnostics", "diagnostic_msgs/DiagnosticArray")
    for second in range(1, 60):
        stage.outside.publish("/diagnostics", {"status": [{"name": f"driver {second}", "level": 2, "message": "x"}]})
        stage.bus.run_until(float(second))
    assert len(alert_system.monitor.signals()) <= 6
    assert len(history.states) <= 6
    assert [text for text in history.events if "driver 1]" in text] == [
        "drivers[driver 1] ERROR: x (was unknown for 0 s)",
        "drivers[driver 1] OK: no longer watched (was ERROR for 3 s)",
    ]
