"""The summary of a signal, as a row of the tables of a replay and of a history."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.report.summaries import SummaryRow, range_cells, sentence, table


def row(signal: str, group: str = "", cause: str = "", **shares: float) -> SummaryRow:
    """Returns the row of a signal with shares of its time; the rest is unknown."""
    by_level: Dict[Level, float] = {Level[level]: share for level, share in shares.items()}
    return SummaryRow(signal, group, cause, by_level, 1.0 - sum(shares.values()), 2, {"samples": "7"})


def test_a_row_has_the_columns_that_are_asked_for() -> None:
    heads = ["robot", "signal", "OK", "WARN", "unknown", "alerts", "samples"]
    assert row("gps", "r1", OK=0.75, WARN=0.125).cells(heads) == ["r1", "gps", "75.0 %", "12.5 %", "12.5 %", "2", "7"]


def test_effects_are_below_their_cause_of_the_same_group() -> None:
    rows = [
        row("left", "r1", "/scan"),
        row("/scan", "r1"),
        row("left", "r2", "/scan"),
        row("gps", "r1"),
        row("right", "r1", "/scan"),
    ]
    assert table(["robot", "signal"], rows) == [
        ["robot", "signal"], ["r1", "/scan (+ 2 affected)"], ["r1", "  left"], ["r1", "  right"], ["r2", "left"],
        ["r1", "gps"],
    ]  # fmt: skip


def test_levels_of_drivers_have_names_and_no_mean() -> None:
    drivers = {"topic": "/diagnostics", "type": "diagnostic_msgs/DiagnosticArray", "field": 'status["*"]'}
    template = read_signal("drivers", drivers)
    left = replace(template, name="drivers[left]")
    assert list(range_cells(left, 0.0, 0.25, 2.0).values()) == ["OK", "-", "ERROR"]
    assert list(range_cells(left, None, None, None).values()) == ["-"] * 3
    elements = range_cells(template, 3.0, 4.0, 5.0)  # the number of its elements
    assert elements == {"min": "3", "mean": "4", "max": "5"}


def test_a_sentence_counts_the_signals_and_names_the_worst() -> None:
    two = [row("hot", OK=0.75, ERROR=0.05, WARN=0.2), row("fine", OK=1.0)]
    assert sentence(two, "judged", "file", 4000.0) == (
        "2 signals were judged over 1 h 6 min. The worst is hot: ERROR for 5.0 %, WARN for 20.0 % of the time."
    )


def test_a_sentence_counts_neither_topics_nor_signals_that_are_unknown() -> None:
    rows = [row("fine", OK=1.0), row("missing"), row("/scan", OK=1.0)]
    assert sentence(rows, "judged", "file", 60.0) == "1 signal was judged over 60 s. It was OK as far as it is known."
    assert sentence(rows[:1], "judged", "file", 60.0) == "1 signal was judged over 60 s. It was OK."


def test_a_sentence_counts_robots_and_names_that_of_the_worst() -> None:
    rows = [row("a", "r2", WARN=1.0), row("a", "r1", OK=1.0), row("b", "r1", OK=1.0)]
    assert sentence(rows, "watched", "robot", 60.0) == (
        "3 signals of 2 robots were watched over 60 s. The worst is r2: a: WARN for 100 % of the time."
    )
