"""Fixtures for silences: a wall clock that can be set, a history file, and the silences in it."""

from __future__ import annotations

from pathlib import Path
from typing import Iterator

import pytest
from harness.silences import Clock

from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store import history as store_history
from robot_health_monitor.ops.store.active_silences import Silences
from robot_health_monitor.ops.store.history import History


@pytest.fixture(autouse=True)
def _every_commit_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine must not look like a disk that hangs: `record` returns when the transition is committed."""
    monkeypatch.setattr(store_history, "COMMIT_TIMEOUT_S", 60.0)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def history(tmp_path: Path, clock: Clock) -> Iterator[History]:
    opened = History(HistorySettings(str(tmp_path / "history.db")), wall_time_s=clock)
    yield opened
    opened.close()


@pytest.fixture
def silences(history: History, clock: Clock) -> Silences:
    return Silences(history)
