"""What `init` proposes for a whole robot: silent for the ten minutes that follow, and then 20 faults are found."""

from __future__ import annotations

from pathlib import Path
from typing import List, Tuple

import pytest
import yaml
from harness.whole_robot import FAULTS, WholeRobot, send_frames, send_log

from robot_health_monitor.core.messages.definitions import parse_definition
from robot_health_monitor.core.messages.standard_messages import definition
from robot_health_monitor.core.nodes import AlertSystem
from robot_health_monitor.core.nodes.outlets import Event
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.proposal.candidates import Candidates, Topic
from robot_health_monitor.core.proposal.nodes import Nodes
from robot_health_monitor.core.proposal.proposal import propose
from robot_health_monitor.core.proposal.thresholds_file import thresholds_text
from robot_health_monitor.core.values.model import Level, Transition

pytestmark = pytest.mark.newest_python

FAULT_S = 40.0
RECOVERY_S = 50.0
Lines = List[Tuple[str, str]]


def listened(lasts_s: float) -> tuple[LocalBus, WholeRobot, str]:
    """Returns the robot and the proposed file after some virtual time."""
    bus = LocalBus(wall_time_s=lambda: 1.7e9 + bus.now_s)
    robot, candidates, nodes = WholeRobot(bus.node("robot")), Candidates(), Nodes()
    send_frames(bus.node("localization"), {"odom": 0.02, "base_link": -0.5}, ())
    send_log(bus.node("talkative"))
    bus.node("planner").advertise_service(
        "/planner/get_state", "lifecycle_msgs/GetState", lambda request: {"current_state": {"id": 3}}
    )
    for topic, type_name in bus.graph().topics.items():
        candidates.add([Topic(topic, type_name, parse_definition(type_name, definition(type_name), "msg"))])
    nodes.take(bus.graph().nodes)
    listener = bus.node("init")
    nodes.begin(listener)
    candidates.listen(listener, candidates.topics)
    bus.run_until(lasts_s)
    listener.close()
    proposed = propose(candidates)
    nodes.add_to(proposed, candidates)
    return bus, robot, thresholds_text(["Test."], {}, proposed)


def watched(bus: LocalBus, text: str) -> list[Transition]:
    heard: list[Transition] = []

    def hear(event: Event) -> None:
        if isinstance(event, Transition):
            heard.append(event)

    parameters = yaml.safe_load(text)["alert_system"]["ros__parameters"]
    parameters["publish_rate"] = 0.1  # nothing here reads the state, which is most of the work
    AlertSystem(bus.node("alert_system", parameters=parameters), {"test": hear}, log_alerts=False)
    return heard


def alerts_after(listened_s: float, healthy_s: float) -> dict[str, Lines]:
    """Returns the alerts of each fault, and of the healthy time before them (key "")."""
    bus, robot, text = listened(listened_s)
    heard = watched(bus, text)
    alerts: dict[str, Lines] = {}
    bus.run_until(bus.now_s + healthy_s)
    alerts[""] = [(each.signal, each.text) for each in heard]
    for fault in FAULTS:
        heard.clear()
        robot.fault = fault
        bus.run_until(bus.now_s + FAULT_S)
        robot.fault = ""
        until_s = bus.now_s + RECOVERY_S
        while bus.now_s < until_s and set({each.signal: each.to_level for each in heard}.values()) - {Level.OK}:
            bus.run_until(bus.now_s + 1.0)
        bus.run_until(bus.now_s + 10.0)
        alerts[fault] = [(f"{each.signal} {each.to_level.name}", each.text) for each in heard]
        heard.clear()
    return alerts


@pytest.fixture(scope="module")
def found() -> dict[str, Lines]:
    return alerts_after(610.0, healthy_s=600.0)


def test_a_healthy_robot_raises_no_alert_in_the_ten_minutes_that_follow(found: dict[str, Lines]) -> None:
    assert found[""] == []


def test_a_file_after_one_minute_is_silent_for_ten_minutes_too_and_misses_only_the_ranges() -> None:
    bus, robot, text = listened(60.0)
    heard = watched(bus, text)
    bus.run_until(bus.now_s + 600.0)
    assert [each.text for each in heard] == []
    assert "# joint_states_effort_elbow: {" in text
    assert "    #   /event: " in text
    for proposed in (
        "tf_odom:",
        "tf_base_link:",
        "rosout_errors:",
        "planner_lifecycle:",
        "robot_node:",
        "localization_node:",
    ):
        assert f"      {proposed}\n" in text

    missed = set()
    for fault, alert in FAULTS.items():
        heard.clear()
        robot.fault, until_s = fault, bus.now_s + FAULT_S
        while not any(f"{each.signal} {each.to_level.name}" == alert for each in heard):
            if bus.now_s >= until_s:
                missed.add(fault)
                break
            bus.run_until(bus.now_s + 1.0)
        robot.fault = ""
        bus.run_until(bus.now_s + 20.0)
    assert missed == {"a joint overloads", "imu shakes"}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_with_its_cause(found: dict[str, Lines], fault: str) -> None:
    assert FAULTS[fault] in [name for name, _ in found[fault]]


def test_a_fault_is_one_or_two_lines(found: dict[str, Lines]) -> None:
    bad = {fault: [text for name, text in lines if not name.endswith(" OK")] for fault, lines in found.items()}
    assert {fault: texts for fault, texts in bad.items() if len(texts) > 2} == {}
    assert sum(map(len, bad.values())) <= 22


def test_every_fault_ends(found: dict[str, Lines]) -> None:
    for fault, lines in found.items():
        last = {name.rpartition(" ")[0]: name.rpartition(" ")[2] for name, _ in lines}
        assert set(last.values()) <= {Level.OK.name}, fault


def test_the_page_lists_the_faults_and_their_alerts() -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "statistics.md").read_text(encoding="utf-8")
    assert "".join(f"| {fault} | `{alert}` |\n" for fault, alert in FAULTS.items()) in page
