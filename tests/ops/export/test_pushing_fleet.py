"""The files of a fleet at work: real monitors, agents that push, a centre that is killed, a robot that is cut off."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Iterator

import pytest
from harness.alertmanager import needs_alertmanager
from harness.prometheus_server import needs_prometheus
from harness.pushing_fleet import Pager, Scraped, get, pushing_fleet, until
from harness.reserved import free_port
from harness.tcp_proxy import TcpProxy
from harness.victoria_metrics import needs_victoria_metrics

from robot_health_monitor.core import load_config

ROOT = Path(__file__).resolve().parents[3]
pytestmark = [needs_prometheus, needs_alertmanager, pytest.mark.newest_python]
ROBOTS = 5
THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery_level: {unit: "%"}
      temperature: {unit: degC, warn_above: -50.0}
battery_sensor:
  ros__parameters:
    temperature: {spike: 0.0}
"""


@pytest.fixture
def monitors(tmp_path: Path) -> Iterator[list[Scraped]]:
    """Runs real monitors of simulated robots, whose temperature is above its bound."""
    (tmp_path / "thresholds.yaml").write_text(THRESHOLDS)
    processes, scraped = [], []
    for number in range(ROBOTS):
        port = free_port()
        command = [
            sys.executable,
            "-m",
            "robot_health_monitor",
            "run",
            "--source",
            "simulated",
            "--robot",
            f"r{number}",
        ]
        command += ["--thresholds", str(tmp_path / "thresholds.yaml"), "--port", str(port)]
        processes.append(
            subprocess.Popen(
                command, cwd=ROOT, env=dict(os.environ), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
            )
        )
        address = f"http://127.0.0.1:{port}/metrics?profile=fleet"
        scraped.append(Scraped(lambda address=address: get(address)))
    try:
        yield scraped
    finally:
        for process in processes:
            process.kill()
            process.wait()
        for each in scraped:
            each.end()


def served(monitors: list[Scraped]) -> dict[str, int]:
    """Returns how many series of each name the agents were given."""
    total: dict[str, int] = {}
    for monitor in monitors:
        for name, count in monitor.series.items():
            total[name] = total.get(name, 0) + count
    return total


def scrapes(monitor: Scraped) -> int:
    return monitor.series.get("robot_health_last_tick_timestamp_seconds", 0)


def firing(pager: Pager) -> list[str]:
    """Returns the robots of the notifications that an alert fires, in order."""
    return [alert["labels"]["robot"] for sent in pager.sent if sent["status"] == "firing" for alert in sent["alerts"]]


ENGINES = [
    pytest.param("agent", ["prometheus"], id="Prometheus"),
    pytest.param("vmagent", ["victoria-metrics", "vmalert"], id="VictoriaMetrics", marks=needs_victoria_metrics),
]


@pytest.mark.parametrize(("agent", "centre"), ENGINES)
def test_every_sample_arrives_once_although_the_receiver_is_gone_and_a_robot_is_cut_off(
    tmp_path: Path, monitors: list[Scraped], agent: str, centre: list[str]
) -> None:
    """The receiver of Prometheus is killed, that of VictoriaMetrics stopped. Samples are counted by PromQL.

    Four robots share an agent; the fifth has its own, whose network is cut.
    """
    config = load_config(tmp_path / "thresholds.yaml")
    # While VictoriaMetrics is gone, Alertmanager hears nothing of an alert, and the group hides that it fires again.
    group_interval = "1s" if agent == "agent" else "5m"
    with pushing_fleet(tmp_path, config, free_port, interval_s=2.0, group_interval=group_interval) as fleet:
        proxy = TcpProxy(fleet.port)
        for unit in ("alertmanager", *centre):
            fleet.start(unit)
        until(lambda: fleet.by_label("vector(1)") and all(serves(each) for each in monitors))
        fleet.start_agent("shared", [each.address for each in monitors[:-1]], unit=agent)
        fleet.start_agent("fifth", [monitors[-1].address], unit=agent, port=proxy.port)
        until(lambda: len(firing(fleet.pager)) >= ROBOTS)

        proxy.refusing = True  # 10 s without a network
        proxy.cut()
        if agent == "agent":
            fleet.kill("centre prometheus")
        else:  # it keeps the latest seconds in memory only: killed, it loses what it has acknowledged
            fleet.stop("centre victoria-metrics")
        before = scrapes(monitors[0])
        until(lambda: scrapes(monitors[0]) >= before + 5)
        fleet.start(centre[0])
        until(lambda: scrapes(monitors[0]) >= before + 10)
        proxy.refusing = False
        until(lambda: scrapes(monitors[0]) >= before + 15)
        for monitor in monitors:
            monitor.stop()
        expected = served(monitors)
        until(lambda: fleet.counts(expected) == expected, lambda: (fleet.counts(expected), expected))

        # Without the topics, which are series from their first alert on: a busy machine starts a robot late.
        series = 'count by (robot) (count_over_time(robot_health_level{signal!~"/.*"}[900s]))'
        assert min(fleet.by_label(series, "robot").values()) == 2
        assert sorted(firing(fleet.pager)) == [f"r{number}" for number in range(ROBOTS)]
        proxy.end()


def test_a_scrape_that_the_agent_gave_up_is_not_counted() -> None:
    """Otherwise a busy machine looks like a lost sample."""
    text = b'a{robot="r1"} 1\n' * 100
    gone = threading.Event()
    asked = threading.Event()

    def exposition() -> bytes:
        asked.set()
        gone.wait(0.4)
        return text

    robot = Scraped(exposition)
    host, port = robot.address.split(":")
    for reads_some in (False, True):
        gone.clear()
        asked.clear()
        if reads_some:
            gone.set()
        with socket.create_connection((host, int(port))) as client:
            client.sendall(b"GET / HTTP/1.1\r\nHost: r1\r\n\r\n")
            assert asked.wait(10.0)
            if reads_some:
                assert client.recv(10)
        gone.set()
    get(f"http://{robot.address}/")
    until(lambda: robot.series)
    robot.end()

    assert robot.series == {"a": 100}


def serves(monitor: Scraped) -> bool:
    try:
        return b"robot_health_value" in monitor.exposition()
    except OSError:
        return False
