"""The examples run as their readers run them, and print what they promise."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run_example(name: str, *arguments: object) -> list[str]:
    """Runs an example and returns the lines that it printed."""
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / name), *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout.splitlines()


def test_the_library_example_reports_a_low_battery_then_silence_then_recovery() -> None:
    lines = run_example("library.py")
    # Below 20 % from 11 s on, for 3 s; the last sample is at 19 s, the first one after the swap at 40 s.
    assert [line.split()[:3] for line in lines[:-1]] == [
        ["14.000", "battery_level", "WARN:"],
        ["25.000", "battery_level", "STALE:"],
        ["40.000", "battery_level", "OK:"],
    ]
    assert lines[-1] == "in the end: battery_level is OK, 100 %"


def test_the_custom_source_reports_a_disk_that_is_fuller_than_the_bound(tmp_path: Path) -> None:
    alert, state = run_example("custom_source.py", "--duration", 0.1, "--warn-above", 0, tmp_path)
    assert alert.startswith("disk_usage WARN: ")
    assert "is above 0 %" in alert
    assert "is above 0 %" in state


def test_the_custom_source_reports_no_alert_below_the_bound(tmp_path: Path) -> None:
    (state,) = run_example("custom_source.py", "--duration", 0.1, "--warn-above", 100, tmp_path)
    assert state.endswith(" %")


@pytest.mark.parametrize("arguments", [(), ("alerts.csv",)])
def test_the_custom_outlet_writes_one_row_per_alert(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    rows = run_example("custom_outlet.py", *(tmp_path / name for name in arguments))
    assert [row.split(",")[:4] for row in rows] == [
        ["11.0", "battery_level", "WARN", "19.0"],
        ["21.0", "battery_level", "ERROR", "9.0"],
    ]


def test_every_example_has_a_test() -> None:
    source = Path(__file__).read_text(encoding="utf-8")
    assert [file.name for file in (ROOT / "examples").glob("*.py") if f'"{file.name}"' not in source] == []
