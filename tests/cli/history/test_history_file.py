"""Which history file a command means."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_health_monitor.cli.history import history_file as module
from robot_health_monitor.cli.history.history_file import history_file
from robot_health_monitor.core.values.errors import ConfigError

pytest.importorskip("yaml")


def test_a_given_file_is_used() -> None:
    assert history_file("some.db", None) == "some.db"


def test_without_anything_it_is_that_of_the_service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert module.DEFAULT_FILE == "/var/lib/robot-health/history.db"
    file = tmp_path / "history.db"
    monkeypatch.setattr(module, "DEFAULT_FILE", str(file))
    with pytest.raises(ConfigError, match=f"^no history file is given, and there is no {file}$"):
        history_file(None, None)
    file.touch()
    assert history_file(None, None) == str(file)


def test_an_ops_yaml_names_it_relative_to_itself(tmp_path: Path) -> None:
    (tmp_path / "ops.yaml").write_text("history: {file: past/history.db}\n")
    assert history_file(None, str(tmp_path / "ops.yaml")) == str(tmp_path / "past" / "history.db")


def test_an_ops_yaml_without_a_history_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "ops.yaml").write_text("server: {port: 9090}\n")
    with pytest.raises(ConfigError, match=r"ops\.yaml: expected a section history, got none"):
        history_file(None, str(tmp_path / "ops.yaml"))


def test_a_file_and_an_ops_yaml_are_an_error() -> None:
    with pytest.raises(ConfigError, match="expected either a history file or --ops, got both"):
        history_file("some.db", "ops.yaml")
