"""Reading a history file."""

from __future__ import annotations

from pathlib import Path

import pytest

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.ops.history.reader import HistoryReader


def test_a_missing_file_is_one_line_and_is_not_created(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.db: No such file or directory"):
        HistoryReader(tmp_path / "none.db")
    assert not (tmp_path / "none.db").exists()
