"""`robot-health history --alert ID`: one alert, and its samples."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from harness.past import START_S, output, write_past

from robot_health_monitor.cli.history.history_file import change_history
from robot_health_monitor.ops.store.notes import add_note

pytestmark = pytest.mark.usefixtures("utc")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns the history of `harness.past`."""
    return write_past(tmp_path / "history.db")


def test_one_alert_with_its_samples(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, file, "--alert", "#1").splitlines()
    assert lines[:2] == [
        "2023-11-14 22:13:40 +0000 #1 r1: battery_level WARN: number 1",
        "  21 samples stored; last 15",
    ]
    assert (lines[2], lines[-1]) == ("  2023-11-14 22:13:20 35", "  2023-11-14 22:13:40 15")
    assert len(lines) == 2 + 21
    shown = json.loads(output(capsys, file, "--alert", "1", "--json"))
    assert shown["evidence"][20] == ["2023-11-14T22:13:40.000Z", 15.0]
    assert len(output(capsys, file, "--alert", "1", "--csv").splitlines()) == 22


def test_an_alert_that_does_not_exist(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "robot-health history: there is no transition 4 in this history\n"
    assert output(capsys, file, "--alert", 4, code=2) == text


def test_the_notes_on_an_alert_are_shown(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change_history(file, lambda connection: add_note(connection, 1, "wheel blocked", "ana", START_S))
    assert (
        "  2023-11-14 22:13:20 +0000 #1 note by ana: wheel blocked" in output(capsys, file, "--alert", 1).splitlines()
    )
    shown = json.loads(output(capsys, file, "--alert", 1, "--json"))
    assert shown["notes"] == [{"time": "2023-11-14T22:13:20.000Z", "author": "ana", "text": "wheel blocked"}]
