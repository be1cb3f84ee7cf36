"""What only JSON can carry: names that are no text, stamps that are no time, objects where numbers belong."""

from __future__ import annotations

import math
from typing import Any

import pytest
from harness.rosbridge_client import ForeignServer, Watched, scenario, until

from robot_health_monitor.core.nodes import AlertSystem

JOINTS, DIAGNOSTICS = "sensor_msgs/JointState", "diagnostic_msgs/DiagnosticArray"
SIGNALS: dict[str, Any] = {
    "age": {"topic": "/in", "type": JOINTS, "field": "header.stamp"},
    "wheels": {"topic": "/in", "type": JOINTS, "field": 'effort["wheel_*"]'},
    "left": {"topic": "/in", "type": JOINTS, "field": 'effort["wheel_left"]'},
    "highest": {"topic": "/in", "type": JOINTS, "field": "effort[*]", "reduce": "max"},
    "drivers": {"topic": "/in", "type": DIAGNOSTICS, "field": 'status["*"]'},
    "motor": {"topic": "/in", "type": DIAGNOSTICS, "field": 'status["motor"]'},
}
GOOD: dict[str, Any] = {
    "age": {"header": {"stamp": {"sec": 1_700_000_000, "nanosec": 0}}},
    "drivers": {"status": [{"name": "motor", "level": 0, "message": "fine"}]},
    "motor": {"status": [{"name": "motor", "level": 0, "message": "fine"}]},
}
GOOD_JOINTS = {"name": ["wheel_left", "arm"], "effort": [1.0, 2.0]}


def stamp(seconds: Any, nanoseconds: Any = 0) -> dict[str, Any]:
    return {"header": {"stamp": {"sec": seconds, "nanosec": nanoseconds}}}


def driver(name: Any, level: Any) -> dict[str, Any]:
    return {"status": [{"name": name, "level": level, "message": "x"}]}


@pytest.mark.parametrize(
    ("message", "signal", "reason"),
    [
        (stamp("NaN"), "age", "not a time stamp: 'NaN'"),
        (stamp(math.nan), "age", "not a time stamp: nan"),
        (stamp(-5), "age", "not a time stamp: -5"),
        (stamp(10**400), "age", "not a time stamp: inf"),
        (stamp(0, 1e308), "age", "not a time stamp: 1e+308"),
        ({"header": {"stamp": "now"}}, "age", "'now'"),
        ({"name": [1, 2], "effort": [1.0, 2.0]}, "wheels", "name[0] is not a text: 1"),
        ({"name": ["wheel_left", None], "effort": [1.0, 2.0]}, "wheels", "name[1] is not a text: None"),
        ({"name": [1, "arm"], "effort": [1.0, 2.0]}, "left", "name[0] is not a text: 1"),
        ({"name": ["wheel_left"], "effort": ["x"]}, "wheels[wheel_left]", "'x'"),
        ({"name": ["wheel_left"], "effort": [[1.0]]}, "wheels[wheel_left]", "a message or a list, not a number"),
        ({"name": ["wheel_left"], "effort": [[1.0]]}, "left", "[1.0]"),
        ({"effort": [[1.0], {}, "x", None]}, "highest", "none of 4 elements is measured"),
        (driver(5, 0), "drivers", "status[0] is not a text: 5"),
        (driver(["motor"], 0), "drivers", "status[0] is not a text: ['motor']"),
        (driver(5, 0), "motor", "status[0] is not a text: 5"),
        (driver("motor", "1"), "drivers[motor]", "level '1'"),
        (driver("motor", 1.5), "drivers[motor]", "level 1.5"),
    ],
)
def test_a_bad_message_is_invalid_data_until_the_next_one(message: dict[str, Any], signal: str, reason: str) -> None:
    name = signal.partition("[")[0]

    @scenario
    async def run() -> None:
        foreign = ForeignServer()
        watched = Watched(await foreign.start())
        node = watched.client.node("alert_system", parameters={"signals": {name: SIGNALS[name]}})
        system = AlertSystem(node)

        def shown() -> str:
            status = system.monitor.status(signal, node.now_s())
            return "" if status is None else status.message

        await until(lambda: watched.ups == [True])
        await foreign.publish("/in", message)
        await until(lambda: shown() == f"invalid data: {reason}")
        await foreign.publish("/in", GOOD.get(name, GOOD_JOINTS))
        await until(lambda: "invalid" not in shown())
        await watched.close()
        await foreign.close()

    run()


@pytest.mark.parametrize(
    "message", [{"effort": None}, {"effort": "12"}, {"effort": {"a": 1}}, {"name": None}, {"name": "wheel_left"}, {}]
)
def test_what_is_no_array_is_one_line_and_no_sample(message: dict[str, Any]) -> None:
    @scenario
    async def run() -> None:
        foreign = ForeignServer()
        watched = Watched(await foreign.start())
        node = watched.client.node("alert_system", parameters={"signals": {"wheels": SIGNALS["wheels"]}})
        system = AlertSystem(node)
        await until(lambda: watched.ups == [True])
        for _ in range(3):
            await foreign.publish("/in", {**GOOD_JOINTS, **message} if message else {})
        await foreign.publish("/in", GOOD_JOINTS)
        await until(lambda: "wheels[wheel_left]" in system.monitor.signals())
        assert len([line for line in watched.problems() if 'has no field effort["wheel_*"]' in line]) == 1
        await watched.close()
        await foreign.close()

    run()
