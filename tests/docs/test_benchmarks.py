"""docs/reference/benchmarks.md shows the tables that `make bench ARGS=--write` writes, each of the same run."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from benchmarks.__main__ import PARTS
from benchmarks.page import PAGE, write_page
from benchmarks.table import Row


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
