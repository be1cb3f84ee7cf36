"""docs/reference/benchmarks.md shows the tables that `make bench ARGS=--write` writes, each of the same run."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from benchmarks import forecasts
from benchmarks.__main__ import PARTS
from benchmarks.table import PAGE, Row, write_page


def test_every_part_has_its_place_and_only_the_tables_are_replaced(tmp_path: Path) -> None:
    page = tmp_path / "benchmarks.md"
    shutil.copy(PAGE, page)
    write_page({part: [Row(part, "monitor", "1 us")] for part in PARTS}, "Commit 1234567.", page)
    written = page.read_text(encoding="utf-8")
    for part in PARTS:
        assert re.search(rf"\| {part} +\| monitor +\| 1 us +\|", written)
    assert "\nCommit 1234567.\n" in written

    def prose(text: str) -> str:
        return re.sub(r"(<!-- (\w+) -->\n).*?(<!-- end of \2 -->\n)", r"\1\3", text, flags=re.S)

    assert prose(written) == prose(PAGE.read_text(encoding="utf-8"))


def test_a_page_without_a_place_is_an_error(tmp_path: Path) -> None:
    page = tmp_path / "benchmarks.md"
    page.write_text("<!-- version -->\n<!-- end of version -->\n", encoding="utf-8")
    with pytest.raises(ValueError, match="<!-- observe -->"):
        write_page({"observe": []}, "", page)


def test_a_straight_discharge_is_known_to_the_second() -> None:
    """From 100 %, 1 % less per minute: below 20 % after 80 min and 1 s. The alert: 30 min ahead, and for_s of 60 s."""
    errors, unstated, left_s = forecasts.judge([100.0 - second / 60.0 for second in range(6000)], 20.0, 600.0)
    assert len(errors) == 137  # 600, 630, ... 4680 s
    assert max(map(abs, errors)) < 0.01
    assert (unstated, left_s) == (0, pytest.approx(1740.0, abs=2.0))


def test_a_cell_that_rests_states_no_time() -> None:
    assert forecasts.judge([50.0] * 3600 + [10.0], 20.0, 600.0) == ([], 97, 0.0)
