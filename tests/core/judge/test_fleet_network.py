"""A fleet whose network goes and comes: one alert per robot, in virtual time."""

from __future__ import annotations

import pytest

from robot_health_monitor.core import Level, Monitor, Sample, load_config
from robot_health_monitor.core.values.model import Transition

ROBOTS = 200
SIGNALS = {
    "left": {"topic": "/joint_states"},
    "right": {"topic": "/joint_states"},
    "scan": {"topic": "/scan", "depends_on": ["left"]},
}


def announced_by(robot: str, down_s: int, up_s: int) -> list[Transition]:
    """Returns what is announced while the network goes and comes ten times; the drivers never stop."""
    monitor = Monitor(load_config({"signals": SIGNALS}), robot=robot)
    monitor.expect_sources()
    found = [*monitor.set_link(True, "", 0.0)]
    is_up = True
    for second in range(60 + 10 * (down_s + up_s) + 60):
        in_period = (second - 60) % (down_s + up_s)
        was_up, is_up = is_up, not (60 <= second < 60 + 10 * (down_s + up_s) and in_period < down_s)
        if is_up is not was_up:
            found += monitor.set_link(is_up, "no route to host", float(second))
        for name in SIGNALS if is_up else ():
            found += monitor.observe(Sample(name, 1.0, float(second)))
        found += monitor.tick(second + 0.5)
    return found


@pytest.mark.newest_python
def test_a_fleet_whose_network_goes_and_comes_is_one_alert_per_robot() -> None:
    found = [each for number in range(ROBOTS) for each in announced_by(f"r{number}", down_s=7, up_s=5)]
    assert len([each for each in found if each.to_level is not Level.OK]) == ROBOTS
    assert {each.signal for each in found} == {"link"}
    assert len(found) == 2 * ROBOTS  # each begins and ends once
