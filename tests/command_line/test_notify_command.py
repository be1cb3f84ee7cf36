"""`robot-health notify`: a line per target, and the exit code."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

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


def test_a_file_without_targets_or_with_mistakes_is_code_2(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text("history: {file: history.db}\n")
    process = robot_health("notify", file)
    assert process.wait() == 2
    assert process.text.strip() == f"err: {file}: expected targets in the section notify, got none"
    file.write_text("notify: {horn: {type: hrn}}\n")
    process = robot_health("notify", file)
    assert process.wait() == 2 and ":1: notify.horn.type: expected one of " in process.text
