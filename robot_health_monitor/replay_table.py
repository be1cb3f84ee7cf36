"""The table at the end of a replay: one row per signal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict, Iterator, List, Sequence, Tuple

from robot_health_monitor.core.explanation import judged_unit
from robot_health_monitor.core.formatting import duration_text, list_text, number_text, printable, with_unit
from robot_health_monitor.core.model import Level

if TYPE_CHECKING:
    from robot_health_monitor.recordings.judging import SignalSummary

_LEVELS = (Level.OK, Level.WARN, Level.ERROR, Level.STALE)
_WORST_FIRST = sorted((level for level in Level if level is not Level.OK), key=lambda level: -level.severity)
_MOST_NAMES = 6
"""Signals that are named in a sentence."""
_NOT_RECORDED = "not recorded"
_GAP = 2
"""Blanks between columns."""
_NUMBERS = (
    "samples", "bad", *(level.name for level in _LEVELS), "unknown", "alerts", "min", "mean", "max", "longest gap"
)  # fmt: skip


def header(several_files: bool) -> List[str]:
    """Returns the heads of the columns.

    Args:
        several_files: whether there is a column for the configuration.
    """
    return ["signal", *(["file"] if several_files else []), *_NUMBERS]


def row(summary: SignalSummary, several_files: bool) -> List[str]:
    """Returns the cells of one signal, in the order of `header`."""
    names = [summary.config.name, *([summary.file] if several_files else [])]
    if not summary.recorded:
        return [*names, _NOT_RECORDED, *[""] * (len(_NUMBERS) - 1)]
    statistics = summary.statistics
    shares = [_share_text(summary.shares.get(level, 0.0)) for level in _LEVELS]
    range_texts = [
        "-" if value is None else with_unit(number_text(value), judged_unit(summary.config))
        for value in (statistics.min, statistics.mean, statistics.max)
    ]
    gap = "-" if statistics.longest_gap_s is None else duration_text(statistics.longest_gap_s)
    return [
        *names, str(statistics.samples), str(statistics.bad_samples), *shares, _share_text(summary.unknown),
        str(summary.alerts), *range_texts, gap,
    ]  # fmt: skip


def worst_first(summaries: Sequence[SignalSummary]) -> List[SignalSummary]:
    """Returns the summaries in the order of badness; those of one signal stay together."""
    badness: Dict[str, Tuple[float, ...]] = {}
    for summary in summaries:
        name = summary.config.name
        badness[name] = max(_badness(summary), badness.get(name, ()))
    return sorted(summaries, key=lambda summary: badness[summary.config.name], reverse=True)


def _badness(summary: SignalSummary) -> Tuple[float, ...]:
    """Returns the shares of the levels, the worst first; a signal that was not judged is worse than one that was OK."""
    return (
        *(summary.shares.get(level, 0.0) for level in _WORST_FIRST),
        float(summary.alerts),
        float(bool(summary.missing)),
    )


def sentence(summaries: Sequence[SignalSummary], duration_s: float) -> str:
    """Returns what was judged, for how long, and which signal was worst.

    Args:
        summaries: the worst first.
        duration_s: length of the recordings.
    """
    names = list(dict.fromkeys(summary.config.name for summary in summaries if not summary.missing))
    several = f" ({len(names)} signals)" if len(names) > _MOST_NAMES else ""
    were = "was" if len(names) == 1 else "were"
    judged = f"{list_text(names, _MOST_NAMES)}{several} {were} judged over {duration_text(duration_s)}."
    worst = summaries[0]
    shares = [
        f"{level.name} for {_share_text(worst.shares[level])}" for level in _WORST_FIRST if worst.shares.get(level)
    ]
    if not shares:
        return f"{judged} {'It was' if len(names) == 1 else 'All were'} OK."
    return f"{judged} The worst is {worst.config.name}: {', '.join(shares)} of the time."


def plain_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> List[str]:
    """Returns the lines of a table with aligned columns: texts to the left, numbers to the right."""
    texts = len(head) - len(_NUMBERS)
    lines = [[printable(cell) for cell in line] for line in (head, *rows)]
    widths = [max(len(line[column]) for line in lines) for column in range(len(head))]
    aligned = (
        [cell.ljust(width) if at < texts else cell.rjust(width) for at, (cell, width) in enumerate(zip(line, widths))]
        for line in lines
    )
    return ["  ".join(cells).rstrip() for cells in aligned]


def rich_tables(head: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> List[object]:
    """Returns the table for rich, in several parts if it is wider than the terminal; each begins with the texts.

    Args:
        head: heads of the columns.
        rows: cells of each row.
        width: columns of the terminal.
    """
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    lines = [[printable(cell) for cell in line] for line in (head, *rows)]
    widths = [_GAP + max(cell_len(line[at]) for line in lines) for at in range(len(head))]
    texts = len(head) - len(_NUMBERS)
    parts: List[object] = []
    for numbers in _parts(widths[texts:], width - sum(widths[:texts])):
        table = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")
        for name in lines[0][:texts]:
            table.add_column(name, overflow="fold")
        for name in lines[0][texts:][numbers]:
            table.add_column(name, justify="right", no_wrap=True)
        for line in lines[1:]:
            cells = line[texts:][numbers]
            if any(cells):
                style = "dim" if _NOT_RECORDED in cells else None
                table.add_row(*map(Text, line[:texts] + cells), style=style)
        parts.append(table)
    return parts


def _parts(widths: Sequence[int], room: int) -> Iterator[slice]:
    """Yields successive columns that fit into a width, at least one at a time."""
    start = used = 0
    for at, width in enumerate(widths):
        if used and used + width - _GAP > room:
            yield slice(start, at)
            start, used = at, 0
        used += width
    yield slice(start, len(widths))


def _share_text(share: float) -> str:
    if share <= 0.0 or share >= 1.0:
        return "0 %" if share <= 0.0 else "100 %"
    percent = min(max(share * 100.0, 0.1), 99.9)  # neither 0 nor 100
    return f"{percent:.1f} %"
