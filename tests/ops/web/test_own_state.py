"""The state of the monitor itself; test_interface.py has where it is shown."""

from __future__ import annotations

import pytest

pytest.importorskip("aiohttp", reason="aiohttp, which serves the page, is not installed")

from harness.web import Robots

from robot_health_monitor.core.faults import Faults
from robot_health_monitor.ops.web.own_state import OwnState


def test_the_faults_of_several_robots_name_the_robot() -> None:
    robots, process = Robots("husky", "carter"), Faults()
    husky, carter = robots.all
    own = OwnState(lambda: robots.all, process.current)
    process.report("history", "disk full")
    robots.bus.nodes[1].faults.report("topic /scan", "dropped")
    assert own.texts() == ["history: disk full", "carter: topic /scan: dropped"]
    assert own.count() == 2
    assert own.as_json()["message"] == "history: disk full"
    process.clear("history")
    assert own.as_json()["message"] == "carter: topic /scan: dropped"
    assert own.of_robot(husky) == {"level": "OK", "message": "no faults"}
    assert own.of_robot(carter) == {"level": "ERROR", "message": "topic /scan: dropped"}


def test_a_fault_of_the_process_concerns_every_robot() -> None:
    robots, process = Robots(), Faults()
    own = OwnState(lambda: robots.all, process.current)
    process.report("pager", "cannot be reached")
    assert own.of_robot(robots.all[0]) == {"level": "ERROR", "message": "pager: cannot be reached"}
