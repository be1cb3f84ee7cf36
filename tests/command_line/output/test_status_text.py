"""Levels in words; unknown is neither OK nor an alarm."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytest.importorskip("rich", reason="rich, which draws the table, is not installed")

from robot_health_monitor.core.model import Level, Status
from robot_health_monitor.output.status_text import UNKNOWN_STATES, is_unknown, level_text, rank, rank_counts

ROOT = Path(__file__).resolve().parents[3]


def status(level: Level, **facts: str) -> Status:
    return Status("battery", level, "", "atlas", {}, **facts)  # type: ignore[arg-type]


def test_the_order_is_ok_unknown_warn_stale_error() -> None:
    statuses = [
        status(Level.OK),
        status(Level.STALE, state="unreachable"),
        status(Level.WARN),
        status(Level.STALE),
        status(Level.ERROR),
    ]
    assert sorted(statuses, key=rank) == statuses
    assert rank(status(Level.STALE, state="waiting")) == rank(statuses[1])


def test_an_unknown_level_is_named_and_coloured_as_such() -> None:
    unknown = status(Level.STALE, state="waiting")
    assert is_unknown(unknown) and not is_unknown(status(Level.STALE))
    assert level_text(unknown).plain == "waiting"
    colours = [level_text(shown).spans[0].style for shown in (unknown, *(status(level) for level in Level))]
    assert len(set(colours)) == 5


def test_a_silenced_alert_says_so() -> None:
    assert level_text(status(Level.WARN, silence="until 12:00, by ana")).plain == "WARN silenced"


def test_levels_are_counted_the_worst_first() -> None:
    assert rank_counts([0, 6, 0, 1, 6]) == "2 ERROR, 1 unknown, 2 OK"


def test_the_page_uses_the_same_words() -> None:
    levels = (ROOT / "ops" / "web" / "page" / "levels.js").read_text(encoding="utf-8")
    labels = re.findall(r'^  \["\w+", "([^"]+)"\],$', levels, re.MULTILINE)
    assert sorted(labels) == sorted(["NO LINK", *(level.name for level in Level), *UNKNOWN_STATES])
