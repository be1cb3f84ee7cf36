"""Lines of a table on a terminal, laid out in cells: padded columns, and text that continues on further lines."""

from __future__ import annotations

from typing import List, Sequence, Tuple

from rich.cells import cell_len, chop_cells
from rich.text import Text

__all__ = ["GAP", "INDENT", "cells_line", "wrapped"]

GAP = 2
"""Blanks between columns."""
INDENT = "  "
"""Before a text that has a line to itself."""
_MOST_LINES = 6


def cells_line(cells: Sequence[Tuple[Text, int]], width: int, rest: str = "", style: str = "") -> Text:
    """Returns one line: each text padded or shortened to its width, then `rest`; at most `width` cells."""
    line = Text(style=style)
    for cell, cell_width in cells:
        cell.truncate(cell_width, overflow="ellipsis", pad=True)
        line.append_text(cell)
        line.append(" " * GAP)
    line.append(rest)
    line.rstrip()
    line.truncate(width)
    return line


def wrapped(text: str, width: int) -> List[str]:
    """Divides a text at blanks into parts of at most `width` cells; at least one part, and at most six."""
    parts: List[str] = [""]
    for word in text.split(" "):
        for piece in chop_cells(word, max(1, width)) or [""]:
            joined = f"{parts[-1]} {piece}" if parts[-1] else piece
            if cell_len(joined) <= width:
                parts[-1] = joined
            else:
                parts.append(piece)
    if len(parts) > _MOST_LINES:
        parts = [*parts[: _MOST_LINES - 1], "..."]
    return parts
