"""Signals with `where` and `statistic: count`: errors in the log, in process and over bridges, of both kinds of ROS."""

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

ERRORS: Mapping[str, Any] = {
    "topic": "/rosout", "where": "level >= ERROR", "field": "", "statistic": "count", "window_s": 60.0,
    "warn_above": 5.0,
}  # fmt: skip


def log_of_ros1(level: int, name: str = "/planner") -> dict[str, Any]:
    header = {"seq": 1, "stamp": {"secs": 1, "nsecs": 0}, "frame_id": ""}
    place = {"file": "", "function": "", "line": 0, "topics": []}
    return {"header": header, "level": level, "name": name, "msg": "failed", **place}


def log_of_ros2(level: int, name: str = "planner") -> dict[str, Any]:
    place = {"file": "", "function": "", "line": 0}
    return {"stamp": {"sec": 1, "nanosec": 0}, "level": level, "name": name, "msg": "failed", **place}


LOGS = [("rosgraph_msgs/Log", log_of_ros1, (1, 2, 4, 8, 16)), ("rcl_interfaces/Log", log_of_ros2, (10, 20, 30, 40, 50))]


@pytest.mark.parametrize(("type_name", "log", "levels"), LOGS)
def test_errors_in_the_log_give_the_same_line_on_both_generations_of_ros(type_name: str, log: Any, levels: Any) -> None:
    stage = Stage()
    system, _ = stage.alert_system({"signals": {"errors": ERRORS}})
    peer = stage.bus.node("planner")
    peer.advertise("/rosout", type_name)
    for second in range(12):
        stage.bus.run_until(600.0 + second)
        for level in levels[: 5 if second % 2 else 3]:  # an error and a fatal every two seconds
            peer.publish("/rosout", log(level))
    stage.bus.run_until(700.0)
    assert stage.log(Severity.WARN, Severity.ERROR) == ["errors WARN: 6 in 60 s is above 5 (was OK for 10 min 4 s)"]
    # Two errors at 601 s, 603 s and so on until 611 s: at 667 s those of 609 s and 611 s are left.
    assert [line for line in stage.log(Severity.INFO) if line.startswith("errors OK")] == [
        "errors OK: 4 in 60 s is no longer above 5 (was WARN for 62 s)"
    ]
    assert system.monitor.report(700.0).statuses["errors"].values["bad_samples"] == "0"


@pytest.mark.parametrize(("type_name", "log", "levels"), LOGS)
@pytest.mark.parametrize("harness", [RosbridgeHarness, FoxgloveHarness])
def test_errors_in_the_log_are_counted_over_a_bridge(harness: Any, type_name: str, log: Any, levels: Any) -> None:
    ros = harness()
    try:
        # This project's server, which serves the harness, has its own /rosout.
        signal = {**ERRORS, "topic": "/robot1/rosout", "where": 'level >= ERROR and name == "*plan?er"'}
        system = AlertSystem(ros.node("alert_system", parameters={"signals": {"errors": signal}}))
        for number, (level, name) in enumerate([*((level, "/planner") for level in levels), (levels[3], "/other")], 1):
            ros.publish("/robot1/rosout", type_name, log(level, name))
            ros.wait_until(lambda: system.samples >= number)  # noqa: B023 - it is called at once
        assert system.read(lambda monitor, _: monitor.judgements(0.0)["errors"].judged) == 2.0
    finally:
        ros.close()


@pytest.mark.parametrize("harness", [RosbridgeHarness, FoxgloveHarness])
def test_frames_are_judged_by_themselves_over_a_bridge(harness: Any) -> None:
    ros = harness()
    try:
        field = {"topic": "/tf", "field": 'transforms["*"].header.stamp', "stale_after_s": 2.0}
        base = {"topic": "/tf", "field": 'transforms["base_link"].transform.translation.x'}
        said: list[Any] = []
        parameters = {"signals": {"frames": field, "base": base}}
        system = AlertSystem(ros.node("alert_system", parameters=parameters), {"test": said.append}, log_alerts=False)
        for second in range(101, 105):
            ros.set_time(float(second))
            transform = {"translation": {"x": second / 4.0}}
            frames = [
                {"header": {"stamp": {"sec": second, "nanosec": 0}}, "child_frame_id": name, "transform": transform}
                for name in (("base_link", "camera") if second == 101 else ("base_link",))
            ]
            ros.publish("/tf", "tf2_msgs/TFMessage", {"transforms": frames})
            ros.wait_until(lambda: system.samples >= 2 * (second - 100))  # noqa: B023 - it is called at once
        ros.wait_until(lambda: bool(said))
        assert [event.text for event in said] == [
            "frames[camera] STALE: no sample for 3 s (limit 2 s) (was OK for 3 s)"
        ]
        assert system.monitor.fresh_value("base") == 26.0
    finally:
        ros.close()


