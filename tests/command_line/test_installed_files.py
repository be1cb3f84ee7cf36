"""Installed files are found."""

from __future__ import annotations

from robot_health_monitor.installed_files import find_installed


def test_the_configuration_is_found() -> None:
    file = find_installed("config/thresholds.yaml")
    assert file is not None and file.is_file()


def test_a_file_that_does_not_exist_is_not_found() -> None:
    assert find_installed("config/no_such_file.yaml") is None
