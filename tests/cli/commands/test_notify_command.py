"""`robot-health notify`: an alert that is labelled as a test, then its end; a line per target, and the exit code."""

from __future__ import annotations

import re
import sys
import threading
import time
from pathlib import Path
from typing import Callable, Iterator

import pytest
from harness.alertmanager import RunningAlertmanager, needs_alertmanager, running_alertmanager
from harness.http_server import HttpServer, responding
from harness.line_process import LineProcess

from robot_health_monitor.cli.commands.notify_command import Trial, try_target
from robot_health_monitor.core import Level
from robot_health_monitor.core.nodes.node import host_name
from robot_health_monitor.core.nodes.outlets import FIELDS
from robot_health_monitor.ops.configuration import TargetSettings

Start = Callable[..., LineProcess]

TWO_SENT = (
    f'2 messages sent: look for "{host_name()}: test WARN: test notification of robot-health notify, nothing is wrong" '
    "and its end"
)


@pytest.fixture
def server() -> Iterator[HttpServer]:
    with HttpServer() as server:
        yield server


@pytest.fixture(scope="module")
def alertmanager(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningAlertmanager]:
    with running_alertmanager(tmp_path_factory.mktemp("alertmanager")) as running:
        yield running


def test_every_target_is_tried_and_a_failure_is_code_3(robot_health: Start, tmp_path: Path) -> None:
    with HttpServer() as good, HttpServer() as bad:
        bad.behave = responding(500)
        secret = tmp_path / "chat.url"
        secret.write_text(f"{bad.url}/hooks/s3cret")
        secret.chmod(0o644)
        file = tmp_path / "ops.yaml"
        file.write_text(
            "notify:\n"
            "  chat: {type: webhook, url_file: chat.url}\n"
            f"  hook: {{type: webhook, url: '{good.url}/hook'}}\n"
            "  horn: {type: command, command: [/nowhere/horn]}\n"
            f"  alive: {{type: heartbeat, url: '{good.url}/ping'}}\n"
        )
        process = robot_health("notify", file)
        assert process.wait() == 3
        assert [line.text for line in process.lines if line.stream == "out"] == [
            f"chat: FAILED: {bad.url}: response 500 Internal Server Error",
            f"hook: OK: {good.url}: 200 OK; {TWO_SENT}",
            "horn: FAILED: /nowhere/horn: cannot be started: No such file or directory",
            f"alive: OK: {good.url}: 200 OK",
        ]
        assert "chmod 600" in process.text and "s3cret" not in process.text
        paths = sorted(request.path for request in good.all())
        assert paths == ["/hook", "/hook", "/ping"]


