"""Chaos around alert_system on ROS 1: the node, the master and the network fail."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, Callable, Iterator, Sequence

import pytest
from harness.chaos import SIGNALS, Robot, check_stderr, cut_network, end, kill_and_stop, trial_of
from harness.line_process import LineProcess
from harness.separate_network import SeparateNetwork
from harness.waiting import wait_for

rospy = pytest.importorskip("rospy", reason="no ROS 1")
if not shutil.which("roscore"):
    pytest.skip("no ROS 1: no roscore", allow_module_level=True)

ROUNDS = 2
SET = "import json, rosgraph, sys; rosgraph.Master('/tests').setParam(sys.argv[1], json.loads(sys.argv[2]))"
CODE = "import sys; from robot_health_monitor.cli.ros1_executables import alert_system; sys.exit(alert_system())"


class Roscore:
    """A ROS master that can be killed, stopped and started again on its port."""

    def __init__(self, folder: Path, port: int) -> None:
        self.uri = ""
        self._port = port
        self._environment = {**os.environ, "ROS_HOME": str(folder)}
        self._environment.pop("ROS_HOSTNAME", None)
        self.start()

    def start(self, address: str = "127.0.0.1", prefix: Sequence[str] = ()) -> None:
        """Starts it, with words before the command, and sets the parameters of alert_system."""
        self.uri = f"http://{address}:{self._port}"
        variables = {**self._environment, "ROS_MASTER_URI": self.uri, "ROS_IP": address}
        silent = {"env": variables, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        self._process = subprocess.Popen([*prefix, "rosmaster", "--core", "-p", str(self._port)], **silent)
        parameters = "/alert_system/ros__parameters", json.dumps({"signals": SIGNALS})
        set_them = [*prefix, sys.executable, "-c", SET, *parameters]
        wait_for(lambda: subprocess.run(set_them, check=False, **silent).returncode == 0)  # it is starting

    def signal(self, number: int) -> None:
        self._process.send_signal(number)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()


@pytest.fixture
def master(tmp_path: Path, port: int) -> Iterator[Roscore]:
    master = Roscore(tmp_path, port)
    yield master
    master.signal(signal.SIGCONT)
    master.kill()


@pytest.fixture
def environment(environment: dict[str, str], master: Roscore, tmp_path: Path) -> dict[str, str]:
    path = os.pathsep.join(filter(None, [environment["PYTHONPATH"], os.environ.get("PYTHONPATH", "")]))
    ros = {"ROS_MASTER_URI": master.uri, "ROS_IP": "127.0.0.1", "ROS_HOME": str(tmp_path), "PYTHONPATH": path}
    variables = {**environment, **ros, "ROS_LOG_DIR": str(tmp_path / "log")}
    for name in ("ROS_HOSTNAME", "ROS_NAMESPACE"):
        variables.pop(name, None)
    return variables


@pytest.fixture
def alert_system(environment: dict[str, str]) -> Iterator[Callable[..., LineProcess]]:
    started: list[LineProcess] = []

    def start(prefix: Sequence[str] = (), **variables: str) -> LineProcess:
        process = LineProcess([*prefix, sys.executable, "-c", CODE], {**environment, **variables})
        started.append(process)
        process.wait_for_text("watching battery_level")  # it has registered everything with the master
        return process

    yield start
    for process in started:
        process.signal(signal.SIGCONT)
        process.end()


def test_a_node_that_is_killed_or_stopped_recovers(alert_system: Any, robot: Any, seed: int) -> None:
    kill_and_stop(alert_system, lambda: robot("ros1_peer"), seed, ROUNDS)


def test_a_master_that_hangs_or_dies_costs_no_alert(alert_system: Any, robot: Any, master: Roscore, seed: int) -> None:
    process = alert_system()
    peer: Robot = robot("ros1_peer")
    trial = trial_of(peer, seed)

    def hang() -> None:
        master.signal(signal.SIGSTOP)
        trial.pause(3.0)

    for _ in range(ROUNDS):
        trial.change(hang)
        trial.change(trial.pause)
        master.signal(signal.SIGCONT)
        trial.change(trial.pause)
    trial.pause()
    master.kill()
    for _ in range(3):
        trial.change(trial.pause)
    trial.finish()
    end(process)


def test_a_master_that_is_restarted_ends_the_node_and_a_new_one_works(
    alert_system: Any, robot: Any, master: Roscore, seed: int
) -> None:
    process = alert_system()
    peer: Robot = robot("ros1_peer")
    trial = trial_of(peer, seed)
    trial.change(trial.pause)
    master.kill()
    trial.change(trial.pause)  # without a master, what is connected stays connected
    trial.finish()
    master.start()
    assert process.wait(30.0) == 3
    check_stderr(process.errors)
    peer.end()
    process = alert_system()
    trial = trial_of(robot("ros1_peer"), seed)
    trial.change(trial.pause)
    trial.finish()
    end(process)


def test_the_loss_of_the_network_costs_no_alert(
    alert_system: Any, robot: Any, master: Roscore, network: SeparateNetwork, seed: int
) -> None:
    master.kill()
    monitor, there = network.monitor, network.robot
    master.start(monitor.address, monitor.command)  # another machine cannot reach it on loopback
    process = alert_system(monitor.command, ROS_MASTER_URI=master.uri, ROS_IP=monitor.address)
    peer: Robot = robot("ros1_peer", prefix=there.command, ROS_MASTER_URI=master.uri, ROS_IP=there.address)
    cut_network(trial_of(peer, seed), network, ROUNDS)
    end(process)
