"""From the topics of a robot to the signals that are proposed, on the in-process middleware."""

from __future__ import annotations

import math
from typing import Any, Callable, Tuple

import pytest

from robot_health_monitor.core.messages.definitions import parse_definition
from robot_health_monitor.core.messages.standard_messages import definition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.proposal.candidates import Candidates, Topic
from robot_health_monitor.core.proposal.proposal import Proposed, propose
from robot_health_monitor.core.proposal.suggestion import Signal
from robot_health_monitor.core.proposal.thresholds_file import thresholds_text

Publisher = Tuple[str, str, float, Callable[[float], Any]]
"""Topic, type, rate in Hz, and the message at a time in s."""


def proposed_of(publishers: list[Publisher], lasts_s: float = 60.0) -> Proposed:
    return propose(heard(publishers, lasts_s))


def heard(publishers: list[Publisher], lasts_s: float) -> Candidates:
    bus = LocalBus(wall_time_s=lambda: 1.7e9 + bus.now_s)
    robot, candidates = bus.node("robot"), Candidates()
    for topic, type_name, rate_hz, message in publishers:
        robot.advertise(topic, type_name)

        def publish(now_s: float, topic: str = topic, message: Callable[[float], Any] = message) -> None:
            robot.publish(topic, message(now_s))

        robot.create_timer(1.0 / rate_hz, publish)
        candidates.add([Topic(topic, type_name, parse_definition(type_name, definition(type_name), "msg"))])
    candidates.listen(bus.node("survey"), [topic for topic, *_ in publishers])
    bus.run_until(lasts_s)
    return candidates


def by_name(proposed: Proposed) -> dict[str, Signal]:
    return {signal.name: signal for signal in proposed.signals}


