"""`robot-health note`: on the file of a stopped monitor, and of one that is running."""

from __future__ import annotations

import getpass
import json
import time
from pathlib import Path
from typing import Any

import pytest
from harness.histories import opened, transition
from harness.past import START_S, output, write_past

from robot_health_monitor.__main__ import main
from robot_health_monitor.cli.commands import note_command

pytestmark = pytest.mark.usefixtures("utc")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns the history of `harness.past`."""
    return write_past(tmp_path / "history.db")


def notes(capsys: pytest.CaptureFixture[str], file: Path, alert: int) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(output(capsys, file, "--alert", alert, "--json"))["notes"]
    return found


def test_a_note_has_its_author_and_time(
    file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(note_command.time, "time", lambda: START_S + 1.5)
    assert main(["note", "#1", "wheel blocked", "--author", "ana", "--history", str(file)]) == 0
    assert capsys.readouterr() == ("note on #1 r1: battery_level WARN: number 1\n", "")
    assert notes(capsys, file, 1) == [{"time": "2023-11-14T22:13:21.500Z", "author": "ana", "text": "wheel blocked"}]


def test_without_an_author_it_is_the_login_name_and_the_present_time(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before_s = time.time()
    assert main(["note", "1", "wheel blocked", "--history", str(file)]) == 0
    capsys.readouterr()
    (note,) = notes(capsys, file, 1)
    assert note["author"] == getpass.getuser()
    written_s = time.mktime(time.strptime(note["time"][:19], "%Y-%m-%dT%H:%M:%S"))
    assert before_s - 1.0 <= written_s <= time.time()


def test_an_ops_yaml_names_the_file(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ops = file.parent / "ops.yaml"
    ops.write_text("history: {file: history.db}\n", encoding="utf-8")
    assert main(["note", "2", "on the charger", "--ops", str(ops)]) == 0
    assert capsys.readouterr().out == "note on #2 r1: battery_level OK: number 2\n"
    assert [note["text"] for note in notes(capsys, file, 2)] == ["on the charger"]


def test_a_running_monitor_sees_the_note(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    history = opened(tmp_path / "history.db")
    robot = history.of_robot("r1")
    robot.restore()
    robot.record(transition(1), {}, [])
    history.run(lambda connection: None)
    assert main(["note", "1", "wheel blocked", "--history", str(tmp_path / "history.db")]) == 0
    robot.record(transition(2), {}, [])
    query = "SELECT transition_id, text FROM notes"
    assert history.run(lambda connection: connection.execute(query).fetchall()) == [(1, "wheel blocked")]
    history.close()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("7", "text"), "robot-health note: there is no alert 7 in this history"),
        (("1", "\x1b\n\u202e"), "robot-health note: expected a note of 1 to 1000 characters, got none"),
        (("1", "x" * 1001), "robot-health note: expected a note of 1 to 1000 characters, got 1001"),
        (("1", "x", "--author", "y" * 201), "robot-health note: expected an author of at most 200 characters, got 201"),
        (
            ("one", "text"),
            "robot-health note: argument ID: expected the number of an alert, got 'one'",
        ),
        (("9" * 30, "text"), "robot-health note: argument ID: expected the number of an alert, got '9999"),
    ],
)
def test_what_cannot_be_noted_is_one_line_and_code_2(
    file: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], problem: str
) -> None:
    assert main(["note", *arguments, "--history", str(file)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(problem) and captured.err.count("\n") == 1
    assert notes(capsys, file, 1) == []


def test_a_file_that_is_missing_or_no_history_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["note", "1", "text", "--history", str(tmp_path / "none.db")]) == 2
    assert capsys.readouterr().err == f"{tmp_path}/none.db: No such file or directory\n"
    (tmp_path / "text.db").write_text("hello\n" * 100, encoding="utf-8")
    assert main(["note", "1", "text", "--history", str(tmp_path / "text.db")]) == 2
    assert capsys.readouterr().err == f"{tmp_path}/text.db: cannot be used: file is not a database\n"