def test_an_unknown_constant_of_a_message_without_definition_is_one_line_in_the_log() -> None:
    stage = Stage()
    stage.alert_system({"signals": {"errors": {**ERRORS, "where": "level >= ERRROR"}}})
    peer = stage.bus.node("planner")
    peer.advertise("/rosout", "rcl_interfaces/Log")
    for _ in range(3):
        peer.publish("/rosout", log_of_ros2(40))
    (line,) = stage.log(Severity.ERROR)
    assert line == (
        "/rosout (rcl_interfaces/Log) does not have all of  where level >= ERRROR; "
        "available: stamp, level, name, msg, file, function, line"
    )


def test_messages_that_do_not_match_are_signs_of_life_of_the_source_and_no_samples() -> None:
    stage = Stage()
    signals = {
        "hot": {"topic": "/motor", "where": "data > 80.0", "stale_after_s": 5.0},
        "cold": {"topic": "/motor", "where": "data < 0.0", "stale_after_s": 5.0},
        "motor": {"topic": "/motor", "stale_after_s": 5.0},
    }
    stage.alert_system({"signals": signals})
    for second in range(30):
        stage.bus.run_until(float(second))
        if second < 22:
            stage.publish("/motor", 90.0 if second == 0 else 60.0)
    # Nothing matched for hot and cold, but the topic was alive; then it fell silent, which is the alert of the source.
    assert stage.log(Severity.WARN, Severity.ERROR) == [
        "hot STALE: no sample for 6 s (limit 5 s) (was OK for 6 s)",
        "cold STALE: no sample since the start 11 s ago (limit 10 s) (was unknown for 11 s)",
        "/motor STALE: no message for 6 s (limit 5 s): 3 signals (was OK for 27 s)",
    ]


def test_where_concerns_the_whole_message_with_elements_and_reductions() -> None:
    stage = Stage()
    field = {"topic": "/cells", "field": "cell_voltage[*]", "where": "voltage > 10.0"}
    system, _ = stage.alert_system({"signals": {"cells": field, "weakest": {**field, "reduce": "min"}}})
    peer = stage.bus.node("battery")
    peer.advertise("/cells", "sensor_msgs/BatteryState")
    for voltage, cells in ((9.0, [1.0, 2.0]), (12.0, [3.0, 4.0]), (9.0, [5.0, 6.0])):
        peer.publish("/cells", {"voltage": voltage, "cell_voltage": cells})
    found = {name: system.monitor.fresh_value(name) for name in ("cells[0]", "cells[1]", "weakest")}
    assert found == {"cells[0]": 3.0, "cells[1]": 4.0, "weakest": 3.0}


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            {"where": "level >="},
            "where: expected comparisons such as level >= ERROR and name == \"*arm*\", got 'level >='",
        ),
        ({"where": ""}, "where: expected comparisons such as level >= ERROR and name == \"*arm*\", got ''"),
        ({"window_min_s": 0.0}, "window_min_s: a count is defined from the start; remove this key"),
        ({"error_above": 6001}, "error_above: expected at most window_samples (6000), got 6001"),
        ({"forecast_s": 60.0}, "forecast_s: expected statistic: forecast with it, got 'count'"),
    ],
)
def test_what_contradicts_a_condition_or_a_count_is_refused(changes: Mapping[str, Any], problem: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config({"signals": {"errors": {**ERRORS, **changes}}})
    assert str(caught.value) == f"signals.errors.{problem}"


def test_the_settings_of_a_count_are_read_as_the_same_signal() -> None:
    config = load_config({"signals": {"errors": ERRORS}}).signals["errors"]
    assert (config.stale_after_s, config.window_min_s) == (0.0, 0.0)
    kept = settings_of(config)
    assert load_config({"signals": {"errors": kept}}).signals["errors"] == config
