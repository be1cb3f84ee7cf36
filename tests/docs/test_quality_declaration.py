"""QUALITY_DECLARATION.md speaks of every point of REP-2004, and its figures are those of the gate."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "QUALITY_DECLARATION.md").read_text(encoding="utf-8")
ROWS: dict[str, str] = dict(re.findall(r"^\| (\d\.[a-z.]+) [^|]*\| (.*) \|$", TEXT, re.MULTILINE))

CHART = {
    "1.i": "1 2 3", "1.ii": "1 2 3", "1.iii": "1 2", "1.iv": "1 2 3", "1.v": "1 2 3", "1.vi": "1 2",
    "2.i": "1 2 3", "2.ii": "1 2", "2.iii": "1", "2.iv": "1 2 3", "2.v": "1",
    "3.i": "1 2", "3.ii": "1", "3.iii": "1 2 3", "3.iv": "1 2 3", "3.v": "1 2", "3.v.a": "1 2 3", "3.v.b": "",
    "3.v.c": "1 2 3",
    "4.i": "1 2", "4.ii": "1", "4.iii.a": "1 2", "4.iii.b": "1", "4.iv.a": "1", "4.iv.b": "1", "4.v.a": "1 2",
    "4.v.b": "1 2",
    "5.i": "1 2", "5.ii": "", "5.iii": "1 2", "6.i": "1 2 3", "7.i": "1 2",
}  # fmt: skip
"""The points with the levels that require them, from the chart of REP-2004."""


def test_every_point_has_a_row_with_its_levels_and_a_state() -> None:
    cells = {point: [cell.strip() for cell in row.split("|")] for point, row in ROWS.items()}
    assert {point: cell[0] for point, cell in cells.items()} == CHART
    states = {cell[1].strip("*") for cell in cells.values()}
    assert states == {"met", "not met", "met from 1.0.0 on"}


def test_the_text_names_the_points_of_level_2_and_3_that_are_not_met() -> None:
    not_met = {point for point, row in ROWS.items() if "not met" in row.split("|")[1]}
    assert [point for point in CHART if point in not_met and "3" in CHART[point]] == ["6.i"]
    (named,) = re.findall(r"whose points (.*?) it does not meet", TEXT)
    assert re.findall(r"\d\.[a-z.]*[a-z]", named) == [
        point for point in CHART if point in not_met and "2" in CHART[point]
    ]


def test_the_gate_is_the_one_that_is_declared() -> None:
    (gate,) = re.findall(r"^fail_under = (\d+)$", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert f"fails below {gate} %" in ROWS["4.iii.b"]
