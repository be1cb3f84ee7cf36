"""Notifications of `robot-health run --ops`: real processes, a real history file, real targets."""

from __future__ import annotations

import json
import os
import signal
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any, Callable, Iterator

import pytest
from harness.alertmanager import needs_alertmanager, running_alertmanager
from harness.http_server import HttpServer, Received, hanging, responding
from harness.line_process import LineProcess
from harness.waiting import wait_for

Start = Callable[..., LineProcess]

LOW_BATTERY = """
alert_system:
  ros__parameters:
    robot_name: atlas
    signals:
      battery_level: {error_below: 1000.0}
battery_sensor:
  ros__parameters:
    seed: 1
    publish_rate: 20.0
    temperature: {source: none}
    cpu_usage: {source: none}
"""
"""The battery is below its bound from the first sample on."""


@pytest.fixture
def server() -> Iterator[HttpServer]:
    with HttpServer() as server:
        yield server


@pytest.fixture
def run(robot_health: Start, tmp_path: Path) -> Callable[..., LineProcess]:
    """Returns a function that starts the monitor with targets."""
    (tmp_path / "low.yaml").write_text(LOW_BATTERY)

    def start(**targets: dict[str, Any]) -> LineProcess:
        (tmp_path / "ops.yaml").write_text(json.dumps({"history": {"file": "history.db"}, "notify": targets}))
        files = ("--thresholds", tmp_path / "low.yaml", "--ops", tmp_path / "ops.yaml")
        return robot_health("run", *files, "--port", "0")

    return start


def alert(request: Received) -> str:
    return f"{request.json['robot']} {request.json['to_level']} {request.json['notification']}"


def wait_until_confirmed(file: Path) -> None:
    """Waits until a notification has been sent and none waits."""
    with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as connection:
        query = "SELECT (SELECT count(*) FROM notified), (SELECT count(*) FROM notifications)"
        wait_for(lambda: connection.execute(query).fetchone() == (1, 0))


def test_an_alert_reaches_its_target_and_a_killed_monitor_does_not_repeat_it(
    run: Callable[..., LineProcess], server: HttpServer, tmp_path: Path
) -> None:
    with HttpServer() as alive:
        targets = {
            "chat": {"type": "webhook", "url": server.url, "simulated": True},
            "alive": {"type": "heartbeat", "url": alive.url, "every_s": 1.0},
        }
        process = run(**targets)
        assert alert(server.next()) == "atlas ERROR firing"
        wait_until_confirmed(tmp_path / "history.db")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        alive.all()
        process = run(**targets)
        alive.next()
        alive.next()
        assert [alert(request) for request in server.all()] == []
        process.end()


@pytest.mark.newest_python
def test_simulated_values_notify_only_targets_that_ask_for_them(
    run: Callable[..., LineProcess], server: HttpServer, tmp_path: Path
) -> None:
    with HttpServer() as trial, HttpServer() as later:
        targets = {
            "chat": {"type": "webhook", "url": server.url},
            "trial": {"type": "webhook", "url": trial.url, "simulated": True},
        }
        process = run(**targets)
        process.wait_for_line(lambda text: "battery_level ERROR" in text)
        request = trial.next()
        assert (alert(request), request.json["simulated"]) == ("atlas ERROR firing", True)
        wait_until_confirmed(tmp_path / "history.db")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        # A new target is sent the open alerts.
        process = run(**targets, later={"type": "webhook", "url": later.url, "simulated": True})
        assert alert(later.next()) == "atlas ERROR firing"
        process.end()
        assert server.all() == []


@pytest.mark.newest_python
def test_what_could_not_be_delivered_is_delivered_by_the_next_run(
    run: Callable[..., LineProcess], server: HttpServer
) -> None:
    chat = {"type": "webhook", "url": server.url, "simulated": True}
    server.behave = hanging
    process = run(chat=chat)
    assert alert(server.next()) == "atlas ERROR firing"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    server.behave = responding(200)
    process = run(chat=chat)
    assert alert(server.next()) == "atlas ERROR firing"
    process.end()


def test_a_failing_target_is_one_line_without_its_secret(
    run: Callable[..., LineProcess], server: HttpServer, tmp_path: Path
) -> None:
    server.behave = responding(500)
    (tmp_path / "chat.url").write_text(f"{server.url}/hooks/s3cret")
    (tmp_path / "chat.url").chmod(0o600)
    process = run(chat={"type": "webhook", "url_file": "chat.url", "simulated": True})
    process.wait_for_line(lambda text: f"notify chat: {server.url}: response 500 Internal Server Error" in text)
    server.next()
    server.next()
    server.behave = responding(200)
    process.wait_for_line(lambda text: "notify chat works again" in text)
    process.end()
    assert process.text.count("notify chat: ") == 1
    assert "s3cret" not in process.text


@needs_alertmanager
def test_alertmanager_shows_the_alert(run: Callable[..., LineProcess], tmp_path: Path) -> None:
    (tmp_path / "am").mkdir()
    with running_alertmanager(tmp_path / "am") as alertmanager:
        process = run(pager={"type": "alertmanager", "url": alertmanager.url, "simulated": True})
        wait_for(alertmanager.alerts)
        (found,) = alertmanager.alerts()
        labels = {"alertname": "RobotHealth", "robot": "atlas", "signal": "battery_level"}
        assert found["labels"] == {**labels, "level": "ERROR", "severity": "critical"}
        assert found["annotations"]["summary"].startswith("atlas: battery_level ERROR: ")
        process.end()


@pytest.mark.newest_python
def test_a_monitor_that_is_killed_within_both_waits_sends_each_alert_once(
    run: Callable[..., LineProcess], server: HttpServer, tmp_path: Path
) -> None:
    with HttpServer() as late, HttpServer() as alive:
        webhook = {"type": "webhook", "simulated": True}
        targets = {
            "together": {**webhook, "url": server.url, "group_wait_s": 8.0},
            "late": {**webhook, "url": late.url, "after_s": 8.0},
            "alive": {"type": "heartbeat", "url": alive.url, "every_s": 1.0},
        }
        process = run(**targets)
        process.wait_for_line(lambda text: "battery_level ERROR" in text)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        assert (server.all(), late.all()) == ([], [])
        process = run(**targets)
        assert (alert(server.next()), alert(late.next())) == ("atlas ERROR firing", "atlas ERROR firing")
        alive.all()
        alive.next()
        process.end()
        assert (server.all(), late.all()) == ([], [])
