"""`robot-health test`: its output and exit code, and the test of a past alert."""

from __future__ import annotations

from pathlib import Path
from typing import Callable

import pytest
from harness.line_process import LineProcess

Start = Callable[..., LineProcess]

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery_level: {unit: "%", warn_below: 20.0, for_s: 5.0}
      temperature: {warn_above: 80.0}
"""

TESTS = """
thresholds: thresholds.yaml
tests:
  - name: a sag under load is no alert
    interval_s: 1.0
    input: {battery_level: "25x9 15x3 25x10"}
    alerts: []
  - name: a low battery is one WARN
    interval_s: 1.0
    input: {battery_level: "25x9 15x60"}
    alerts: [{at_s: 15.0, signal: battery_level, level: WARN}]
"""


@pytest.fixture
def robot_health(robot_health_here: Start) -> Start:
    return robot_health_here


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "thresholds.yaml").write_text(THRESHOLDS)
    (tmp_path / "passes.yaml").write_text(TESTS)
    (tmp_path / "fails.yaml").write_text(TESTS.replace("at_s: 15.0", "at_s: 14.0"))
    (tmp_path / "invalid.yaml").write_text(TESTS.replace("25x9", "25y9"))
    return tmp_path


def lines(process: LineProcess, stream: str) -> list[str]:
    return [line.text for line in process.lines if line.stream == stream]


def test_tests_that_pass_are_one_line(robot_health_process: Start, files: Path) -> None:
    process = robot_health_process("test", files / "passes.yaml")
    assert process.wait() == 0
    assert [(line.stream, line.text) for line in process.lines] == [("out", f"{files}/passes.yaml: OK: 2 tests")]


def test_a_test_that_fails_shows_the_differences(robot_health: Start, files: Path) -> None:
    process = robot_health("test", files / "fails.yaml")
    assert process.wait() == 1
    assert lines(process, "err") == []
    assert lines(process, "out") == [
        f"{files}/fails.yaml: FAILED: a low battery is one WARN",
        "  - expected, did not occur",
        "  + occurred, not expected",
        "  - at_s: 14, signal: battery_level, level: WARN",
        "  + at_s: 15, signal: battery_level, level: WARN  # battery_level WARN: 15 % is below 20 % (was OK for 15 s)",
        f"{files}/fails.yaml: 1 of 2 tests failed",
    ]


def test_a_file_with_mistakes_is_a_usage_error(robot_health: Start, files: Path) -> None:
    process = robot_health("test", files / "invalid.yaml")
    assert process.wait() == 2
    assert lines(process, "out") == []
    series = "expected a series such as '25x9 15-0.5x20 _x3 nan', got '25y9' in it"
    assert lines(process, "err") == [
        f"{files}/invalid.yaml:6: tests.0.input.battery_level: {series}",
        f"{files}/invalid.yaml:10: tests.1.input.battery_level: {series}",
    ]


def test_all_files_run_and_the_worst_result_is_the_exit_code(robot_health: Start, files: Path) -> None:
    process = robot_health("test", files / "invalid.yaml", files / "fails.yaml", files / "passes.yaml")
    assert process.wait() == 2
    assert lines(process, "out")[-2:] == [
        f"{files}/fails.yaml: 1 of 2 tests failed",
        f"{files}/passes.yaml: OK: 2 tests",
    ]
