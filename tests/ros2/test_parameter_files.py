"""Parameter files: errors name file and line, and a node's section applies in any namespace."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.ros2.parameter_files import ParameterFiles

THRESHOLDS = """alert_system:
  ros__parameters:
    signals:
      battery_level: {warn_below: 20.0}
"""


def arguments(file: Path) -> list[str]:
    return ["alert_system", "--ros-args", "--params-file", str(file)]


@pytest.fixture
def thresholds(tmp_path: Path) -> Path:
    file = tmp_path / "thresholds.yaml"
    file.write_text(THRESHOLDS, encoding="utf-8")
    return file


def test_a_section_applies_in_any_namespace(thresholds: Path) -> None:
    files = ParameterFiles(arguments(thresholds))
    with files.arguments_for_any_namespace() as changed:
        assert changed[:3] == ["alert_system", "--ros-args", "--params-file"]
        copy = Path(changed[3]).read_text(encoding="utf-8")
    assert copy == THRESHOLDS.replace("alert_system:", '"/**/alert_system":')
    assert thresholds.read_text(encoding="utf-8") == THRESHOLDS


def test_an_absolute_name_is_not_changed(tmp_path: Path) -> None:
    file = tmp_path / "absolute.yaml"
    file.write_text(THRESHOLDS.replace("alert_system:", "/robot1/alert_system:"), encoding="utf-8")
    with ParameterFiles(arguments(file)).arguments_for_any_namespace() as changed:
        assert Path(changed[3]).read_text(encoding="utf-8") == file.read_text(encoding="utf-8")


def test_copies_are_gone_afterwards(thresholds: Path) -> None:
    with ParameterFiles(arguments(thresholds)).arguments_for_any_namespace() as changed:
        copy = changed[3]
    assert not Path(copy).exists()


def test_an_error_of_a_node_gets_file_and_line(thresholds: Path) -> None:
    files = ParameterFiles(arguments(thresholds))
    error = ConfigError("expected a number", ("signals", "battery_level", "warn_below"))
    assert str(files.located(error, "/robot1/alert_system")).startswith(f"{thresholds}:4: ")
    assert files.located(error, "/robot1/other") is error


def test_an_empty_mapping_is_refused_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "empty.yaml"
    file.write_text("alert_system:\n  ros__parameters:\n    signals:\n      imu: {}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"empty\.yaml:4: .*imu: expected a mapping with at least one key"):
        ParameterFiles(arguments(file))


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml"):
        ParameterFiles(arguments(tmp_path / "none.yaml"))


def test_a_message_of_rcl_names_the_users_file_and_its_line(thresholds: Path) -> None:
    files = ParameterFiles(arguments(thresholds))
    with files.arguments_for_any_namespace() as changed:
        problem = (
            f"failed to parse arguments: Couldn't parse params file: '--params-file {changed[3]}'. "
            "Error: Cannot have a value before ros__parameters at line 3, at ./src/parse.c:1"
        )
        explained = files.explained(problem)
    assert str(explained) == f"{thresholds}:3: rejected by rcl: Cannot have a value before ros__parameters"
