"""Writing the file of a report; test_replay_reports.py has what it may replace."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from robot_health_monitor.cli.output.lines import OutputError
from robot_health_monitor.cli.report_file import ReportFile
from robot_health_monitor.core.values.errors import ConfigError


def test_a_file_that_appears_during_the_replay_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    report = ReportFile(str(path), [], force=False)
    path.write_text("mine", encoding="utf-8")
    with pytest.raises(ConfigError, match="is not a report"):
        report.write("page")
    assert path.read_text(encoding="utf-8") == "mine"


def test_a_report_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(source: str, target: str) -> None:
        raise OSError(28, "No space left on device")

    report = ReportFile(str(tmp_path / "report.html"), [], force=False)
    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match=r"report\.html: cannot be written: No space left on device"):
        report.write("page")
    assert list(tmp_path.iterdir()) == []
