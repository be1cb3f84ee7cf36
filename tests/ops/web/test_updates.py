"""The difference of two states; test_interface.py has the events that pages receive."""

from __future__ import annotations

import copy
import json
from typing import Any

from robot_health_monitor.ops.web import updates
from robot_health_monitor.ops.web.updates import RobotState, State
from robot_health_monitor.runtime.http_answers import json_bytes


def state() -> dict[str, Any]:
    signal = {"level": "OK", "value": 50.0, "bounds": [{"level": "WARN"}], "silenced": None}
    robot = {"level": "OK", "since": None, "signals": {"battery": signal, "motor": dict(signal)}}
    return {"now": "t0", "worst": "OK", "silences": [], "robots": {"atlas": robot, "spot": copy.deepcopy(robot)}}


def encoded(found: dict[str, Any]) -> State:
    robots = {name: RobotState(robot["level"], json_bytes(robot)) for name, robot in found["robots"].items()}
    return State({key: value for key, value in found.items() if key != "robots"}, robots)


def changes(before: dict[str, Any], after: dict[str, Any]) -> Any:
    return updates.changes(encoded(before), encoded(after))


def test_a_state_is_encoded_with_its_robots() -> None:
    assert json.loads(b"".join(encoded(state()).parts())) == state()


def test_the_state_of_each_robot_is_a_part_of_its_own_and_is_not_copied() -> None:
    whole = encoded(state())
    parts = list(whole.parts())
    assert all(any(part is robot.data for part in parts) for robot in whole.robots.values())


def test_nothing_changed() -> None:
    assert changes(state(), state()) == {}


def test_only_changed_keys_are_given_and_values_replace_one_another() -> None:
    after = state()
    after["now"] = "t1"
    after["silences"] = [{"id": "1"}]
    after["robots"]["spot"]["level"] = "WARN"
    after["robots"]["spot"]["signals"]["motor"].update(level="WARN", value=None, bounds=[])
    assert changes(state(), after) == {
        "now": "t1",
        "silences": [{"id": "1"}],
        "robots": {"spot": {"level": "WARN", "signals": {"motor": {"level": "WARN", "value": None, "bounds": []}}}},
    }


def test_other_robots_or_signals_are_no_change_but_a_new_state() -> None:
    without_robot, without_signal, reordered = state(), state(), state()
    del without_robot["robots"]["spot"]
    del without_signal["robots"]["spot"]["signals"]["motor"]
    reordered["robots"] = dict(reversed(list(reordered["robots"].items())))
    for other in (without_robot, without_signal, reordered):
        assert changes(state(), other) is None
        assert changes(other, state()) is None
