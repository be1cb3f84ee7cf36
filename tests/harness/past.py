"""A history with a known past, for tests of the commands that show it; and what `robot-health history` prints."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from harness.histories import transition
from robot_health_monitor.__main__ import main
from robot_health_monitor.core import Level
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.matchers import parse_matchers
from robot_health_monitor.ops.store.silences import add_silence, expire_silence

START_S = 1_700_000_000.0  # 2023-11-14 22:13:20 UTC


def write_past(file: Path) -> Path:
    """Writes a history, and returns its path: 100 s of r1; WARN from 20 to 50 and a STALE cpu_usage at 90."""
    now_s = [START_S]
    history = History(HistorySettings(str(file)), lambda: now_s[0])
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
    return file


def add_silences(file: Path) -> Path:
    """Adds four silences to that history: one that was ended, one that expired, one that resolved, one for ever."""

    def silence(database: sqlite3.Connection, second: float, matchers: str, **options: Any) -> None:
        add_silence(database, parse_matchers(matchers), START_S + second, **options)

    with closing(sqlite3.connect(file)) as connection, connection:
        silence(connection, 10.0, "robot=r1,signal=battery*", for_s=7200.0, reason="fan", author="ana")
        silence(connection, 30.0, "robot=r2", for_s=30.0, author="=ben")
        silence(connection, 92.0, "signal=cpu*", until_resolved=True, reason="known")
        expire_silence(connection, 1, START_S + 40.0, reason="fan works", author="eve")
        expire_silence(connection, 3, START_S + 93.0, reason="its alerts are resolved")
    return file


def output(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> str:
    """Returns what the command prints on stdout, or on stderr if it fails."""
    assert main(["history", *map(str, arguments)]) == code
    captured = capsys.readouterr()
    return captured.err if code else captured.out
