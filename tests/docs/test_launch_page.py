"""The examples of docs/launch.md can be used as they are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from robot_health_monitor.__main__ import main
from robot_health_monitor.core import load_config

PAGE = Path(__file__).resolve().parents[2] / "docs" / "launch.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_the_signal_of_nav2_is_valid(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (text,) = blocks("yaml")
    file = tmp_path / "thresholds.yaml"
    file.write_text(text, encoding="utf-8")
    assert main(["check", str(file)]) == 0
    assert capsys.readouterr().err == ""
    assert load_config(file).signals["navigation"].is_status


def test_the_launch_file_is_python() -> None:
    (text,) = blocks("python")
    compile(text, "launch.md", "exec")


def test_the_policy_is_written_by_the_command_of_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (line,) = re.findall(r"^robot-health (.*) > health\.policy\.xml$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    (text,) = blocks("yaml")
    file = tmp_path / "thresholds.yaml"
    file.write_text(text, encoding="utf-8")
    assert main(line.replace("thresholds.yaml", str(file)).split()) == 0
    assert '<enclave path="/carter/health_monitor">' in capsys.readouterr().out
