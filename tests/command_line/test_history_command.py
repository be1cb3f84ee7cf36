"""`robot-health history`: what it prints for a history that was written by the monitor's own code."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path
from typing import Any, Iterator, List

import pytest
from harness.histories import opened, transition

from robot_health_monitor.__main__ import main
from robot_health_monitor.core import Level
from robot_health_monitor.history_command import text_plot, time_text
from robot_health_monitor.history_file import iso_time
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.history.history import History
from robot_health_monitor.ops.matchers import parse_matchers
from robot_health_monitor.ops.silences import add_silence, expire_silence, resolve_alert

START_S = 1_700_000_000.0  # 2023-11-14 22:13:20 UTC


@pytest.fixture(autouse=True)
def _utc(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns a history: 100 s of r1; WARN from 20 to 50 and a STALE cpu_usage at 90."""
    now_s = [START_S]
    history = History(HistorySettings(str(tmp_path / "history.db")), lambda: now_s[0])
    robot = history.of_robot("r1")
    robot.restore()
    robot.record_configuration({})
    statistics = {"last": 15.0}
    for second, each, samples in (
        (
            20.0,
            transition(1, Level.WARN, since_s=81.0, statistics=statistics),
            [(START_S + n, 35.0 - n) for n in range(21)],
        ),
        (50.0, transition(2, Level.OK, from_level=Level.WARN), []),
        (
            90.0,
            transition(
                3,
                Level.STALE,
                signal="cpu_usage",
                since_s=13.0,
                value=None,
                bound=None,
                text="=cpu\x1b[31m",
                hint="no publisher on /cpu\x1b",
            ),
            [],
        ),
    ):
        now_s[0] = START_S + second
        robot.record(each, {"level": 1}, samples)
    robot.record_reset()
    history.run(lambda connection: None)
    now_s[0] = START_S + 100.0
    history.close()
    return tmp_path / "history.db"


def output(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> str:
    """Returns what the command prints on stdout, or on stderr if it fails."""
    assert main(["history", *map(str, arguments)]) == code
    captured = capsys.readouterr()
    return captured.err if code else captured.out


def test_alerts_and_events_of_the_monitor_in_their_order(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, file).splitlines()
    assert lines[0].startswith("2023-11-14 22:13:20 +0000 monitor started (version ")
    assert lines[1] == "2023-11-14 22:13:20 +0000 r1: configuration 44136fa355b3 in force"
    assert lines[2:] == [
        "2023-11-14 22:13:40 +0000 #1 r1: battery_level WARN: number 1",
        "2023-11-14 22:14:10 +0000 #2 r1: battery_level OK: number 2",
        "2023-11-14 22:14:50 +0000 r1: latched alerts reset",
        "2023-11-14 22:14:50 +0000 #3 r1: =cpu?[31m [no publisher on /cpu?]",
        "2023-11-14 22:15:00 +0000 monitor stopped",
    ]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--signal", "battery*"], ["#1", "#2"]),
        (["--level", "stale"], ["#3"]),
        (["--robot", "r2", "--level", "WARN"], []),
        (["--level", "WARN", "--since", "2023-11-14T22:13:41"], []),
        (["--signal", "*", "--since", "2023-11-14T22:13:40"], ["#1", "#2", "#3"]),
        (["--signal", "*", "--since", "24h"], []),
    ],
)
def test_filters(file: Path, capsys: pytest.CaptureFixture[str], options: List[str], expected: List[str]) -> None:
    assert [line.split()[3] for line in output(capsys, file, *options).splitlines()] == expected


