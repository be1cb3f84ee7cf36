"""Chaos around alert_system on ROS 2: the node, the robot and the network fail."""

from __future__ import annotations

import os
import signal
import sys
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

import pytest
from harness.chaos import THRESHOLDS, Robot, cut_network, end, kill_and_stop, trial_of
from harness.line_process import LineProcess
from harness.reserved import ros2_domain
from harness.separate_network import SeparateNetwork

rclpy = pytest.importorskip("rclpy", reason="no ROS 2")

ROUNDS = 2
CODE = "import sys; from robot_health_monitor.cli.ros2_executables import alert_system; sys.exit(alert_system())"


@pytest.fixture
def environment(environment: dict[str, str], tmp_path: Path) -> dict[str, str]:
    for name in ("ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY", "RCUTILS_CONSOLE_OUTPUT_FORMAT"):
        environment.pop(name, None)
    return {
        **environment,
        "PYTHONPATH": os.pathsep.join(filter(None, [environment["PYTHONPATH"], os.environ.get("PYTHONPATH", "")])),
        "ROS_DOMAIN_ID": str(ros2_domain(str(tmp_path))),  # in that of the test before, there may still be killed nodes
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
    }


@pytest.fixture
def alert_system(environment: dict[str, str], tmp_path: Path) -> Iterator[Callable[..., LineProcess]]:
    started: list[LineProcess] = []
    file = tmp_path / "parameters.yaml"
    file.write_text(THRESHOLDS)

    def start(prefix: Sequence[str] = (), **variables: str) -> LineProcess:
        command = [*prefix, sys.executable, "-c", CODE, "--ros-args", "--params-file", str(file)]
        process = LineProcess(command, {**environment, **variables})
        started.append(process)
        process.wait_for_text("watching battery_level")
        return process

    yield start
    for process in started:
        process.signal(signal.SIGCONT)
        process.end()


def test_a_node_that_is_killed_or_stopped_recovers(alert_system: Any, robot: Any, seed: int) -> None:
    kill_and_stop(alert_system, lambda: robot("ros2_peer"), seed, ROUNDS)


def test_the_loss_of_the_network_costs_no_alert(
    alert_system: Any, robot: Any, network: SeparateNetwork, seed: int
) -> None:
    monitor, there = network.monitor, network.robot
    process = alert_system(monitor.command, **reachable_at(monitor.address))
    peer: Robot = robot("ros2_peer", prefix=there.command, **reachable_at(there.address))
    cut_network(trial_of(peer, seed), network, ROUNDS)
    end(process)


def reachable_at(address: str) -> dict[str, str]:
    """Returns the variables of a process that communicates beyond its machine."""
    # Cyclone DDS uses one interface only, which it would choose itself.
    interface = f'<General><Interfaces><NetworkInterface address="{address}"/></Interfaces></General>'
    return {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
        "CYCLONEDDS_URI": f"<CycloneDDS><Domain>{interface}</Domain></CycloneDDS>",
    }


NOWHERE = "/proc/none"


@pytest.mark.parametrize("variables", [("TMPDIR", "TEMP", "TMP"), ("ROS_HOME", "ROS_LOG_DIR")])
def test_a_read_only_folder_costs_no_alert(alert_system: Any, robot: Any, seed: int, variables: Sequence[str]) -> None:
    process = alert_system(**dict.fromkeys(variables, NOWHERE))
    trial = trial_of(robot("ros2_peer"), seed)
    for _ in range(ROUNDS):
        trial.change(trial.pause)
    trial.finish()
    end(process)
    assert ("ROS_LOG_DIR" in variables) == (f"no log file: {NOWHERE} cannot be created" in process.text)
