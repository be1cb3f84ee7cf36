"""Writes the figures into docs/reference/benchmarks.md: a table per part, and what was measured where."""

from __future__ import annotations

import os
import platform
import subprocess
from pathlib import Path
from typing import Mapping, Sequence

from benchmarks.table import Row, table

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "reference" / "benchmarks.md"


def write_page(parts: Mapping[str, Sequence[Row]], measured: str, page: Path = PAGE) -> None:
    """Replaces what stands between the marks of each part, and the line about the version.

    Args:
        parts: the rows of every part that the page shows.
        measured: what was measured, as `version` returns it.
        page: the Markdown file.

    Raises:
        ValueError: the page has no marks for a part.
    """
    text = page.read_text(encoding="utf-8")
    for name, content in {"version": measured, **{part: table(rows) for part, rows in parts.items()}}.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- end of {name} -->\n"
        before, mark, rest = text.partition(begin)
        _, end_mark, after = rest.partition(end)
        if not (mark and end_mark):
            raise ValueError(f"{page}: expected the lines {begin.strip()} and {end.strip()}")
        text = f"{before}{begin}{content}\n{end}{after}"
    page.write_text(text, encoding="utf-8")


def changed_files() -> str:
    """Returns the product's files that differ from the commit, one per line; empty: none."""
    return _git("status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs")


def version() -> str:
    """Returns one line: the commit, its date, the machine."""
    commit, date = _git("show", "--no-patch", "--format=%h %cs").split()
    return f"Commit {commit} of {date}; {_processor()}, {os.cpu_count()} cores; Python {platform.python_version()}."


def _processor() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()
    return platform.machine()


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