def test_json_has_the_fields_of_a_transition(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, _, third = (json.loads(line) for line in output(capsys, file, "--json").splitlines())
    assert first == {
        "id": 1, "time": "2023-11-14T22:13:40.000+00:00", "signal": "battery_level", "from_level": "OK",
        "to_level": "WARN", "value": 15.0, "statistic": "last", "bound": 20.0, "now_s": 101.0, "since_s": 81.0,
        "robot": "r1", "fingerprint": "0123456789abcdef", "text": "battery_level WARN: number 1",
        "statistics": {"last": 15.0}, "repeat": False, "hint": "",
    }  # fmt: skip
    assert (third["to_level"], third["value"], third["bound"]) == ("STALE", None, None)


@pytest.fixture
def silenced(file: Path) -> Path:
    """Returns the history with four silences: one that was ended, one that expired, one that resolved, one for ever."""

    def silence(database: sqlite3.Connection, second: float, matchers: str, **options: Any) -> None:
        add_silence(database, parse_matchers(matchers), START_S + second, **options)

    with closing(sqlite3.connect(file)) as connection, connection:
        silence(connection, 10.0, "robot=r1,signal=battery*", for_s=7200.0, reason="fan", author="ana")
        silence(connection, 30.0, "robot=r2", for_s=30.0, author="=ben")
        connection.execute('UPDATE signal_states SET state = \'{"announced": {"level": "WARN"}}\'')
        silence(connection, 92.0, "signal=cpu*", until_resolved=True, reason="known")
        expire_silence(connection, 1, START_S + 40.0, reason="fan works", author="eve")
        for signal in ("battery_level", "cpu_usage"):
            resolve_alert(connection, ("r1", signal), START_S + 93.0)
    return file


def test_silences_are_part_of_the_history(silenced: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, silenced).splitlines()
    day = "2023-11-14 22:1"
    assert [line for line in lines if "silence" in line] == [
        f"{day}3:30 +0000 silence 1 added by ana: robot=r1,signal=battery*, until 2023-11-15 00:13:30 +0000 (fan)",
        f"{day}3:50 +0000 silence 2 added by =ben: robot=r2, until 2023-11-14 22:14:20 +0000",
        f"{day}4:00 +0000 silence 1 ended by eve: robot=r1,signal=battery* (fan works)",
        f"{day}4:20 +0000 silence 2 expired: robot=r2",
        f"{day}4:52 +0000 silence 3 added: signal=cpu*, until resolved (known)",
        f"{day}4:53 +0000 silence 3 ended: signal=cpu* (its alerts are resolved)",
    ]
    assert [line[:19] for line in lines] == sorted(line[:19] for line in lines)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--robot", "r1"], [1, 1, 3, 3]),
        (["--robot", "r1", "--signal", "cpu_usage"], [3, 3]),
        (["--robot", "r2"], [2, 2, 3, 3]),
        (["--robot", "r*", "--signal", "battery*"], [1, 1]),
        (["--signal", "cpu*"], [2, 2, 3, 3]),
        (["--since", "2023-11-14T22:14:10"], [2, 3, 3]),
        (["--level", "WARN"], []),
    ],
)
def test_silences_are_filtered(
    silenced: Path, capsys: pytest.CaptureFixture[str], options: List[str], expected: List[int]
) -> None:
    found = [json.loads(line) for line in output(capsys, silenced, "--json", *options).splitlines()]
    assert [each["id"] for each in found if "event" in each] == expected