def stamped(age_s: float, **fields: Any) -> Callable[[float], Any]:
    def message(now_s: float) -> Any:
        nanoseconds = round((1.7e9 + now_s - age_s) * 1e9)
        return {"header": {"stamp": {"secs": nanoseconds // 10**9, "nsecs": nanoseconds % 10**9}}, **fields}

    return message


def test_a_periodic_topic_has_bounds_of_its_rate_and_of_its_silence() -> None:
    found = by_name(proposed_of([("/a", "std_msgs/String", 10.0, lambda now_s: {})]))["a_rate"]
    assert found.settings == {
        "topic": "a", "type": "std_msgs/String", "field": "", "statistic": "frequency_hz",
        "warn_below": 7.0, "warn_above": 13.0, "stale_after_s": 1.0,
    }  # fmt: skip


def test_a_topic_that_is_not_periodic_is_listed() -> None:
    proposed = proposed_of([("/a", "std_msgs/String", 0.1, lambda now_s: {})])
    assert proposed.signals == []
    assert proposed.not_watched == {"/a": "only 6 messages in 50 s: a rate needs 20"}
    assert proposed.fields == {("/a", "data"): "text"}
    silent = proposed_of([("/a", "std_msgs/String", 0.001, lambda now_s: {})])
    assert (silent.not_watched, silent.fields) == ({"/a": "no message"}, {})


def test_the_age_of_stamps_is_watched_where_it_is_a_delay() -> None:
    image: Publisher = ("/image", "sensor_msgs/Image", 10.0, stamped(0.05))
    found = by_name(proposed_of([image]))
    assert set(found) == {"image_rate", "image_age"}
    assert (found["image_age"].settings["warn_above"], found["image_age"].settings["for_s"]) == (1.0, 3.0)
    for age_s, text in ((-0.5, "-0.5 s"), (7200.0, "2 h")):
        proposed = proposed_of([("/image", "sensor_msgs/Image", 10.0, stamped(age_s))])
        assert set(by_name(proposed)) == {"image_rate"}
        assert proposed.fields["/image", "header.stamp"].startswith(f"stamps are {text}")


def test_a_battery_has_a_charge_in_percent_by_rule_and_a_cell_spread() -> None:
    message = {"percentage": 0.83, "cell_voltage": [4.0, 4.01], "voltage": 24.0}
    found = by_name(proposed_of([("/b", "sensor_msgs/BatteryState", 2.0, lambda now_s: message)]))
    charge, spread = found["b_percentage"].settings, found["b_cell_spread"].settings
    assert (charge["scale"], charge["unit"], charge["warn_below"], charge["error_below"]) == (100.0, "%", 20.0, 10.0)
    assert (spread["reduce"], spread["warn_above"], spread["error_above"]) == ("spread", 0.12, 0.2)


def test_a_bound_that_the_robot_is_beyond_is_only_shown() -> None:
    found = by_name(proposed_of([("/b", "sensor_msgs/BatteryState", 2.0, lambda now_s: {"percentage": 15.0})]))
    charge = found["b_percentage"]
    assert (charge.settings["scale"], charge.settings["error_below"]) == (1.0, 10.0)
    assert "warn_below" not in charge.settings
    assert charge.seen["warn_below"].value == 20.0


@pytest.mark.newest_python
def test_efforts_are_shown_by_joint_and_watched_after_10_minutes() -> None:
    def message(now_s: float) -> Any:
        return {"name": ["left"], "effort": [math.sin(now_s)]}

    joints: Publisher = ("/joints", "sensor_msgs/JointState", 5.0, message)
    short, long = by_name(proposed_of([joints])), by_name(proposed_of([joints], 620.0))
    assert short["joints_effort_left"].is_shown_only
    assert long["joints_effort_left"].settings["field"] == 'effort["left"]'
    assert long["joints_effort_left"].has_bounds


def test_all_statuses_are_watched_by_one_signal() -> None:
    message = {"status": [{"level": 0, "name": "motor"}, {"level": 0, "name": "laser"}]}
    found = proposed_of([("/diagnostics", "diagnostic_msgs/DiagnosticArray", 1.0, lambda now_s: message)])
    (signal,) = found.signals
    assert signal.settings["field"] == 'status["*"]'
    assert signal.proposed["stale_after_s"].evidence.startswith("2 statuses seen")
    assert signal.note == ""
    empty = proposed_of([("/diagnostics", "diagnostic_msgs/DiagnosticArray", 1.0, lambda now_s: {})])
    assert (empty.signals, empty.not_watched) == ([], {"/diagnostics": "no status"})


def test_drivers_that_are_not_ok_while_the_robot_is_listened_to_are_named() -> None:
    message = {"status": [{"level": 2, "name": "motor"}, {"level": 0, "name": "laser"}, {"level": 1, "name": "lamp"}]}
    (signal,) = proposed_of([("/diagnostics", "diagnostic_msgs/DiagnosticArray", 1.0, lambda now_s: message)]).signals
    assert signal.note == "these were not always OK, and raise alerts: lamp, motor"


@pytest.mark.newest_python
def test_the_gap_of_a_fast_topic_is_watched_once_it_was_seen_for_10_minutes() -> None:
    fast: Publisher = ("/a", "std_msgs/String", 20.0, lambda now_s: {})
    other: Publisher = ("/a_gap", "std_msgs/Float32", 2.0, lambda now_s: {"data": math.sin(now_s)})
    assert set(by_name(proposed_of([fast]))) == {"a_rate"}
    found = by_name(proposed_of([fast, other], 620.0))
    assert set(found) == {"a_rate", "a_gap_2", "a_gap_rate", "a_gap"}
    assert found["a_gap_2"].settings == {
        "topic": "a", "type": "std_msgs/String", "field": "", "statistic": "largest_gap_s",
        "warn_above": 0.25, "stale_after_s": 1.0,
    }  # fmt: skip


@pytest.mark.newest_python
def test_a_forecast_of_charge_is_watched_where_a_replay_of_two_windows_had_no_alert() -> None:
    battery: Publisher = ("/b", "sensor_msgs/BatteryState", 0.5, lambda now_s: {"percentage": 0.9 - now_s * 1e-5})
    candidates = heard([battery], 1300.0)
    assert "b_percentage_soon" not in by_name(propose(candidates))
    watched = by_name(propose(candidates, {}))["b_percentage_soon"]
    assert watched.settings == {
        "topic": "b", "type": "sensor_msgs/BatteryState", "field": "percentage", "scale": 100.0, "unit": "%",
        "valid_min": 0.0, "valid_max": 100.0, "statistic": "forecast", "window_s": 600.0, "forecast_s": 1800.0,
        "warn_below": 20.0, "for_s": 300.0, "stale_after_s": 10.0,
    }  # fmt: skip
    assert by_name(propose(candidates, {"b_percentage_soon": 4.0}))["b_percentage_soon"].is_shown_only
    assert by_name(propose(heard([battery], 1200.0), {}))["b_percentage_soon"].is_shown_only


def test_a_temperature_has_a_forecast_and_a_charge_beyond_its_bound_or_its_range_has_none() -> None:
    hot: Publisher = ("/t", "sensor_msgs/Temperature", 2.0, lambda now_s: {"temperature": 50.0 + math.sin(now_s)})
    low: Publisher = ("/b", "sensor_msgs/BatteryState", 2.0, lambda now_s: {"percentage": 0.15})
    odd: Publisher = ("/c", "sensor_msgs/BatteryState", 2.0, lambda now_s: {"percentage": 150.0})
    found = by_name(propose(heard([hot, low, odd], 60.0), {}))
    assert [name for name in found if name.endswith("_soon")] == ["t_temperature_soon"]
    assert found["t_temperature_soon"].seen["warn_above"].value == 80.0


@pytest.mark.newest_python
def test_how_long_to_listen_is_known_of_what_came_too_rarely() -> None:
    """60 samples of 1 Hz in 59 s: 100 take 100 s, and two minutes are enough."""
    rare: Publisher = ("/a", "std_msgs/Float32", 1.0, lambda now_s: {"data": now_s})
    often: Publisher = ("/b", "std_msgs/Float32", 5.0, lambda now_s: {"data": now_s})
    proposed = propose(heard([rare, often], 60.0))
    reason = "no bounds: only 60 valid samples in 59 s; a range needs 100: listen for 120 s"
    assert proposed.fields["/a", "data"] == reason
    assert proposed.fields["/b", "data"] == "no bounds: the value only rises: looks like a counter"
    assert "listen for" not in propose(heard([rare], 120.0)).fields["/a", "data"]


@pytest.mark.newest_python
def test_an_array_of_numbers_gets_lines_like_a_number() -> None:
    def message(now_s: float) -> Any:
        return {"data": [math.sin(now_s), 5.0 + math.cos(now_s), 2.0]}

    array: Publisher = ("/a", "std_msgs/Float32MultiArray", 5.0, message)
    found = by_name(proposed_of([array]))
    assert found["a_max"].is_shown_only
    assert found["a_max"].given["field"] == "data[*]"
    assert found["a_max"].seen["warn_above"].value == 6.2  # 6, and 10 % of 4 to 6
    found = by_name(proposed_of([array], 610.0))
    assert found["a_min"].settings["warn_below"] < -1.0 < 1.0 < found["a_min"].settings["warn_above"]


@pytest.mark.newest_python
def test_elements_beyond_the_limit_are_listed() -> None:
    joints = {"name": [f"j{number}" for number in range(70)], "effort": [1.0] * 70}
    proposed = proposed_of([("/j", "sensor_msgs/JointState", 5.0, lambda now_s: joints)])
    assert proposed.fields["/j", 'effort["*"]'] == "more than 64 elements: the others are left out"


def test_actions_are_shown_and_their_bound_is_a_comment() -> None:
    candidates = Candidates("robot1")
    candidates.add(
        [
            Topic("/robot1/navigate/_action/status", "action_msgs/GoalStatusArray", None),
            Topic("/robot1/navigate/_action/feedback", "example/Feedback", None),
            Topic("/dock/status", "actionlib_msgs/GoalStatusArray", None),
        ]
    )
    proposed = propose(candidates)
    assert thresholds_text([], {}, proposed).splitlines() == [
        "alert_system:",
        "  ros__parameters:",
        "    signals:",
        "      dock_goals:",
        "        # goals that ended",
        "        action: /dock",
        "        statistic: mean",
        "        window_s: 1200.0",
        "        window_min_s: 0.0",
        "        # warn_above: 0.5           # a guess: more than half of the goals of the last 20 min were aborted",
        "      navigate_goals:",
        "        # goals that ended",
        "        action: navigate",
        "        statistic: mean",
        "        window_s: 1200.0",
        "        window_min_s: 0.0",
        "        # warn_above: 0.5           # a guess: more than half of the goals of the last 20 min were aborted",
        "    # Not watched:",
        "    #   /robot1/navigate/_action/feedback: a topic of the middleware",
    ]


def test_states_of_goals_on_a_topic_that_is_no_actions_are_a_topic_like_others() -> None:
    candidates = Candidates()
    candidates.add([Topic("/goals", "actionlib_msgs/GoalStatusArray", None)])
    assert propose(candidates).not_watched == {"/goals": "no message"}


def test_a_proposed_action_raises_no_alert_in_the_ten_minutes_after() -> None:
    """Not even if its first goals are aborted: the bound is a comment."""
    candidates = Candidates()
    candidates.add([Topic("/dock/status", "actionlib_msgs/GoalStatusArray", None)])
    (signal,) = propose(candidates).signals
    bus, alerts = LocalBus(), []
    server = bus.node("server")
    server.advertise("/dock/status", "actionlib_msgs/GoalStatusArray")
    system = AlertSystem(
        bus.node("alert_system", parameters={"signals": {signal.name: signal.settings}}), {"test": alerts.append}
    )
    server.publish("/dock/status", {"status_list": []})
    server.publish("/dock/status", {"status_list": [{"goal_id": {"id": "a"}, "status": 4}]})
    bus.run_until(600.0)
    assert system.monitor.judgements(0.0)["dock_goals"].judged == 1.0
    assert alerts == []
