"""The rows of the benchmark table and its Markdown form."""

from __future__ import annotations

import statistics
from typing import Iterable, List, NamedTuple, Optional, Sequence


class Row(NamedTuple):
    """One figure of one contestant."""

    what: str
    """The quantity, and the conditions."""
    contestant: str
    """What was measured: the monitor or a peer."""
    figure: str = ""
    """The median, with its unit; empty where it could not be measured."""
    ratio: Optional[float] = None
    """Ratio to the contestant named in `remark`, both from this run."""
    required: Optional[float] = None
    """Largest `ratio` that meets the requirement; None: for comparison only."""
    remark: str = ""
    """What the ratio refers to, or why there is no figure."""

    @property
    def verdict(self) -> str:
        """`met`, `missed` or `not run`; empty if nothing is required."""
        if not self.figure:
            return "not run"
        if self.ratio is None or self.required is None:
            return ""
        return "met" if self.ratio <= self.required else "missed"


def median_ratio(numerators: Sequence[float], denominators: Sequence[float]) -> float:
    """Returns the median of the ratios of figures measured side by side."""
    return statistics.median(above / below for above, below in zip(numerators, denominators))


_HEADINGS = ("what", "contestant", "figure", "ratio", "required", "verdict", "remark")


def table(rows: Iterable[Row]) -> str:
    """Returns the rows as a Markdown table whose columns are aligned."""
    cells: List[Sequence[str]] = [_HEADINGS]
    cells.extend(
        (
            row.what,
            row.contestant,
            row.figure,
            "" if row.ratio is None else f"{row.ratio:.2f}",
            "" if row.required is None else f"<= {row.required:.2f}",
            row.verdict,
            row.remark,
        )
        for row in rows
    )
    widths = [max(len(line[column]) for line in cells) for column in range(len(_HEADINGS))]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths)) + " |" for line in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)
