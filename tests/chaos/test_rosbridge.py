"""Chaos between a robot's server and `robot-health connect`: the network, the server and the monitor fail."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any, Iterator

import pytest
from harness.chaos import AlertsOfOutput, Robot, Trial, end, kill
from harness.tcp_proxy import TcpProxy

ROUNDS = 2


@pytest.fixture
def proxy(port: int) -> Iterator[TcpProxy]:
    proxy = TcpProxy(port)
    yield proxy
    proxy.end()


@pytest.fixture
def world(robot_health: Any, robot: Any, thresholds: Path, port: int, proxy: TcpProxy, seed: int) -> World:
    return World(robot_health, robot, thresholds, port, proxy, seed)


class World:
    """A robot with its server, a network, and a monitor."""

    def __init__(self, robot_health: Any, robot: Any, thresholds: Path, port: int, proxy: TcpProxy, seed: int) -> None:
        self._start = robot_health
        self._thresholds = thresholds
        self._port = port
        self.proxy = proxy
        self.start_server()
        self.peer: Robot = robot("rosbridge_peer", f"http://127.0.0.1:{port}/")
        self.peer.wait_until_connected()
        self.output = AlertsOfOutput()
        self.start_monitor()
        self.trial = Trial(seed, self.output.alerts, self.peer.publish)

    def start_server(self) -> None:
        allowed = ("--allow-publish", "/battery_level")
        self.server = self._start("run", "--source", "none", "--port", self._port, *allowed)
        self.server.wait_for_text("serving on")

    def start_monitor(self) -> None:
        url = f"robot=ws://127.0.0.1:{self.proxy.port}"
        self.monitor = self._start("connect", url, "--json", "--thresholds", self._thresholds)
        self.monitor.wait_for_text("connected to")
        self.output.follow(self.monitor)

    def cut(self) -> None:
        self.trial.pause()
        self.proxy.cut()

    def flap(self) -> None:
        """The link drops again and again."""
        for _ in range(5):
            self.trial.pause()
            self.proxy.cut()

    def refuse(self) -> None:
        """The server accepts and closes, for a while."""
        self.trial.pause()
        self.proxy.refusing = True
        self.proxy.cut()
        self.trial.pause(2.0, shortest_s=0.5)
        self.proxy.refusing = False

    def pull_the_cable(self) -> None:
        self.trial.pause()
        self.proxy.silent = True
        self.trial.pause(6.0, shortest_s=0.5)
        self.proxy.silent = False

    def kill_the_server(self) -> None:
        self.trial.pause()
        kill(self.server)
        self.trial.pause(1.0)
        self.start_server()

    def stop_the_server(self) -> None:
        self.trial.stop(self.server, 4.0, shortest_s=0.5)

    def stop_the_server_until_the_link_is_down(self) -> None:
        self.trial.pause()
        self.server.signal(signal.SIGSTOP)
        try:
            self.output.wait_for_links("ERROR")
        finally:
            self.server.signal(signal.SIGCONT)

    def kill_the_monitor(self) -> None:
        self.trial.pause()
        self.monitor.signal(signal.SIGKILL)
        self.output.wait_for_end()
        self.trial.restarted()
        self.start_monitor()


@pytest.mark.parametrize(
    "fault",
    [
        "flap",
        "kill_the_server",
        *(
            pytest.param(fault, marks=pytest.mark.newest_python)
            for fault in ("cut", "refuse", "pull_the_cable", "stop_the_server")
        ),
    ],
)
def test_alerts_are_neither_lost_nor_repeated(world: World, fault: str) -> None:
    for _ in range(ROUNDS):
        world.trial.change(world.trial.pause)
        world.trial.change(getattr(world, fault))
        world.trial.check()
    world.trial.finish()
    end(world.monitor)


def test_a_server_that_is_stopped_is_one_alert_of_the_link_and_its_end(world: World) -> None:
    world.trial.change(world.trial.pause)
    world.trial.change(world.stop_the_server_until_the_link_is_down)
    world.output.wait_for_links("ERROR", "OK")
    world.trial.finish()
    assert world.output.links == ["ERROR", "OK"]
    end(world.monitor)


def test_a_monitor_that_is_killed_starts_from_an_empty_state(world: World) -> None:
    for _ in range(ROUNDS):
        world.trial.change(world.trial.pause)
        world.kill_the_monitor()
        world.trial.wait_for_alert()
    world.trial.finish()
    end(world.monitor)
