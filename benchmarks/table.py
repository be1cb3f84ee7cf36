"""The rows of the benchmark table, how they are measured side by side, and the page that shows them."""

from __future__ import annotations

import os
import platform
import re
import statistics
import subprocess
from pathlib import Path
from typing import Callable, Iterable, Iterator, Mapping, NamedTuple, Sequence

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "benchmarks.md"
_HEADINGS = ("what", "contestant", "figure", "ratio", "required", "verdict", "remark")


class Row(NamedTuple):
    """One figure of one contestant."""

    what: str
    """The quantity, and the conditions."""
    contestant: str
    """What was measured: the monitor or a peer."""
    figure: str = ""
    """The median, with its unit; empty where it could not be measured."""
    ratio: float | None = None
    """Ratio to the contestant or the limit that is named in `remark`, both from this run."""
    required: float | None = None
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


_FACTORS = {"us": 1e6, "ms": 1e3, "ms/s": 1e3, "%": 100.0, "% of a core": 100.0, "MB": 1e-6}
"""Units of the table; what is measured is in s, bytes and shares of a core. Other units are written as measured."""


def figure(value: float, unit: str) -> str:
    """Returns three digits of what was measured, in a unit."""
    value *= _FACTORS.get(unit, 1.0)
    return f"{value:.{2 if value < 10.0 else 1 if value < 100.0 else 0}f} {unit}"


def within(what: str, contestant: str, value: float, limit: float, unit: str, remark: str = "") -> Row:
    """Returns the row of a figure that must not exceed a limit, which is in the unit of the row."""
    remark = f"{remark}, to {limit:g} {unit}" if remark else f"to {limit:g} {unit}"
    return Row(what, contestant, figure(value, unit), value * _FACTORS.get(unit, 1.0) / limit, 1.0, remark)


def beside(
    what: str,
    measured: Mapping[str, Sequence[float]],
    unit: str,
    required: Mapping[str, float] | float | None = None,
    remark: str = "",
) -> Iterator[Row]:
    """Yields the rows of contestants that were measured side by side; ratios are to the first of them.

    `required` is the largest ratio of all the others, or of those that it names. Each ratio is the median of the
    ratios of the rounds.
    """
    peer, *_ = measured
    for name, values in measured.items():
        row = Row(what, name, figure(statistics.median(values), unit))
        if name != peer:
            ratio = statistics.median(above / below for above, below in zip(values, measured[peer]))
            limit = required.get(name) if isinstance(required, Mapping) else required
            row = row._replace(ratio=ratio, required=limit, remark=f"to {peer}{remark}")
        yield row


def side_by_side(measure: Callable[[], Mapping[str, float]], rounds: int) -> dict[str, list[float]]:
    """Measures all contestants round after round; returns the figures of each, without those of the first round."""
    measured = [measure() for _ in range(rounds + 1)][1:]
    return {name: [each[name] for each in measured] for name in measured[0]}


def table(rows: Iterable[Row]) -> str:
    """Returns the rows as a Markdown table whose columns are aligned."""
    cells: list[Sequence[str]] = [_HEADINGS]
    for row in rows:
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        required = "" if row.required is None else f"<= {row.required:.2f}"
        cells.append((row.what, row.contestant, row.figure, ratio, required, row.verdict, row.remark))
    widths = [max(map(len, column)) for column in zip(*cells)]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths)) + " |" for line in cells]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines)


def write_page(parts: Mapping[str, Sequence[Row]], measured: str, page: Path = PAGE) -> None:
    """Replaces what stands between the marks of each part, and the line `measured` about the version.

    Raises ValueError if the page has no marks for a part.
    """
    text = page.read_text(encoding="utf-8")
    for name, content in {"version": measured, **{part: table(rows) for part, rows in parts.items()}}.items():
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        around = re.split(f"{begin}\n.*?{end}", text, flags=re.DOTALL)
        if len(around) != 2:
            raise ValueError(f"{page}: expected the lines {begin} and {end} once")
        text = f"{begin}\n{content}\n{end}".join(around)
    page.write_text(text, encoding="utf-8")


def changed_files() -> str:
    """Returns the product's files that differ from the commit, one per line; empty: none."""
    return _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")


def version() -> str:
    """Returns one line: the commit, its date, the machine."""
    commit, date = _git("show", "--no-patch", "--format=%h %cs").split()
    model = re.search(r"model name\s*: (.*)", Path("/proc/cpuinfo").read_text("utf-8"))
    processor = model[1] if model else platform.machine()
    return f"Commit {commit} of {date}; {processor}, {os.cpu_count()} cores; Python {platform.python_version()}."


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
