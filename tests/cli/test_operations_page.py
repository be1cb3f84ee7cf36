"""docs/operations.md: its configurations are valid, its commands exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from robot_health_monitor.cli.arguments import parse
from robot_health_monitor.core.config.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import read_ops

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "operations.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.parametrize("text", blocks("yaml"))
def test_a_configuration_is_valid(text: str, tmp_path: Path) -> None:
    file = tmp_path / "ops.yaml"
    file.write_text(text)
    assert read_ops(read_yaml(file)).summary


@pytest.mark.parametrize("line", re.findall(r"^\$ robot-health (.*)$", PAGE, re.MULTILINE))
def test_a_command_exists(line: str) -> None:
    assert parse(shlex.split(line)).command == line.split()[0]