def test_code_0_if_all_succeed(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text("notify: {horn: {type: command, command: ['true']}}\n")
    process = robot_health("notify", file)
    assert (process.wait(), process.text.strip()) == (0, f"out: horn: OK: true: ended with code 0; {TWO_SENT}")


@pytest.mark.newest_python
@needs_alertmanager
def test_the_test_alert_stays_until_alertmanager_has_notified(robot_health: Start, tmp_path: Path) -> None:
    """With Alertmanager's own `group_wait` of 30 s. SIGINT then ends the wait, and the alert."""
    with HttpServer() as pager, running_alertmanager(tmp_path, webhook=f"{pager.url}/page") as alertmanager:
        file = tmp_path / "ops.yaml"
        file.write_text(f"notify: {{pager: {{type: alertmanager, url: '{alertmanager.url}'}}}}\n")
        process = robot_health("notify", file)
        line = process.wait_for_line(lambda text: text.startswith("pager: firing: "))
        assert 'look for "' in line and "it is resolved in 60 s. Alertmanager notifies after its group_wait" in line
        page = pager.received.get(timeout=60.0).json
        assert (page["status"], page["alerts"][0]["labels"]["signal"]) == ("firing", "test")
        assert page["alerts"][0]["annotations"]["summary"].endswith(
            ": test WARN: test notification of robot-health notify, nothing is wrong"
        )
        assert process.is_running
        process.signal()
        assert process.wait() == 0
        text = process.lines[-1].text
        assert re.fullmatch(rf"pager: OK: {re.escape(alertmanager.url)}: 200 OK; \d+ messages sent", text)
        assert alertmanager.alerts() == []


def test_with_hold_every_alert_stays(robot_health: Start, tmp_path: Path) -> None:
    """SIGINT comes as soon as one of many targets has its alert: each that got one gets its end."""
    with HttpServer() as server:
        file = tmp_path / "ops.yaml"
        chats = "".join(f"  chat{number}: {{type: webhook, url: '{server.url}'}}\n" for number in range(20))
        file.write_text(f"notify:\n{chats}")
        process = robot_health("notify", "--hold", "1h", file)
        process.wait_for_text("it is resolved in 1 h")
        assert [request.json["notification"] for request in server.all()].count("resolved") == 0
        process.signal()
        assert process.wait() == 0, process.text
        sent = [request.json["notification"] for request in server.all()]
        assert sent.count("resolved") == 20
        assert robot_health("notify", "--hold", "2d", file).wait() == 2


def test_a_file_without_targets_or_with_mistakes_is_code_2(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text("history: {file: history.db}\n")
    process = robot_health("notify", file)
    assert process.wait() == 2
    assert process.text.strip() == f"err: {file}: expected targets in the section notify, got none"
    file.write_text("notify: {horn: {type: hrn}}\n")
    process = robot_health("notify", file)
    assert process.wait() == 2 and ":1: notify.horn.type: expected one of " in process.text


# One target


def test_a_webhook_receives_the_test_and_its_end(server: HttpServer) -> None:
    trial = try_target(TargetSettings("chat", "webhook", Level.ERROR, url=f"{server.url}/s3cret"), "r3")
    text = "r3: test ERROR: test notification of robot-health notify, nothing is wrong"
    assert trial == Trial("chat", True, f'{server.url}: 200 OK; 2 messages sent: look for "{text}" and its end')
    firing, resolved = (request.json for request in server.all())
    assert set(FIELDS) <= set(firing)
    assert (firing["to_level"], firing["notification"], firing["test"]) == ("ERROR", "firing", True)
    assert (resolved["to_level"], resolved["notification"], resolved["test"]) == ("OK", "resolved", True)
    assert firing["text"] == "r3: test ERROR: test notification of robot-health notify, nothing is wrong"


def test_a_failure_is_reported_without_secrets(server: HttpServer, tmp_path: Path) -> None:
    file = tmp_path / "chat.url"
    file.write_text(f"{server.url}/s3cret")
    file.chmod(0o644)
    server.behave = responding(403)
    trial = try_target(TargetSettings("chat", "webhook", url_file=str(file)), "r3")
    assert (trial.succeeded, trial.text) == (False, f"{server.url}: response 403 Forbidden")
    assert "chmod 600" in trial.warning


def test_a_heartbeat_is_called_once(server: HttpServer) -> None:
    trial = try_target(TargetSettings("alive", "heartbeat", url=f"{server.url}/ping"), "r3")
    assert trial.succeeded
    assert [(request.method, request.path) for request in server.all()] == [("GET", "/ping")]


def test_a_command_runs_for_the_test_and_for_its_end(tmp_path: Path) -> None:
    code = f"import sys; open({str(tmp_path / 'log')!r}, 'a').write(sys.stdin.read())"
    trial = try_target(TargetSettings("horn", "command", command=(sys.executable, "-c", code)), "r3")
    assert trial.succeeded
    assert trial.text.startswith(f"{sys.executable}: ended with code 0; 2 messages sent: look for ")
    assert len((tmp_path / "log").read_text().splitlines()) == 2


def test_an_alert_that_stays_says_what_to_look_for_and_is_resolved_when_it_is_stopped(server: HttpServer) -> None:
    stop, lines = threading.Event(), []

    def note(line: str) -> None:
        lines.append(line)
        assert [request.json["notification"] for request in server.all()] == ["firing"]
        stop.set()

    trial = try_target(TargetSettings("chat", "webhook", url=server.url), "r3", 3600.0, stop, note)
    assert trial == Trial("chat", True, f"{server.url}: 200 OK; 2 messages sent")
    assert [request.json["notification"] for request in server.all()] == ["resolved"]
    text = "r3: test WARN: test notification of robot-health notify, nothing is wrong"
    assert lines == [f'firing: {server.url}: 200 OK; look for "{text}"; it is resolved in 1 h']


def test_an_alert_that_stays_at_alertmanager_is_repeated(server: HttpServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robot_health_monitor.cli.commands.notify_command.REPEAT_EVERY_S", 0.05)
    stop = threading.Event()
    server.behave = lambda handler: (stop.set() if server.received.qsize() >= 3 else None, responding(200)(handler))[1]
    settings = TargetSettings("pager", "alertmanager", url=server.url)
    lines: list[str] = []
    trial = try_target(settings, "r3", 3600.0, stop, lines.append)
    assert (trial.succeeded, trial.text) == (True, f"{server.url}: 200 OK; 4 messages sent")
    *open_alerts, ended = [request.json for request in server.all()]
    assert len(open_alerts) == 3
    assert all(alert == open_alerts[0] and "endsAt" not in alert[0] for alert in open_alerts)
    assert "endsAt" in ended[0] and ended[0]["labels"] == open_alerts[0][0]["labels"]
    assert "group_wait (default 30 s)" in lines[0] and "alertname=RobotHealth, robot=r3, signal=test" in lines[0]


@needs_alertmanager
@pytest.mark.parametrize("ahead_s", [0.0, 7200.0])
def test_at_alertmanager_the_test_ends_at_once_also_with_a_wrong_clock(
    alertmanager: RunningAlertmanager, ahead_s: float
) -> None:
    settings = TargetSettings("pager", "alertmanager", url=alertmanager.url)
    trial = try_target(settings, "r3", wall_time_s=lambda: time.time() + ahead_s)
    assert trial.text.startswith(f"{alertmanager.url}: 200 OK; 2 messages sent: look for ")
    assert alertmanager.levels() == {}
