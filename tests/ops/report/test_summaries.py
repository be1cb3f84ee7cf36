"""The summary of a signal, as a row of the tables of a replay and of a history."""

from __future__ import annotations

from dataclasses import replace

from robot_health_monitor.core.config.signal_config import read_signal
from robot_health_monitor.core.values.model import Level
from robot_health_monitor.ops.report.summaries import SummaryRow, range_cells, table


def row(signal: str, group: str = "", cause: str = "", **shares: float) -> SummaryRow:
    """Returns the row of a signal with shares of its time; the rest is unknown."""
    by_level: dict[Level, float] = {Level[level]: share for level, share in shares.items()}
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
