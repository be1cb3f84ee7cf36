"""Lines in cells: padded columns, and text that continues on further lines."""

from __future__ import annotations

import pytest

pytest.importorskip("rich", reason="rich, which draws the table, is not installed")

from rich.text import Text

from robot_health_monitor.output.text_cells import cells_line, wrapped


def test_columns_are_padded_and_shortened_to_their_width_in_cells() -> None:
    assert cells_line([(Text("ab"), 4), (Text("電池電池"), 5)], 40, "rest").plain == "ab    電池…  rest"


def test_no_line_is_wider_than_the_terminal() -> None:
    assert cells_line([(Text("abcdef"), 6)], 10, "reason").plain == "abcdef  re"


def test_a_text_continues_at_blanks_and_a_long_word_is_divided() -> None:
    assert wrapped("one two abcdefghij", 7) == ["one two", "abcdefg", "hij"]
    assert wrapped("", 7) == [""]


def test_a_text_without_end_has_six_lines() -> None:
    assert wrapped("word " * 100, 4) == ["word"] * 5 + ["..."]
