"""`robot-health history`: what it prints for a history that was written by the monitor's own code."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
import sqlite3
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Iterator

import pytest
from harness.histories import opened, transition
from harness.past import START_S, add_silences, output, write_past
from harness.waiting import WAIT_S

from robot_health_monitor.__main__ import main
from robot_health_monitor.core import Level
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.samples import StoredSamples, store

pytestmark = pytest.mark.usefixtures("utc")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """Returns the history of `harness.past`."""
    return write_past(tmp_path / "history.db")


@pytest.fixture
def silenced(file: Path) -> Path:
    """Returns that history with silences."""
    return add_silences(file)


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


def test_samples_have_a_line_each(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with contextlib.closing(sqlite3.connect(file)) as connection, connection:
        store(connection, [StoredSamples("r1", "cpu", START_S, 10.0, 1.0, 3.5, 2.0, 3.0, 9, 1, Level.WARN)])
    assert output(capsys, file, "--samples") == (
        "2023-11-14 22:13:20 +0000 robot r1, signal cpu, seconds 10.0, min 1.0, max 3.5, mean 2.0, last 3.0, "
        "good 9, bad 1, level WARN\n"
    )
    assert output(capsys, file, "--samples", "--signal", "gpu") == ""


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
def test_filters(file: Path, capsys: pytest.CaptureFixture[str], options: list[str], expected: list[str]) -> None:
    assert [line.split()[3] for line in output(capsys, file, *options).splitlines()] == expected


def test_json_has_the_fields_of_a_transition(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, _, third = (json.loads(line) for line in output(capsys, file, "--json").splitlines())
    assert first == {
        "id": 1, "time": "2023-11-14T22:13:40.000Z", "signal": "battery_level", "from_level": "OK",
        "to_level": "WARN", "value": 15.0, "statistic": "last", "bound": 20.0, "now_s": 101.0, "since_s": 81.0,
        "robot": "r1", "fingerprint": "0123456789abcdef", "text": "battery_level WARN: number 1",
        "statistics": {"last": 15.0}, "repeat": False, "hint": "", "black_box": "", "alert_id": 1, "notes": [],
        "cause": "", "affects": 0, "effects": [],
    }  # fmt: skip
    assert (third["to_level"], third["value"], third["bound"]) == ("STALE", None, None)


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
    silenced: Path, capsys: pytest.CaptureFixture[str], options: list[str], expected: list[int]
) -> None:
    found = [json.loads(line) for line in output(capsys, silenced, "--json", *options).splitlines()]
    assert [each["id"] for each in found if "event" in each] == expected


def test_summary(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # battery_level: WARN for 30 of 100 s. cpu_usage: STALE for the last 10 s.
    assert output(capsys, file, "--summary").splitlines() == [
        "2023-11-14 22:13:20 +0000 to 2023-11-14 22:15:00 +0000",
        "robot  signal             OK    WARN  ERROR   STALE  unknown  available  alerts  longest outage  recovery",
        "r1     battery_level  70.0 %  30.0 %    0 %     0 %      0 %     70.0 %       1            30 s      30 s",
        "r1     cpu_usage      90.0 %     0 %    0 %  10.0 %      0 %     90.0 %       1            10 s         -",
    ]
    [battery] = map(json.loads, output(capsys, file, "--summary", "--json", "--signal", "b*").splitlines())
    assert battery["shares"] == pytest.approx({"OK": 0.7, "WARN": 0.3, "ERROR": 0.0, "STALE": 0.0})
    assert (battery["alerts"], battery["longest_outage_s"]) == (1, pytest.approx(30.0))
    assert (battery["availability"], battery["mean_time_to_recover_s"]) == (pytest.approx(0.7), pytest.approx(30.0))


def test_a_summary_in_csv_has_numbers_and_leaves_unknown_ones_empty(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, cpu = csv.DictReader(io.StringIO(output(capsys, file, "--summary", "--csv")))
    assert (cpu["robot"], cpu["signal"], cpu["alerts"], cpu["mean_time_to_recover_s"]) == ("r1", "cpu_usage", "1", "")
    numbers = [float(cpu[name]) for name in ("duration_s", "OK", "WARN", "ERROR", "STALE", "unknown", "availability")]
    assert numbers == pytest.approx([100.0, 0.9, 0.0, 0.0, 0.1, 0.0, 0.9])
    assert float(cpu["longest_outage_s"]) == pytest.approx(10.0)


def test_a_summary_of_signals_that_do_not_exist_says_so(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options, text in (
        (("--robot", "r2"), "no signal matches\n"),
        (("--since", "2999-01-01"), "the monitor did not run in this time; it last ran at 2023-11-14 22:15:00 +0000\n"),
    ):
        assert main(["history", str(file), "--summary", *options]) == 0
        assert capsys.readouterr() == ("", text)


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


def test_a_closed_stdout_is_a_failure(file: Path) -> None:
    command = f'exec "{sys.executable}" -m robot_health_monitor history "{file}" >&-'
    process = subprocess.run(["/bin/sh", "-c", command], stderr=subprocess.PIPE, text=True, timeout=WAIT_S)
    assert (process.returncode, process.stderr) == (3, "robot-health: stdout is closed: nothing can be shown\n")


def test_an_alert_that_has_just_changed_is_in_the_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Issue: once, right after an alert's end, 0 alerts were counted; the sign of life was a second old."""
    now_s = [START_S]
    history = History(HistorySettings(str(tmp_path / "history.db")), lambda: now_s[0])
    robot = history.of_robot("r1")
    levels = (Level.OK, Level.WARN, Level.ERROR, Level.OK)
    for second, before, after in zip((1.0, 2.0, 2.5), levels, levels[1:]):
        now_s[0] = START_S + second
        robot.record(transition(0, after, from_level=before), {}, [])
    history.run(lambda connection: None, 60.0)  # all of it is stored
    [summary] = [json.loads(line) for line in output(capsys, history.file, "--summary", "--json").splitlines()]
    assert (summary["alerts"], summary["longest_outage_s"]) == (1, 1.5)  # one alert, whatever its levels
    history.close()


