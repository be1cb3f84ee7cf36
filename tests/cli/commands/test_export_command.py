"""`robot-health export`: what it writes where, and its exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Callable

import pytest
from harness.line_process import LineProcess

Start = Callable[..., LineProcess]

THRESHOLDS = """
alert_system:
  ros__parameters:
    signals:
      battery_level: {unit: "%", warn_below: 20.0, latch: true}
"""


@pytest.fixture
def robot_health(robot_health_here: Start) -> Start:
    return robot_health_here


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "thresholds.yaml"
    path.write_text(THRESHOLDS)
    return path


def outcome(process: LineProcess) -> tuple[int, list[str], list[str]]:
    """Returns the exit code, and the lines on stdout and stderr."""
    code = process.wait()
    return code, [line.text for line in process.lines if line.stream == "out"], process.errors


def test_rules_are_written_on_stdout_and_are_the_same_for_all_thresholds(
    robot_health_process: Start, file: Path
) -> None:
    options = ("--robot", "r1", "--robot", "r2", "--interval", "5")

    code, out, err = outcome(robot_health_process("export", "prometheus", *options))

    assert (code, err) == (0, [])
    assert '        expr: max by (robot, signal) (robot_health_alert_level{robot=~"r1|r2"} == 1)' in out
    assert "    interval: 5s" in out
    assert outcome(robot_health_process("export", "prometheus", file, *options)) == (0, out, [])


def test_a_dashboard_is_written_on_stdout(robot_health: Start, file: Path) -> None:
    code, out, err = outcome(robot_health("export", "grafana", file))

    assert (code, err) == (0, [])
    assert json.loads("".join(out))["title"] == "Robot health"


def test_a_policy_is_written_on_stdout(robot_health: Start, file: Path) -> None:
    options = [
        "--namespace",
        "r1",
        "--sensors",
        "none",
        "--remap",
        "battery_level:=/bms/soc",
        "--enclave",
        "/r1/health",
    ]
    code, out, err = outcome(robot_health("export", "sros2", file, *options))

    assert (code, err) == (0, [])
    assert '    <enclave path="/r1/health">' in out and '        <profile ns="/r1" node="alert_system">' in out
    assert "            <topic>/bms/soc</topic>" in out


def test_a_remapping_has_two_names(robot_health: Start, file: Path) -> None:
    code, out, err = outcome(robot_health("export", "sros2", file, "--remap", "battery_level"))

    assert (code, out) == (2, [])
    assert "expected FROM:=TO, such as battery_level:=/bms/level, got 'battery_level'" in err[0]


@pytest.mark.parametrize("target", ["prometheus", "grafana", "sros2"])
def test_a_mistake_in_the_file_is_one_line_and_code_2(robot_health: Start, file: Path, target: str) -> None:
    file.write_text(THRESHOLDS.replace("20.0", "low"))

    code, out, err = outcome(robot_health("export", target, file))

    path = "alert_system.ros__parameters.signals.battery_level.warn_below"
    assert (code, out, err) == (2, [], [f"{file}:5: {path}: expected a number, got 'low'"])


def test_a_robot_whose_name_cannot_be_printed_is_refused(robot_health: Start, file: Path) -> None:
    code, out, err = outcome(robot_health("export", "prometheus", file, "--robot", "r\x7f1"))

    assert (code, out) == (2, [])
    assert "expected printable text, got 'r\\x7f1'" in err[0]


def test_a_target_is_required(robot_health: Start, file: Path) -> None:
    code, out, err = outcome(robot_health("export", file))

    assert (code, out, len(err)) == (2, [], 1)
    assert "prometheus" in err[0] and "grafana" in err[0]


def test_the_files_of_a_fleet_are_written_and_listed(robot_health: Start, file: Path, tmp_path: Path) -> None:
    fleet, folder = tmp_path / "fleet.yaml", tmp_path / "out"
    fleet.write_text("robots: {r1: {}, 'r-2': {url: 'ws://r2:9090'}}")
    receiver = "https://centre:9090/api/v1/write"

    process = robot_health("export", "fleet", file, fleet, "--receiver", receiver, "--to", folder, "--outage", "6h")

    code, out, err = outcome(process)
    assert (code, err) == (0, [])
    assert sorted(out) == sorted(str(path) for path in folder.rglob("*") if path.is_file())
    assert len(out) == 13
    assert "out_of_order_time_window: 10h" in (folder / "centre/prometheus.yml").read_text()
    rules = (folder / "centre/rules.yaml").read_text()
    assert '        labels: {robot: "r1"}' in rules and '        labels: {robot: "r-2"}' in rules


def test_a_mistake_in_a_fleet_file_is_one_line_and_code_2(robot_health: Start, file: Path, tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text("robots:\n  'a b': {}\n")
    options = ("--receiver", "https://centre:9090/api/v1/write", "--to", tmp_path / "out")

    code, out, err = outcome(robot_health("export", "fleet", file, tmp_path / "fleet.yaml", *options))

    assert (code, out, len(err)) == (2, [], 1)
    assert err[0].startswith(f"{tmp_path / 'fleet.yaml'}:2: ")
    assert not (tmp_path / "out").exists()


def test_a_receiver_that_is_no_full_url_is_one_line_and_code_2(robot_health: Start, file: Path, tmp_path: Path) -> None:
    code, out, err = outcome(
        robot_health("export", "fleet", file, "--receiver", "https://centre:9090", "--to", tmp_path / "out")
    )

    assert (code, out) == (2, [])
    assert err == [
        "robot-health export: expected the URL of a receiver in full, such as https://centre:9090/api/v1/write, "
        "without user, password and query"
    ]
    assert not (tmp_path / "out").exists()