def test_silences_in_json(silenced: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = [json.loads(line) for line in output(capsys, silenced, "--json").splitlines()]
    assert [each["time"] for each in found] == sorted(each["time"] for each in found)
    added, _, ended, expired, _, resolved = (each for each in found if "event" in each)
    assert added == {
        "id": 1, "time": "2023-11-14T22:13:30.000+00:00", "event": "silence added",
        "matchers": "robot=r1,signal=battery*", "author": "ana", "reason": "fan",
        "until": "2023-11-15T00:13:30.000+00:00", "until_resolved": False,
        "text": "silence 1 added by ana: robot=r1,signal=battery*, until 2023-11-15 00:13:30 +0000 (fan)",
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
    assert (rows[0]["time"], rows[0]["value"], rows[2]["value"]) == ("2023-11-14T22:13:40.000+00:00", "15.0", "")


def test_summary(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # battery_level: WARN for 30 of 100 s. cpu_usage: STALE for the last 10 s.
    assert output(capsys, file, "--summary").splitlines() == [
        "2023-11-14 22:13:20 +0000 to 2023-11-14 22:15:00 +0000",
        "robot  signal             OK    WARN  ERROR   STALE  unknown  alerts  longest outage",
        "r1     battery_level  70.0 %  30.0 %    0 %     0 %      0 %       1            30 s",
        "r1     cpu_usage      90.0 %     0 %    0 %  10.0 %      0 %       1            10 s",
    ]
    [battery] = map(json.loads, output(capsys, file, "--summary", "--json", "--signal", "b*").splitlines())
    assert battery["shares"] == pytest.approx({"OK": 0.7, "WARN": 0.3, "ERROR": 0.0, "STALE": 0.0})
    assert (battery["alerts"], battery["longest_outage_s"]) == (1, pytest.approx(30.0))


def test_a_summary_of_signals_that_do_not_exist_says_so(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options, text in (
        (("--robot", "r2"), "no signal matches\n"),
        (("--since", "2999-01-01"), "the monitor did not run in this time; it last ran at 2023-11-14 22:15:00 +0000\n"),
    ):
        assert main(["history", str(file), "--summary", *options]) == 0
        assert capsys.readouterr() == ("", text)


def test_one_alert_with_a_plot_of_its_samples(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines = output(capsys, file, "--alert", "#1").splitlines()
    assert lines[:4] == [
        "2023-11-14 22:13:40 +0000 #1 r1: battery_level WARN: number 1",
        "  level before: OK for 20 s",
        "  bound: 20 (on last)",
        "  window: 21 samples stored; last 15",
    ]
    assert lines[4].startswith("35 |*")
    assert [line for line in lines if line.startswith("20 |---")]
    shown = json.loads(output(capsys, file, "--alert", "1", "--json"))
    assert shown["evidence"][20] == ["2023-11-14T22:13:40.000+00:00", 15.0]
    assert len(output(capsys, file, "--alert", "1", "--csv").splitlines()) == 22


def test_an_alert_that_does_not_exist(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = "robot-health history: there is no transition 4 in this history\n"
    assert output(capsys, file, "--alert", 4, code=2) == text


def test_a_missing_file_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert output(capsys, tmp_path / "none.db", code=2) == f"{tmp_path}/none.db: No such file or directory\n"


def test_a_damaged_file_is_one_line(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content = bytearray(file.read_bytes())
    content[4096:] = b"\xa5" * (len(content) - 4096)
    file.write_bytes(content)
    assert output(capsys, file, code=2) == f"{file}: cannot be read: database disk image is malformed\n"


@pytest.mark.parametrize("since", ["", "24", "-1h", "1h 30m", "1h30", "1y", "yesterday", "999999999999h", "٣h"])
def test_a_wrong_time_is_one_line(file: Path, capsys: pytest.CaptureFixture[str], since: str) -> None:
    assert "--since: expected a duration such as 24h or a time" in output(capsys, file, f"--since={since}", code=2)


def test_a_running_monitor_can_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    history = opened(tmp_path / "history.db")
    robot = history.of_robot("r1")
    robot.restore()
    robot.record(transition(7), {}, [])
    history.run(lambda connection: None)
    assert "number 7" in output(capsys, tmp_path / "history.db", "--signal", "*")
    history.close()


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """Returns a folder that every user can read: not in tmp_path, which parallel sessions of pytest close again."""
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o755)
        yield Path(folder)


def test_another_user_can_read_a_history_in_a_folder_of_the_service(open_folder: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("needs root, to become another user")
    folder = open_folder / "state"
    history = opened(folder / "history.db")
    robot = history.of_robot("r1")
    robot.restore()
    robot.record(transition(7), {}, [])
    history.run(lambda connection: None)
    running = as_root_then_as_nobody(folder / "history.db")
    history.close()
    stopped = as_root_then_as_nobody(folder / "history.db")
    assert (running.returncode, running.stdout.count("number 7")) == (0, 2), running.stderr
    assert (stopped.returncode, stopped.stdout.count("number 7")) == (0, 2), stopped.stderr


def as_root_then_as_nobody(file: Path) -> subprocess.CompletedProcess[str]:
    """Runs the command for a file twice, the second time as a user without rights.

    The first run imports the modules, which that user may not be allowed to read.
    """
    code = (
        "import os, sys\n"
        "from robot_health_monitor.__main__ import main\n"
        "arguments = ['history', sys.argv[1], '--signal', '*']\n"
        "main(arguments)\n"
        "os.setgid(65534)\n"
        "os.setuid(65534)\n"
        "sys.exit(main(arguments))\n"
    )
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run(
        [sys.executable, "-c", code, str(file)], env=variables, text=True, capture_output=True, timeout=60, check=False
    )


def test_local_times_carry_their_offset(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    # The hour that occurs twice when daylight saving ends: 2023-10-29 00:30 and 01:30 UTC.
    assert time_text(1698539400.0) == "2023-10-29 02:30:00 +0200"
    assert time_text(1698543000.0) == "2023-10-29 02:30:00 +0100"
    assert iso_time(1698543000.0) == "2023-10-29T01:30:00.000+00:00"


@pytest.mark.parametrize("wall_s", [1e300, -1e300])
def test_any_time_can_be_shown(wall_s: Any) -> None:
    assert time_text(wall_s).endswith(" s")
    assert iso_time(wall_s) == ""


# Plots as text


def test_a_falling_value_crosses_its_bound() -> None:
    samples = [(1000.0 + second, 31.0 - second) for second in range(12)]
    assert text_plot(samples, 25.0, 16) == [
        "31 |*",
        "   | *",
        "   |  *",
        "   |   *",
        "   |    *",
        "   |     *",
        "25 |------*-----",
        "   |       *",
        "   |        *",
        "   |         *",
        "   |          *",
        "20 |           *",
        "   +------------",
        "    00:16:40",
    ]


def test_the_axis_shows_begin_and_end() -> None:
    assert text_plot([(1000.0, 1.0), (1011.0, 2.0)], None, 23)[-1] == "   00:16:40    00:16:51"


def test_a_peak_of_one_sample_is_never_lost() -> None:
    samples = [(float(n), 100.0 if n == 777 else 0.0) for n in range(10_000)]
    lines = text_plot(samples, None, 30)
    assert lines[0] == "100 |  *"


def test_values_that_are_no_numbers_are_marked() -> None:
    assert text_plot([(0.0, 1.0), (1.0, math.nan), (2.0, 2.0)], None, 14)[12] == "  +-----x-----"
    assert text_plot([(0.0, math.nan)], None, 80) == ["no samples that are numbers"]


@pytest.mark.parametrize("values", [(5.0, 5.0), (-1.7e308, 1.7e308), (5e-324, 0.0), (1e15, 1e15 + 1)])
def test_any_range_can_be_plotted(values: tuple[float, float]) -> None:
    lines = text_plot([(0.0, values[0]), (1.0, values[1])], 3.0, 40)
    assert len(lines) == 14
    assert sum(line.count("*") for line in lines) >= 2


def test_one_sample_and_times_out_of_range_can_be_plotted() -> None:
    assert len(text_plot([(1e300, 1.0)], None, 40)) == 14
    assert len(text_plot([(5.0, 1.0), (4.0, 2.0)], None, 1)) == 14