@pytest.fixture
def affected(tmp_path: Path) -> Path:
    """Returns a history in which the silence of /scan affected two signals of r1, one of them with an alert before."""
    now_s = [START_S]
    history = History(HistorySettings(str(tmp_path / "history.db")), lambda: now_s[0])
    robot = history.of_robot("r1")
    robot.restore()
    robot.save({name: {"level": 1} for name in ("high", "low", "mid", "wheel")})
    silent = {"signal": "/scan", "value": None, "bound": None}
    for second, each in (
        (10.0, transition(1, Level.WARN, signal="low", now_s=10.0, since_s=0.0)),
        (20.0, transition(2, Level.STALE, now_s=20.0, since_s=0.0, affects=3, **silent)),
        (30.0, transition(3, Level.OK, from_level=Level.WARN, signal="low", now_s=30.0, since_s=10.0, cause="/scan")),
        (40.0, transition(4, Level.OK, from_level=Level.STALE, now_s=40.0, since_s=20.0, **silent)),
    ):
        now_s[0] = START_S + second
        robot.record(each, {"level": 1}, [])
        robot.record_effects({"/scan": ["high", "mid", "low", "=cpu\x1b[31m"]})
    history.run(lambda connection: None)
    now_s[0] = START_S + 100.0
    history.close()
    return tmp_path / "history.db"


def test_effects_are_below_their_cause(affected: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert output(capsys, affected, "--signal", "*").splitlines() == [
        "2023-11-14 22:13:30 +0000 #1 r1: low WARN: number 1",
        "2023-11-14 22:13:40 +0000 #2 r1: /scan STALE: number 2",
        "2023-11-14 22:13:40 +0000 #2 4 affected: high, mid, low, ...",
        "2023-11-14 22:13:50 +0000 #3 r1: low OK: number 3",
        "2023-11-14 22:14:00 +0000 #4 r1: /scan OK: number 4",
    ]
    names = [line[7:28].rstrip() for line in output(capsys, affected, "--summary").splitlines()[2:]]
    assert names == ["/scan (+ 2 affected)", "  high", "  mid", "low", "wheel"]


def test_cause_and_effects_are_in_json_and_csv(affected: Path, capsys: pytest.CaptureFixture[str]) -> None:
    alerts = [json.loads(line) for line in output(capsys, affected, "--json").splitlines()]
    assert [each["effects"] for each in alerts] == [[], ["high", "mid", "low", "=cpu?[31m"], [], []]
    assert [each["affects"] for each in alerts] == [0, 4, 0, 0]
    assert [each["cause"] for each in alerts] == ["", "", "/scan", ""]
    rows = [*csv.DictReader(io.StringIO(output(capsys, affected, "--csv")))]
    assert [each["cause"] for each in rows] == ["", "", "/scan", ""]
    assert rows[1]["effects"] == "high, mid, low, =cpu?[31m"
