"""Chaos around alert_system on ROS 2: the node, the robot and the network fail."""

from __future__ import annotations

import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Sequence

import pytest
from harness.chaos import THRESHOLDS, Robot, Trial, check_stderr, end
from harness.line_process import LineProcess
from harness.separate_network import SeparateNetwork

rclpy = pytest.importorskip("rclpy", reason="no ROS 2")

ROUNDS = 2
CODE = "import sys; from robot_health_monitor.ros2_executables import alert_system; sys.exit(alert_system())"


@pytest.fixture
def environment(environment: Dict[str, str]) -> Dict[str, str]:
    path = os.pathsep.join(filter(None, [environment["PYTHONPATH"], os.environ.get("PYTHONPATH", "")]))
    # Above the domains of tests/ros2, and below Linux's ephemeral ports.
    domain = {"ROS_DOMAIN_ID": str(random.SystemRandom().randrange(60, 101)), "PYTHONPATH": path}
    return {**environment, **domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.fixture
def alert_system(environment: Dict[str, str], tmp_path: Path) -> Iterator[Callable[..., LineProcess]]:
    started: List[LineProcess] = []
    file = tmp_path / "parameters.yaml"
    file.write_text(THRESHOLDS)

    def start(**variables: str) -> LineProcess:
        command = [sys.executable, "-c", CODE, "--ros-args", "--params-file", str(file)]
        started.append(LineProcess(command, {**environment, **variables}))
        return started[-1]

    yield start
    for process in started:
        process.signal(signal.SIGCONT)
        process.end()


def test_a_node_that_is_killed_or_stopped_recovers(alert_system: Any, robot: Any, seed: int) -> None:
    process = alert_system()
    process.wait_for_text("watching battery_level")
    peer: Robot = robot("ros2_peer")
    peer.wait_until_connected()
    trial = Trial(seed, peer.alerts, peer.publish)

    def stop() -> None:
        trial.pause()
        process.signal(signal.SIGSTOP)
        time.sleep(trial.chance.uniform(0.2, 3.0))
        process.signal(signal.SIGCONT)

    for _ in range(ROUNDS):
        trial.change(trial.pause)
        trial.change(stop)
        trial.pause()
        process.signal(signal.SIGKILL)
        process.wait()
        check_stderr(process.errors)
        time.sleep(0.2)  # what it has sent arrives
        # `alerts` is not latched: the robot must be connected before the new node announces.
        trial.change_to_ok_unseen()
        process = alert_system()
        process.wait_for_text("watching battery_level")
        peer.end()
        peer = robot("ros2_peer")
        peer.wait_until_connected()
        trial = Trial(trial.chance.randrange(10**9), peer.alerts, peer.publish)
    trial.finish()
    end(process)


def test_the_loss_of_the_network_costs_no_alert(
    alert_system: Any, robot: Any, network: SeparateNetwork, seed: int
) -> None:
    process = alert_system(ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    process.wait_for_text("watching battery_level")
    peer: Robot = robot("ros2_peer", prefix=network.command, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET")
    peer.wait_until_connected()
    trial = Trial(seed, peer.alerts, peer.publish)
    for _ in range(ROUNDS):
        trial.change(trial.pause)
        trial.change(lambda: trial.lose(network))
    trial.finish()
    end(process)


NOWHERE = "/proc/none"


@pytest.mark.parametrize("variables", [("TMPDIR", "TEMP", "TMP"), ("ROS_HOME", "ROS_LOG_DIR")])
def test_a_read_only_folder_costs_no_alert(alert_system: Any, robot: Any, seed: int, variables: Sequence[str]) -> None:
    process = alert_system(**dict.fromkeys(variables, NOWHERE))
    process.wait_for_text("watching battery_level")
    peer: Robot = robot("ros2_peer")
    peer.wait_until_connected()
    trial = Trial(seed, peer.alerts, peer.publish)
    for _ in range(ROUNDS):
        trial.change(trial.pause)
    trial.finish()
    end(process)
    assert ("ROS_LOG_DIR" in variables) == (f"no log file: {NOWHERE} cannot be created" in process.text)
