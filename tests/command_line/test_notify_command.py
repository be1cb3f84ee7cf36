"""`robot-health notify`: a line per target, and the exit code."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import pytest
from harness.alertmanager import needs_alertmanager, running_alertmanager
from harness.http_server import HttpServer, responding
from harness.line_process import LineProcess

Start = Callable[..., LineProcess]


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
            f"hook: OK: {good.url}: 200 OK",
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
    assert (process.wait(), process.text.strip()) == (0, "out: horn: OK: true: ended with code 0")


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
        assert process.lines[-1].text == f"pager: OK: {alertmanager.url}: 200 OK"
        assert alertmanager.alerts() == []


def test_with_hold_every_alert_stays(robot_health: Start, tmp_path: Path) -> None:
    with HttpServer() as server:
        file = tmp_path / "ops.yaml"
        file.write_text(f"notify: {{chat: {{type: webhook, url: '{server.url}'}}}}\n")
        process = robot_health("notify", "--hold", "1h", file)
        process.wait_for_text("it is resolved in 1 h")
        assert server.next().json["notification"] == "firing"
        process.signal()
        assert process.wait() == 0
        assert server.next().json["notification"] == "resolved"
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
