"""Robots behind bridges of both kinds, watched by the commands."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest

pytest.importorskip("rosbags", reason="rosbags, which serializes the messages, is not installed")

from harness.foxglove_server import FoxgloveServer
from harness.line_process import LineProcess

from robot_health_monitor.cli.fleet import bridge_client
from robot_health_monitor.core.config.monitor_config import load_config
from robot_health_monitor.core.port.local import LocalBus
from robot_health_monitor.core.values.errors import ConfigError
from robot_health_monitor.foxglove import FoxgloveClient
from robot_health_monitor.rosbridge.client import RosbridgeClient
from robot_health_monitor.rosbridge.server.server import Server
from robot_health_monitor.runtime.event_loops import LoopThread

Start = Callable[..., LineProcess]

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery: {topic: /battery, type: std_msgs/Float32, unit: '%', warn_below: 20.0, error_below: 10.0}
"""


class Robot:
    """A robot whose battery is published 20 times a second, behind a server of either kind."""

    def __init__(self, kind: str) -> None:
        self.level = 50.0
        self._loop = LoopThread(kind)
        self._bus = LocalBus(1000.0)
        self._driver = self._bus.node("driver")
        self._driver.advertise("/battery", "std_msgs/Float32")
        if kind == "foxglove":
            self._server: Any = FoxgloveServer(self._bus)
        else:
            self._server = Server(self._bus.node("rosbridge"), port=0, threads=False)
        self._loop.call(self._server.start())
        scheme = "foxglove" if kind == "foxglove" else "ws"
        self.url = f"{scheme}://127.0.0.1:{self._server.port}"
        self._driving = asyncio.run_coroutine_threadsafe(self._drive(kind), self._loop.loop)

    async def _drive(self, kind: str) -> None:
        while True:
            if kind == "foxglove":
                self._server.advertise_all()
            self._driver.publish("/battery", {"data": self.level})
            await asyncio.sleep(0.05)

    def close(self) -> None:
        self._driving.cancel()
        self._loop.call(self._server.close())
        self._loop.close()


@pytest.fixture
def robots() -> Iterator[dict[str, Robot]]:
    both = {kind: Robot(kind) for kind in ("foxglove", "rosbridge")}
    yield both
    for robot in both.values():
        robot.close()


def test_the_address_chooses_the_client() -> None:
    unheard: dict[str, Any] = {"on_link": lambda *link: None, "on_log": lambda line: None}
    assert isinstance(bridge_client("ws://robot:9090", **unheard), RosbridgeClient)
    assert isinstance(bridge_client("wss://robot:9090", **unheard), RosbridgeClient)
    assert isinstance(bridge_client("foxglove://robot:8765", **unheard), FoxgloveClient)
    assert isinstance(bridge_client("foxglove+tls://robot:8765", **unheard), FoxgloveClient)
    with pytest.raises(ConfigError):
        bridge_client("http://robot:8765", **unheard)


def test_a_fleet_of_both_kinds_gives_the_same_lines(
    robot_health: Start, tmp_path: Path, robots: dict[str, Robot]
) -> None:
    (tmp_path / "thresholds.yaml").write_text(THRESHOLDS)
    entries = "".join(f"  {kind}: {{url: '{robot.url}'}}\n" for kind, robot in robots.items())
    (tmp_path / "fleet.yaml").write_text(f"defaults: {{thresholds: thresholds.yaml}}\nrobots:\n{entries}")
    process = robot_health("connect", "--fleet", tmp_path / "fleet.yaml", "--json")
    process.wait_for_texts("foxglove: connected to", "rosbridge: connected to")
    alerts: dict[str, list[Any]] = {}
    for kind, robot in robots.items():
        robot.level = 5.0
        line = process.wait_for_line(lambda text, kind=kind: f'"robot": "{kind}"' in text and '"ERROR"' in text)
        found = json.loads(line)
        alerts[kind] = [found["signal"], found["from_level"], found["to_level"], found["value"], found["bound"]]
    assert alerts["foxglove"] == alerts["rosbridge"] == ["battery", "OK", "ERROR", 5.0, 10.0]


def test_init_listens_to_a_foxglove_server(robot_health: Start, tmp_path: Path, robots: dict[str, Robot]) -> None:
    process = robot_health("init", robots["foxglove"].url, "--seconds", "5")
    assert process.wait() == 0, process.text
    file = tmp_path / "proposed.yaml"
    file.write_text("\n".join(line.text for line in process.lines if line.stream == "out"))
    signals = load_config(file).signals
    assert {signal.topic for signal in signals.values()} == {"battery"}
    assert "frequency_hz" in {signal.statistic for signal in signals.values()}
    assert "    #   nodes: the robot's graph is not known here" in file.read_text()
