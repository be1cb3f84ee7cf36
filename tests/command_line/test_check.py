"""`robot-health check`: one line per file, on stdout when it is right, on stderr when it is wrong."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Callable
from xml.etree import ElementTree

import pytest
from harness.line_process import LineProcess

Start = Callable[..., LineProcess]
ROOT = Path(__file__).resolve().parents[2]


def test_the_installed_configuration_is_right_and_its_contents_are_summed_up(robot_health: Start) -> None:
    file = ROOT / "config" / "thresholds.yaml"
    process = robot_health("check", file)
    assert process.wait() == 0
    assert [(line.stream, line.text) for line in process.lines] == [
        ("out", f"{file}: OK: 3 signals (battery_level, temperature, cpu_usage), 5 bounds")
    ]


@pytest.mark.parametrize("file", sorted((ROOT / "config").glob("*.yaml")), ids=lambda file: file.name)
def test_every_configuration_that_is_installed_is_right(robot_health: Start, file: Path) -> None:
    process = robot_health("check", file)
    assert process.wait() == 0, process.text


@pytest.mark.parametrize(
    ("contents", "line"),
    [
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals:\n      arm:\n        warn_belw: 1.0\n",
            ":5: alert_system.ros__parameters.signals.arm.warn_belw: unknown key; did you mean warn_below? expected ",
            id="unknown key",
        ),
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals:\n      arm: {warn_below: 1.0, error_below: 2.0}\n",
            ":4: alert_system.ros__parameters.signals.arm.error_below: expected at most warn_below (1), got 2",
            id="contradictory bounds",
        ),
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals: {arm: {}}\n"
            b"battery_sensor:\n  ros__parameters:\n    battery_level:\n      discharge_rate: fast\n",
            ":7: battery_sensor.ros__parameters.battery_level.discharge_rate: expected a number of at least 0",
            id="another node of the same file",
        ),
        pytest.param(
            b"alert_system:\n  ros__parameters:\n    signals: {arm: {}}\naggregator:\n  ros__parameters: [1]\n",
            ":5: aggregator.ros__parameters: expected a mapping of keys to values, got [1]",
            id="parameters that are a list",
        ),
        pytest.param(b"signals: {arm: {}}\n", ": expected one node with ros__parameters.signals", id="no node"),
        pytest.param(b"", ": is empty; expected a mapping of keys to values", id="empty"),
        pytest.param(b"a:\n  b: [1\nc: 2\n", ":3: is not valid YAML: ", id="syntax"),
        pytest.param(b"# 80 \xb0C\n", ": is not UTF-8 text: byte 5 is 0xb0", id="latin-1"),
        pytest.param(b"\xff\xfea\x00:\x00", ": is not UTF-8 text: byte 0 is 0xff", id="UTF-16"),
        pytest.param(bytes(range(256)), ": is not ", id="binary"),
    ],
)
def test_a_wrong_file_is_one_line_with_the_place_and_code_2(
    robot_health: Start, tmp_path: Path, contents: bytes, line: str
) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_bytes(contents)
    process = robot_health("check", file)
    assert process.wait() == 2
    assert [(each.stream, each.text[: len(f"{file}{line}")]) for each in process.lines] == [("err", f"{file}{line}")]


def test_a_file_that_is_not_there_is_one_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("check", tmp_path / "nowhere.yaml")
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}/nowhere.yaml: cannot be read: No such file or directory"


def test_a_directory_is_one_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("check", tmp_path)
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}: cannot be read: expected a file, got a directory"


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_that_may_not_be_read_is_one_line(robot_health: Start, calm: Path) -> None:
    calm.chmod(0)
    process = robot_health("check", calm)
    assert process.wait() == 2
    assert process.text == f"err: {calm}: cannot be read: Permission denied"


def test_a_line_break_in_a_name_makes_no_second_line(robot_health: Start, tmp_path: Path) -> None:
    process = robot_health("check", tmp_path / "no\nwhere")
    assert process.wait() == 2
    assert process.text == f"err: {tmp_path}/no\\nwhere: cannot be read: No such file or directory"


def test_of_several_files_each_is_judged_and_one_that_is_wrong_decides(
    robot_health: Start, calm: Path, restless: Path, tmp_path: Path
) -> None:
    process = robot_health("check", calm, tmp_path / "nowhere.yaml", restless)
    assert process.wait() == 2
    assert len(process.errors) == 1
    right = [line.text for line in process.lines if line.stream == "out"]
    assert right == [
        f"{calm}: OK: 3 signals (battery_level, temperature, cpu_usage), 1 bound",
        f"{restless}: OK: 1 signal (battery_level), 2 bounds",
    ]


def test_nodes_that_do_not_run_here_are_named(robot_health: Start, tmp_path: Path) -> None:
    file = tmp_path / "more.yaml"
    file.write_text(
        "alert_sytem: {ros__parameters: {signals: {arm: {}}}}\nnavigator: {ros__parameters: {speed: 1.0}}\n"
    )
    process = robot_health("check", file)
    assert process.wait() == 0
    assert process.text == f"out: {file}: OK: 1 signal (arm), 0 bounds; not used here: navigator"


def test_version_is_that_of_package_xml(robot_health: Start) -> None:
    process = robot_health("--version")
    assert process.wait() == 0
    version = ElementTree.parse(ROOT / "package.xml").findtext("version")
    assert process.text == f"out: robot-health {version}"


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["check", "--help"]])
def test_help_goes_to_stdout(robot_health: Start, arguments: list) -> None:
    process = robot_health(*arguments)
    assert process.wait() == 0
    assert process.text.startswith("out: usage: robot-health")
