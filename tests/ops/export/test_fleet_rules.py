"""The rules of a fleet, judged by promtool: silent robots, and robots that are no longer part of it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Mapping, Sequence

import pytest
from harness.promtool import needs_promtool, promtool

from robot_health_monitor.ops.export.prometheus import export_fleet_rules

pytestmark = pytest.mark.newest_python

TICK = 'robot_health_last_tick_timestamp_seconds{{robot="{}", instance="127.0.0.1:9090"}}'


def silent(robot: str, text: str) -> Mapping[str, Any]:
    return {
        "exp_labels": {"robot": robot, "signal": "monitor", "level": "ERROR", "severity": "critical"},
        "exp_annotations": {"summary": f"{robot}: monitor ERROR: has not reported for {text}"},
    }


def findings(
    folder: Path, rules: str, series: Mapping[str, str], expected: Sequence[tuple[str, list[Mapping[str, Any]]]]
) -> str:
    """Returns what promtool reports; empty if the alerts at these times are as expected. Values are a minute apart."""
    (folder / "rules.yaml").write_text(rules)
    test = {
        "interval": "1m",
        "input_series": [{"series": name, "values": values} for name, values in series.items()],
        "alert_rule_test": [
            {"eval_time": time, "alertname": "RobotHealth", "exp_alerts": alerts} for time, alerts in expected
        ],
    }
    (folder / "test.yaml").write_text(
        json.dumps({"rule_files": ["rules.yaml"], "evaluation_interval": "1m", "tests": [test]})
    )
    return promtool(folder, "test", "rules", "test.yaml")


def rules(expected: Any = None) -> str:
    return export_fleet_rules(expected, interval_s=15.0, silent_after_s=900.0)


@needs_promtool
def test_a_robot_is_an_alert_once_it_was_silent_for_longer_than_allowed_and_for_24_h_after_it_reported(
    tmp_path: Path,
) -> None:
    """By hand: last tick at 10 min; 16 min later it is pending, and one evaluation later firing."""
    series = {TICK.format("r1"): "0+60x10", TICK.format("r2"): "0+60x1500"}
    expected = [
        ("26m", []),
        ("27m", [silent("r1", "17m 0s")]),
        ("24h9m", [silent("r1", "23h 59m 0s")]),
        ("24h10m", []),
    ]

    assert findings(tmp_path, rules(), series, expected) == ""


@needs_promtool
def test_with_a_fleet_file_a_robot_must_report_and_one_that_left_it_is_no_alert(tmp_path: Path) -> None:
    series = {TICK.format("r1"): "0+60x10", TICK.format("left"): "0+60x10", TICK.format("r2"): "0+60x1600"}
    never = silent("never", "more than 15 min")
    expected = [
        ("5m", []),
        ("16m", [never]),
        ("27m", [silent("r1", "17m 0s"), never]),
        ("26h", [silent("r1", "1d 1h 50m 0s"), never]),
    ]

    assert findings(tmp_path, rules(["r1", "r2", "never"]), series, expected) == ""


@needs_promtool
def test_a_robot_that_reports_again_ends_its_alert_at_once(tmp_path: Path) -> None:
    series = {TICK.format("r1"): "0+60x10 " + "_ " * 29 + "2400+60x10"}

    assert findings(tmp_path, rules(), series, [("39m", [silent("r1", "29m 0s")]), ("41m", [])]) == ""


@needs_promtool
def test_a_monitor_that_hangs_while_its_metrics_are_still_served_has_not_reported(tmp_path: Path) -> None:
    series = {TICK.format("r1"): "0+60x10 600x30"}

    assert findings(tmp_path, rules(), series, [("26m", []), ("27m", [silent("r1", "17m 0s")])]) == ""


@needs_promtool
def test_after_an_outage_of_the_centre_no_robot_is_silent_before_it_could_report(tmp_path: Path) -> None:
    """By hand: the robot last reported an hour before the centre starts at 0 min, evaluating once a minute.

    The ninth evaluation of 15, at 8 min, is the first at which the centre ran for 60 % of the time.
    """
    remembered = {'robot_health:last_tick{robot="r1"}': "-3600"}
    back = {**remembered, TICK.format("r1"): "_x5 300+60x20"}

    assert findings(tmp_path, rules(), remembered, [("8m", []), ("9m", [silent("r1", "1h 9m 0s")])]) == ""
    assert findings(tmp_path, rules(), back, [(f"{minute}m", []) for minute in range(21)]) == ""


@needs_promtool
def test_a_decommissioned_robot_whose_alert_fires_ends_it_and_no_other(tmp_path: Path) -> None:
    """The rules are exported again without the robot: what the centre remembers of it raises nothing."""
    remembered = {f'robot_health:last_tick{{robot="{name}"}}': "-3600x20" for name in ("left", "r1")}
    remembered['robot_health:expected{robot="left"}'] = "1"  # recorded before

    assert findings(tmp_path, rules(["r1"]), remembered, [("15m", [silent("r1", "1h 15m 0s")])]) == ""
    two = [silent("left", "1h 15m 0s"), silent("r1", "1h 15m 0s")]
    assert findings(tmp_path, rules(["left", "r1"]), remembered, [("15m", two)]) == ""


def test_no_rule_depends_on_the_address_of_a_robot() -> None:
    for text in (rules(), rules(["r1"])):
        words = set(re.findall(r"\w+", re.sub("#.*", "", text)))
        assert not words & {"instance", "job", "up"}
