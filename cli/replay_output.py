"""What a replay prints: alert lines while it runs, a progress bar on a terminal, and at the end a table of signals."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, Optional, Sequence, Tuple

from ..core.config.signal_config import SignalConfig
from ..core.judge.sources import is_source
from ..core.judge.wording import judged_unit
from ..core.nodes.outlets import json_line
from ..core.port.local import LogLine
from ..core.port.middleware import Severity
from ..core.values.formatting import duration_text, list_text, number_text, printable, with_unit
from ..core.values.model import Level, Transition
from ..runtime.libraries import missing_libraries, missing_text
from .output.events import Entry
from .output.lines import below_causes, is_terminal, plain_line, plain_table, readable, share_text

if TYPE_CHECKING:
    from ..recordings.judging import SignalSummary

_STYLE_OF_LEVEL = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "magenta"}
_REFRESH_S = 0.1
_LEVELS = (Level.OK, Level.WARN, Level.ERROR, Level.STALE)
_WORST_FIRST = sorted((level for level in Level if level is not Level.OK), key=lambda level: -level.severity)
_MOST_NAMES = 6  # signals that are named in a sentence
_NOT_RECORDED = "not recorded"
_GAP = 2  # blanks between columns
_NUMBERS = (
    "samples", "bad", *(level.name for level in _LEVELS), "unknown", "alerts", "min", "mean", "max", "longest gap"
)  # fmt: skip


class ReplayOutput:
    """Writes alerts to stdout and everything else about the replay to where it does not disturb them."""

    def __init__(self, as_json: bool) -> None:
        """Prepares the output; `as_json`: one JSON object per transition on stdout, the rest on stderr."""
        self._as_json = as_json
        self._console: Any = None
        on_terminal = is_terminal(sys.stdout)
        if on_terminal or is_terminal(sys.stderr):
            try:
                from rich.console import Console

                self._console = Console(stderr=not on_terminal, highlight=False)
            except ModuleNotFoundError as error:
                missing = missing_text(missing_libraries(error, "rich"))
                sys.stderr.write(f"{missing} (no progress bar, no colours)\n")
        self._has_styles = on_terminal and self._console is not None
        self._progress: Any = None
        self._refreshed_s = 0.0

    def __enter__(self) -> ReplayOutput:
        """Shows the progress bar, on a terminal."""
        if self._console is not None:
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

            # Redirecting would send the alerts to this terminal even if stdout is a file or a pipe.
            self._progress = Progress(
                *(TextColumn("judging"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn()),
                console=self._console,
                transient=True,
                auto_refresh=False,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._progress.add_task("judging", total=1.0)
            self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Removes the progress bar."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None

    def progress(self, fraction: float) -> None:
        """Moves the progress bar."""
        if self._progress is None or (time.monotonic() - self._refreshed_s < _REFRESH_S and fraction < 1.0):
            return
        self._refreshed_s = time.monotonic()
        self._progress.update(self._progress.task_ids[0], completed=fraction)
        self._progress.refresh()

    def transition(self, wall_s: float, transition: Transition, file: str) -> None:
        """Writes a transition at a time in s since 1970; `file` is its configuration, empty if there is only one."""
        if self._as_json:
            line = json_line(transition, **({"file": file} if file else {}))
        else:
            line = readable(plain_line(Entry(wall_s, transition), prefix=file), sys.stdout)
        self._write(line, _STYLE_OF_LEVEL[transition.to_level])

    def log(self, wall_s: float, line: LogLine) -> None:
        """Writes a line of a node; INFO lines go where the alerts are, except with JSON."""
        text = plain_line(Entry(wall_s, line))
        if line.severity >= Severity.WARN or self._as_json:
            self.warn(text)
        else:
            self._write(text, "dim")

    def warn(self, text: str) -> None:
        """Writes a line to stderr."""
        if self._progress is not None and is_terminal(sys.stderr):
            self._print(text, "yellow")  # above the progress bar, which is on this terminal
            return
        sys.stdout.flush()
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], last_line: str) -> None:
        """Writes the table, with a line below it."""
        stream = sys.stderr if self._as_json else sys.stdout
        shown = [[readable(cell, stream) for cell in cells] for cells in rows]
        if self._has_styles and not self._as_json:
            for table in _rich_tables(head, shown, self._console.width):
                self._console.print()
                self._console.print(table)
            self._print(last_line, "bold")
        else:
            stream.write(
                "".join(
                    f"{line}\n"
                    for line in ("", *plain_table([head, *shown], len(head) - len(_NUMBERS)), printable(last_line))
                )
            )
            stream.flush()

    def _write(self, line: str, style: str) -> None:
        if self._has_styles:
            self._print(line, style)
        else:
            sys.stdout.write(f"{line}\n")

    def _print(self, line: str, style: str) -> None:
        from rich.text import Text

        self._console.print(Text(printable(line), style=style), soft_wrap=True)


def header(several_files: bool) -> List[str]:
    """Returns the heads of the columns; with `several_files` there is one for the configuration."""
    return ["signal", *(["file"] if several_files else []), *_NUMBERS]


def row(summary: SignalSummary, several_files: bool) -> List[str]:
    """Returns the cells of one signal, in the order of `header`."""
    names = [summary.config.name, *([summary.file] if several_files else [])]
    if not summary.recorded:
        return [*names, _NOT_RECORDED, *[""] * (len(_NUMBERS) - 1)]
    statistics = summary.statistics
    shares = [share_text(summary.shares.get(level, 0.0)) for level in _LEVELS]
    range_texts = range_cells(summary.config, statistics.min, statistics.mean, statistics.max)
    gap = "-" if statistics.longest_gap_s is None else duration_text(statistics.longest_gap_s)
    counts = ["-", "-"] if is_source(names[0]) else [str(statistics.samples), str(statistics.bad_samples)]
    return [
        *names, *counts, *shares, share_text(summary.unknown),
        str(summary.alerts), *range_texts, gap,
    ]  # fmt: skip


def range_cells(
    config: SignalConfig, smallest: Optional[float], mean: Optional[float], largest: Optional[float]
) -> List[str]:
    """Returns the cells min, mean and max: values of the statistic, or the levels of a driver, which have no mean."""
    if config.is_status and not config.is_template:
        ends = ["-" if value is None else Level(int(value)).name for value in (smallest, largest)]
        return [ends[0], "-", ends[1]]
    unit = judged_unit(config)
    return ["-" if value is None else with_unit(number_text(value), unit) for value in (smallest, mean, largest)]


def folded(summaries: Sequence[SignalSummary]) -> List[Tuple[SignalSummary, int]]:
    """Returns the summaries with effects below their cause, and how many follow each: -1 for an effect."""
    return below_causes(summaries, lambda each: (each.file, each.config.name), lambda each: each.cause)


def worst_first(summaries: Sequence[SignalSummary]) -> List[SignalSummary]:
    """Returns the summaries in the order of badness; those of one signal stay together."""
    badness: Dict[str, Tuple[float, ...]] = {}
    for summary in summaries:
        name = summary.config.name
        badness[name] = max(_badness(summary), badness.get(name, ()))
    return sorted(summaries, key=lambda summary: badness[summary.config.name], reverse=True)


def _badness(summary: SignalSummary) -> Tuple[float, ...]:
    """Returns the shares of the levels, the worst first; a signal that was not judged is worse than one that was OK."""
    shares = (summary.shares.get(level, 0.0) for level in _WORST_FIRST)
    return (*shares, float(summary.alerts), float(bool(summary.missing)))


def sentence(summaries: Sequence[SignalSummary], duration_s: float) -> str:
    """Returns what was judged, for how long, and which signal was worst: the first of the summaries."""
    judged_ones = (summary.config.name for summary in summaries if not summary.missing)
    names = [name for name in dict.fromkeys(judged_ones) if not is_source(name)]
    several = f" ({len(names)} signals)" if len(names) > _MOST_NAMES else ""
    were = "was" if len(names) == 1 else "were"
    judged = f"{list_text(names, _MOST_NAMES)}{several} {were} judged over {duration_text(duration_s)}."
    worst = summaries[0]
    shares = [
        f"{level.name} for {share_text(worst.shares[level])}" for level in _WORST_FIRST if worst.shares.get(level)
    ]
    if not shares:
        return f"{judged} {'It was' if len(names) == 1 else 'All were'} OK."
    return f"{judged} The worst is {worst.config.name}: {', '.join(shares)} of the time."


def _rich_tables(head: Sequence[str], rows: Sequence[Sequence[str]], width: int) -> Iterator[object]:
    """Yields the table for rich, in several parts if it is wider than the terminal; each begins with the texts."""
    from rich.cells import cell_len
    from rich.table import Table
    from rich.text import Text

    lines = [[printable(cell) for cell in line] for line in (head, *rows)]
    widths = [_GAP + max(map(cell_len, column)) for column in zip(*lines)]
    texts = len(head) - len(_NUMBERS)
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
        yield table


def _parts(widths: Sequence[int], room: int) -> Iterator[slice]:
    """Yields successive columns that fit into a width, at least one at a time."""
    start = used = 0
    for at, width in enumerate(widths):
        if used and used + width - _GAP > room:
            yield slice(start, at)
            start, used = at, 0
        used += width
    yield slice(start, len(widths))
