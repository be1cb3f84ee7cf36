"""Signals of actions, on the in-process middleware and over bridges, with the messages of both generations of ROS."""

from __future__ import annotations

from typing import Any, Mapping

import pytest
from harness.foxglove import FoxgloveHarness
from harness.rosbridge import RosbridgeHarness
from harness.stage import Stage

from robot_health_monitor.core.config.kept_settings import settings_of
from robot_health_monitor.core.config.monitor_config import load_config
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.port.middleware import Severity
from robot_health_monitor.core.values.errors import ConfigError

NAV: Mapping[str, Any] = {
    "action": "/navigate_to_pose", "statistic": "mean", "window_s": 1200.0, "window_min_s": 0.0, "warn_above": 0.5
}  # fmt: skip


def ros1(codes: str) -> Any:
    ended = [{"goal_id": {"id": str(at)}, "status": {"s": 3, "a": 4, "c": 2}[code]} for at, code in enumerate(codes)]
    return {"status_list": ended}


def ros2(codes: str) -> Any:
    status = {"s": 4, "a": 6, "c": 5}
    return {
        "status_list": [
            {"goal_info": {"goal_id": {"uuid": [at] * 16}}, "status": status[code]} for at, code in enumerate(codes)
        ]
    }


@pytest.mark.parametrize(
    ("topic", "type_name", "message"),
    [
        ("/navigate_to_pose/status", "actionlib_msgs/GoalStatusArray", ros1),
        ("/navigate_to_pose/_action/status", "action_msgs/GoalStatusArray", ros2),
    ],
)
def test_aborted_goals_give_the_same_line_on_both_generations_of_ros(topic: str, type_name: str, message: Any) -> None:
    stage = Stage()
    stage.alert_system({"robot_name": "robot1", "signals": {"nav_goals": NAV}})
    peer = stage.bus.node("navigator")
    peer.advertise(topic, type_name)
    for now_s, codes in ((0.0, "a"), (1.0, "as"), (2.0, "asc"), (3.0, "ascsaa"), (721.0, "ascsaaa")):
        stage.bus.run_until(now_s)
        peer.publish(topic, message(codes))
    assert stage.log(Severity.WARN, Severity.ERROR) == [
        "nav_goals WARN: mean 0.6 is above 0.5 (3 of 5 goals aborted) (was OK for 12 min)"
    ]


def test_an_action_without_goals_is_never_stale() -> None:
    stage = Stage()
    stage.alert_system({"signals": {"nav_goals": NAV}})
    stage.bus.run_until(3600.0)
    assert stage.log(Severity.WARN, Severity.ERROR) == []


@pytest.mark.parametrize(
    ("key", "value", "error"),
    [
        ("topic", "/status", "signals.nav_goals.action: expected one of topic, action, .*, got topic and action"),
        ("type", "std_msgs/Float32", "signals.nav_goals.type: the goals of an action have no field; remove this key"),
        ("field", "value", "signals.nav_goals.field: the goals of an action have no field; remove this key"),
    ],
)
def test_what_belongs_to_a_topic_is_refused_beside_an_action(key: str, value: str, error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        load_config({"signals": {"nav_goals": {**NAV, key: value}}})


def test_the_settings_of_an_action_are_read_as_the_same_signal() -> None:
    config = load_config({"signals": {"nav_goals": {**NAV, "stale_after_s": 5.0}}}).signals["nav_goals"]
    kept = settings_of(config)
    assert kept == {**NAV, "stale_after_s": 5.0}
    assert load_config({"signals": {"nav_goals": kept}}).signals["nav_goals"] == config


@pytest.mark.parametrize("harness", [RosbridgeHarness, FoxgloveHarness])
def test_goals_are_counted_over_a_bridge(harness: Any) -> None:
    ros = harness()
    topic, type_name = "/dock/status", "actionlib_msgs/GoalStatusArray"
    try:
        signal = {"action": "/dock", "statistic": "mean", "window_min_s": 0.0, "error_above": 0.9}
        system = AlertSystem(ros.node("alert_system", parameters={"signals": {"goals": signal}}))

        def publish(*codes: int) -> None:
            ended = [{"goal_id": {"id": str(at)}, "status": code} for at, code in enumerate(codes)]
            ros.publish(topic, type_name, {"status_list": ended})

        publish(4, 1)
        ros.wait_until(lambda: system.samples >= 1)
        publish(4, 3, 4)
        ros.wait_until(lambda: system.monitor.judgements(0.0)["goals"].judged == 0.5)
    finally:
        ros.close()
