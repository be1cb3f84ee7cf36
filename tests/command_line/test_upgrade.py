"""Files of 0.1.0 in the present version, and back: what an upgrade must not lose, repeat or break."""

from __future__ import annotations

import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path
from typing import Callable

import pytest
from harness.http_server import HttpServer
from harness.line_process import LineProcess

from robot_health_monitor.__main__ import main
from robot_health_monitor.ops.history.schema import SCHEMA_VERSION

ARCHIVES = sorted((Path(__file__).resolve().parents[1] / "data" / "0.1.0").glob("*.tar.gz"))
FLEET = """
defaults: {thresholds: thresholds.yaml, token_file: /etc/robot-health/token}
robots:
  husky1: {url: ws://10.0.0.7:9090}
  carter: {url: wss://10.0.0.8:9090, namespace: carter, ca: /etc/ssl/fleet.pem}
"""


@pytest.fixture(params=ARCHIVES, ids=lambda archive: archive.name.partition(".")[0])
def left(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """What 0.1.0 left."""
    with tarfile.open(request.param) as archive:
        archive.extractall(tmp_path)
    return tmp_path


def set_schema(file: Path, version: int) -> None:
    with closing(sqlite3.connect(str(file))) as connection:
        connection.execute(f"PRAGMA user_version = {version}")


def test_every_version_of_the_tables_is_tried() -> None:
    assert [archive.name for archive in ARCHIVES] == [f"schema{number}.tar.gz" for number in range(1, SCHEMA_VERSION)]


def test_the_configuration_of_0_1_0_is_accepted(left: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (left / "fleet.yaml").write_text(FLEET)
    for file in ("thresholds.yaml", "ops.yaml", "fleet.yaml"):
        assert main(["check", str(left / file)]) == 0
    assert capsys.readouterr().err == ""


def test_alerts_notifications_and_silences_of_0_1_0_go_on(
    left: Path, robot_health: Callable[..., LineProcess], capsys: pytest.CaptureFixture[str]
) -> None:
    """gripper_current has been STALE and waits for its notification, motor_current is silenced for a year."""
    file = left / "history.db"
    with closing(sqlite3.connect(str(file))) as connection, connection:  # the year ends one day
        connection.execute("UPDATE silences SET until_s = until_s + 3e9 WHERE until_s IS NOT NULL")
    with HttpServer() as server:
        chat = f"{{type: webhook, url: '{server.url}'}}"
        (left / "ops.yaml").write_text(f"history: {{file: history.db, keep_days: 36500}}\nnotify: {{chat: {chat}}}\n")
        files = ("--thresholds", left / "thresholds.yaml", "--ops", left / "ops.yaml")
        process = robot_health("run", "--robot", "r1", "--source", "simulated", "--port", 0, *files)
        process.wait_for_text("battery_level OK: ")  # the simulated battery begins full
        told = server.next().json
        assert (told["signal"], told["to_level"]) == ("gripper_current", "STALE")
        process.signal()
        assert process.wait() == 0
        assert [each.json["signal"] for each in server.all()] == []
    announced = [line.text for line in process.lines if line.stream == "out" and " STALE: " in line.text]
    assert announced == []  # known since before

    assert main(["history", str(file)]) == 0
    listed = capsys.readouterr().out
    assert " gripper_current STALE: " in listed
    assert " motor_current STALE: " in listed
    assert main(["silence", "list", "--history", str(file)]) == 0
    silences = capsys.readouterr().out.splitlines()
    assert [line for line in silences if "motor_current" in line and line.split()[1] == "until"]


def test_a_history_of_a_later_version_is_refused_and_unchanged(
    left: Path, robot_health: Callable[..., LineProcess], capsys: pytest.CaptureFixture[str]
) -> None:
    file = left / "history.db"
    set_schema(file, SCHEMA_VERSION + 1)
    before = file.read_bytes()
    problem = (
        f"it was written by a newer version (schema {SCHEMA_VERSION + 1}; this version knows up to {SCHEMA_VERSION}): "
        "install that version again, or name another file"
    )
    assert main(["history", str(file)]) == 2
    assert capsys.readouterr().err == f"{file}: {problem}\n"
    files = ("--thresholds", left / "thresholds.yaml", "--ops", left / "ops.yaml")
    process = robot_health("run", "--robot", "r1", "--source", "simulated", "--port", 0, *files)
    process.wait_for_text(f"{file} is not used: {problem}; continuing without a history file")
    process.signal()
    assert process.wait() == 0
    assert file.read_bytes() == before
