"""Entries of a history in lines, JSON and CSV: as `robot-health history` prints them."""

from __future__ import annotations

import csv
import io
import json
import time
from pathlib import Path
from typing import Any

import pytest
from harness.past import START_S, add_silences, output, write_past

from robot_health_monitor.cli.history.history_entries import time_text
from robot_health_monitor.cli.history.history_file import change_history
from robot_health_monitor.ops.store.notes import add_note

pytestmark = pytest.mark.usefixtures("utc")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns the history of `harness.past`."""
    return write_past(tmp_path / "history.db")


@pytest.fixture
def silenced(file: Path) -> Path:
    """Returns that history with silences."""
    return add_silences(file)


@pytest.fixture
def noted(file: Path) -> Path:
    """Returns that history with two notes on its first alert; the second one has no author."""
    change_history(file, lambda connection: add_note(connection, 1, "=wheel <b>blocked</b>", "ana", START_S + 400.0))
    change_history(file, lambda connection: add_note(connection, 1, "cleaned", "", START_S + 500.0))
    return file


def test_notes_follow_their_alert(noted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, noted).splitlines()
    assert lines[2:6] == [
        "2023-11-14 22:13:40 +0000 #1 r1: battery_level WARN: number 1",
        "2023-11-14 22:20:00 +0000 #1 note by ana: =wheel <b>blocked</b>",
        "2023-11-14 22:21:40 +0000 #1 note: cleaned",
        "2023-11-14 22:14:10 +0000 #2 r1: battery_level OK: number 2",
    ]


def test_notes_in_json(noted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = [json.loads(line)["notes"] for line in output(capsys, noted, "--json").splitlines()]
    assert found == [
        [
            {"time": "2023-11-14T22:20:00.000Z", "author": "ana", "text": "=wheel <b>blocked</b>"},
            {"time": "2023-11-14T22:21:40.000Z", "author": "", "text": "cleaned"},
        ],
        [],
        [],
    ]


def test_notes_in_csv(noted: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = list(csv.DictReader(io.StringIO(output(capsys, noted, "--csv"))))
    assert [row["event"] for row in rows] == ["alert", "note", "note", "alert", "alert"]
    shown = {name: value for name, value in rows[1].items() if value}
    assert shown == {
        "id": "1", "time": "2023-11-14T22:20:00.000Z", "robot": "r1", "signal": "battery_level", "event": "note",
        "text": "'=wheel <b>blocked</b>", "author": "ana",
    }  # fmt: skip


def test_silences_are_part_of_the_history(silenced: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, silenced).splitlines()
    day = "2023-11-14 22:1"
    assert [line for line in lines if "silence" in line] == [
        f"{day}3:30 +0000 silence 1 added by ana: robot=r1,signal=battery*, until 2023-11-15 00:13 UTC (fan)",
        f"{day}3:50 +0000 silence 2 added by =ben: robot=r2, until 2023-11-14 22:14 UTC",
        f"{day}4:00 +0000 silence 1 ended by eve: robot=r1,signal=battery* (fan works)",
        f"{day}4:20 +0000 silence 2 expired: robot=r2",
        f"{day}4:52 +0000 silence 3 added: signal=cpu*, until resolved (known)",
        f"{day}4:53 +0000 silence 3 ended: signal=cpu* (its alerts are resolved)",
    ]
    assert [line[:19] for line in lines] == sorted(line[:19] for line in lines)


@pytest.mark.parametrize("level", ["OK", "WARN"])
def test_of_one_level_there_are_transitions_only(
    silenced: Path, capsys: pytest.CaptureFixture[str], level: str
) -> None:
    lines = output(capsys, silenced, "--level", level).splitlines()
    assert lines and all(f" {level}: " in line for line in lines)


def test_silences_in_json(silenced: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = [json.loads(line) for line in output(capsys, silenced, "--json").splitlines()]
    assert [each["time"] for each in found] == sorted(each["time"] for each in found)
    added, _, ended, expired, _, resolved = (each for each in found if "event" in each)
    assert added == {
        "id": 1, "time": "2023-11-14T22:13:30.000Z", "event": "silence added",
        "matchers": "robot=r1,signal=battery*", "author": "ana", "reason": "fan",
        "until": "2023-11-15T00:13:30.000Z", "until_resolved": False,
        "text": "silence 1 added by ana: robot=r1,signal=battery*, until 2023-11-15 00:13 UTC (fan)",
    }  # fmt: skip
    assert (ended["event"], ended["author"], ended["reason"]) == ("silence ended", "eve", "fan works")
    assert (expired["event"], expired["author"], expired["reason"]) == ("silence expired", "", "")
    assert (resolved["reason"], resolved["until"]) == ("its alerts are resolved", None)
    assert resolved["until_resolved"]


def test_silences_in_csv(silenced: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = list(csv.DictReader(io.StringIO(output(capsys, silenced, "--csv"))))
    assert [row["event"] for row in rows if row["signal"]] == ["alert"] * 3
    silences = [row for row in rows if not row["signal"]]
    assert [(row["id"], row["event"], row["author"], row["reason"]) for row in silences] == [
        ("1", "silence added", "ana", "fan"),
        ("2", "silence added", "'=ben", ""),
        ("1", "silence ended", "eve", "fan works"),
        ("2", "silence expired", "", ""),
        ("3", "silence added", "", "known"),
        ("3", "silence ended", "", "its alerts are resolved"),
    ]
    assert silences[0]["matchers"] == "robot=r1,signal=battery*" and silences[4]["until"] == ""


def test_csv_texts_are_no_formulas(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = list(csv.DictReader(io.StringIO(output(capsys, file, "--csv"))))
    assert [row["text"] for row in rows] == [
        "battery_level WARN: number 1", "battery_level OK: number 2", "'=cpu?[31m",
    ]  # fmt: skip
    assert [row["hint"] for row in rows] == ["", "", "no publisher on /cpu?"]
    assert (rows[0]["time"], rows[0]["value"], rows[2]["value"]) == ("2023-11-14T22:13:40.000Z", "15.0", "")


def test_local_times_carry_their_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    # The hour that occurs twice when daylight saving ends: 2023-10-29 00:30 and 01:30 UTC.
    assert time_text(1698539400.0) == "2023-10-29 02:30:00 +0200"
    assert time_text(1698543000.0) == "2023-10-29 02:30:00 +0100"


@pytest.mark.parametrize("wall_s", [1e300, -1e300])
def test_any_time_can_be_shown(wall_s: Any) -> None:
    assert time_text(wall_s).endswith(" s")
