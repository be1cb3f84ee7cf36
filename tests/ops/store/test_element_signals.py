"""Signals that come and go, in everything that operators use: page, metrics, history, silences."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Any, Mapping

import pytest

pytest.importorskip("prometheus_client", reason="prometheus_client, whose parser reads the metrics, is not installed")
pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from harness.web import Robots
from prometheus_client.parser import text_string_to_metric_families

from robot_health_monitor.core.values.elements import DriverStatus, Elements
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.store.matchers import Matcher, parse_matchers
from robot_health_monitor.ops.store.summary import summarize
from robot_health_monitor.ops.web.metrics import Metrics
from robot_health_monitor.ops.web.state import OwnState, RobotReader
from robot_health_monitor.ops.web.updates import RobotState, State, changes
from robot_health_monitor.runtime.http_answers import json_bytes

ODD = 'a, "b" = [c]: \\d*'
DRIVERS: Mapping[str, Any] = {
    "drivers": {
        "topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]',
        "stale_after_s": 5.0, "forget_after_s": 20.0,
    }
}  # fmt: skip


def report(robots: Robots, **levels: int) -> None:
    statuses = Elements((name, DriverStatus(level, "no returns")) for name, level in levels.items())
    robots.observe(statuses, "drivers")


def series(metrics: Metrics, robots: Robots) -> dict[str, list[str]]:
    """Returns the names of the signals by metric."""
    body = b"".join(metrics.render([metrics.read(robot) for robot in robots.all]))
    found: dict[str, list[str]] = {}
    for family in text_string_to_metric_families(body.decode("utf-8")):
        for sample in family.samples:
            found.setdefault(sample.name, []).append(sample.labels.get("signal", ""))
    return found


def test_page_and_metrics_show_elements_as_they_come_and_go() -> None:
    robots, metrics = Robots(signals=DRIVERS), Metrics()
    reader = RobotReader(robots.all[0], OwnState(lambda: robots.all, dict), robots.wall_s)
    empty = reader.state(window=False)
    assert list(empty["signals"]) == ["drivers"]
    report(robots, lidar=2, **{ODD: 0})
    state = reader.state(window=True)
    assert {name: each["level"] for name, each in state["signals"].items()} == {
        "drivers": "OK", "drivers[lidar]": "ERROR", f"drivers[{ODD}]": "OK",
    }  # fmt: skip
    lidar = state["signals"]["drivers[lidar]"]
    assert (lidar["text"], lidar["message"], lidar["value"], lidar["bounds"]) == ("ERROR", "no returns", 2.0, [])
    assert state["signals"]["drivers"]["text"] == "2 elements"
    assert (state["signal"], state["message"]) == ("drivers[lidar]", "no returns")
    # A page that is open gets the whole state when signals come or go.
    before, after = (State({}, {"atlas": RobotState(each["level"], json_bytes(each))}) for each in (empty, state))
    assert changes(before, after) is None
    assert list(reader.samples().event["signals"]) == ["drivers", "drivers[lidar]", f"drivers[{ODD}]"]
    assert series(metrics, robots)["robot_health_level"] == ["drivers", "drivers[lidar]", f"drivers[{ODD}]"]
    for second in range(101, 130):
        robots.at(float(second))
        report(robots, lidar=0)
    assert list(reader.state(window=True)["signals"]) == ["drivers", "drivers[lidar]"]
    assert list(reader.samples().event["signals"]) == ["drivers", "drivers[lidar]"]
    assert series(metrics, robots)["robot_health_transitions_total"] == ["drivers"] * 4 + ["drivers[lidar]"] * 4


@pytest.mark.parametrize("matchers", ["signal=drivers[*", "signal=drivers[lidar]", "signal=drivers*,robot=atlas"])
def test_a_silence_matches_elements(tmp_path: Path, matchers: str) -> None:
    robots = Robots(signals=DRIVERS, history_file=str(tmp_path / "history.db"))
    report(robots, lidar=2, motor=2)
    assert robots.silences is not None
    robots.silences.add(parse_matchers(matchers), for_s=60.0, reason="test")
    reader = RobotReader(robots.all[0], OwnState(lambda: robots.all, dict), robots.wall_s)
    silenced = {name: each["silenced"] for name, each in reader.state(window=False)["signals"].items()}
    assert silenced["drivers[lidar]"] == "test"
    assert silenced["drivers[motor]"] == (None if "lidar" in matchers else "test")


def test_a_silence_of_an_element_with_an_odd_name_matches_it_alone(tmp_path: Path) -> None:
    robots = Robots(signals=DRIVERS, history_file=str(tmp_path / "history.db"))
    report(robots, lidar=2, **{ODD: 2})
    assert robots.silences is not None
    robots.silences.add([Matcher("signal", True, f"drivers[{ODD}]")], for_s=60.0, reason="test")
    assert robots.silence_text("atlas", f"drivers[{ODD}]") == "test"
    assert robots.silence_text("atlas", "drivers[lidar]") is None


def test_time_after_an_element_ended_is_unknown_in_the_summary(tmp_path: Path) -> None:
    robots = Robots(signals=DRIVERS, history_file=str(tmp_path / "history.db"))
    report(robots, lidar=0)
    for second in range(101, 201):
        robots.at(float(second))
    robots.all[0].close()
    assert robots.history is not None
    robots.history.close()
    with sqlite3.connect(str(tmp_path / "history.db")) as connection:
        (lidar,) = summarize(connection, robots.wall_s(), signal="drivers[lidar]")
    # OK until 106, STALE until 121, then no longer watched until 200.
    assert lidar.shares == pytest.approx({Level.OK: 0.06, Level.STALE: 0.15})
    assert lidar.unknown == pytest.approx(0.79)


def test_a_history_restores_elements_and_ends_those_that_are_no_longer_configured(tmp_path: Path) -> None:
    file = str(tmp_path / "history.db")
    robots = Robots(signals=DRIVERS, history_file=file)
    report(robots, lidar=2, **{ODD: 1})
    robots.at(103.0)
    robots.all[0].close()
    assert robots.history is not None
    robots.history.close()

    robots = Robots(signals=DRIVERS, history_file=file)
    assert sorted(robots.all[0].monitor.signals()) == ["drivers", f"drivers[{ODD}]", "drivers[lidar]"]
    report(robots, lidar=2, **{ODD: 0})
    assert {name: level.name for name, (level, _) in robots.all[0].monitor.levels().items()} == {
        "drivers": "OK", "drivers[lidar]": "ERROR", f"drivers[{ODD}]": "OK",
    }  # fmt: skip
    robots.all[0].close()
    assert robots.history is not None
    robots.history.close()

    robots = Robots(signals={"battery_level": {}}, history_file=file)
    assert list(robots.all[0].monitor.signals()) == ["battery_level"]
    assert robots.history is not None
    robots.history.close()
