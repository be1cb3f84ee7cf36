"""What a replay prints: alert lines while it runs, a progress bar on a terminal, and at the end a table of signals."""

from __future__ import annotations

import shutil
import sys
import time
from typing import TYPE_CHECKING, Dict, Iterator, List, Optional, Sequence, Tuple

from ..core.config.signal_config import SignalConfig
from ..core.judge.sources import is_source
from ..core.judge.wording import judged_unit
from ..core.nodes.outlets import json_line
from ..core.port.local import LogLine
from ..core.port.middleware import Severity
from ..core.values.formatting import duration_text, list_text, number_text, printable, with_unit
from ..core.values.model import Level, Transition
from .output.events import Entry
from .output.lines import (
    COLOURS,
    ProgressLine,
    badness,
    below_causes,
    coloured,
    is_coloured,
    is_terminal,
    plain_line,
    plain_table,
    readable,
    share_cells,
    summary_sentence,
)

if TYPE_CHECKING:
    from ..recordings.judging import SignalSummary

_MOST_NAMES = 6  # signals that are named in a sentence
_NOT_RECORDED = "not recorded"
_GAP = 2  # blanks between columns
_NUMBERS = (
    "samples", "bad", *(level.name for level in Level), "unknown", "alerts", "min", "mean", "max", "longest gap"
)  # fmt: skip


class ReplayOutput:
    """Writes alerts to stdout and everything else about the replay to where it does not disturb them."""

    def __init__(self, as_json: bool) -> None:
        """Prepares the output; `as_json`: one JSON object per transition on stdout, the rest on stderr."""
        self._as_json = as_json
        self._is_coloured = is_coloured(sys.stdout) and not as_json
        self._progress = ProgressLine()
        self._started_s = time.monotonic()

    def __enter__(self) -> ReplayOutput:
        """Returns itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """Removes the progress."""
        self._progress.clear()

    def progress(self, fraction: float) -> None:
        """Shows how much has been judged, 0 to 1, on a terminal."""
        left_s = (time.monotonic() - self._started_s) * (1.0 / max(fraction, 1e-9) - 1.0)
        self._progress.show(f"judging: {fraction:.0%}, {left_s:.0f} s left")

    def transition(self, wall_s: float, transition: Transition, file: str) -> None:
        """Writes a transition at a time in s since 1970; `file` is its configuration, empty if there is only one."""
        if self._as_json:
            line = json_line(transition, **({"file": file} if file else {}))
        else:
            line = readable(plain_line(Entry(wall_s, transition), prefix=file), sys.stdout)
        self._write(line, COLOURS[transition.to_level])

    def log(self, wall_s: float, line: LogLine) -> None:
        """Writes a line of a node; INFO lines go where the alerts are, except with JSON."""
        text = plain_line(Entry(wall_s, line))
        if line.severity >= Severity.WARN or self._as_json:
            self.warn(text)
        else:
            self._write(text, "2")

    def warn(self, text: str) -> None:
        """Writes a line to stderr."""
        self._progress.clear()
        sys.stdout.flush()
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], last_line: str) -> None:
        """Writes the table, on a terminal in parts that fit, with a line below it."""
        stream = sys.stderr if self._as_json else sys.stdout
        lines = [[printable(readable(cell, stream)) for cell in cells] for cells in (head, *rows)]
        widths = [_GAP + max(map(len, column)) for column in zip(*lines)]
        texts = len(head) - len(_NUMBERS)
        width = shutil.get_terminal_size().columns if is_terminal(stream) else sys.maxsize
        shown = []
        for numbers in _parts(widths[texts:], width - sum(widths[:texts])):
            part = ([*line[:texts], *line[texts:][numbers]] for line in lines if any(line[texts:][numbers]))
            shown += ["", *plain_table(list(part), texts)]
        for line in (*shown, printable(last_line)):
            self.warn(line) if self._as_json else self._write(line)
        stream.flush()

    def _write(self, line: str, colour: str = "") -> None:
        self._progress.clear()
        sys.stdout.write(f"{coloured(line, colour) if self._is_coloured else line}\n")


def header(several_files: bool) -> List[str]:
    """Returns the heads of the columns; with `several_files` there is one for the configuration."""
    return ["signal", *(["file"] if several_files else []), *_NUMBERS]


def row(summary: SignalSummary, several_files: bool) -> List[str]:
    """Returns the cells of one signal, in the order of `header`."""
    names = [summary.config.name, *([summary.file] if several_files else [])]
    if not summary.recorded:
        return [*names, _NOT_RECORDED, *[""] * (len(_NUMBERS) - 1)]
    statistics = summary.statistics
    range_texts = range_cells(summary.config, statistics.min, statistics.mean, statistics.max)
    gap = "-" if statistics.longest_gap_s is None else duration_text(statistics.longest_gap_s)
    counts = ["-", "-"] if is_source(names[0]) else [str(statistics.samples), str(statistics.bad_samples)]
    return [
        *names, *counts, *share_cells(summary.shares, summary.unknown),
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
    worst: Dict[str, Tuple[float, ...]] = {}
    for summary in summaries:
        name = summary.config.name
        # One that was not judged is worse than one that was OK.
        worst[name] = max(badness(summary.shares, summary.alerts, bool(summary.missing)), worst.get(name, ()))
    return sorted(summaries, key=lambda summary: worst[summary.config.name], reverse=True)


def sentence(summaries: Sequence[SignalSummary], duration_s: float) -> str:
    """Returns what was judged, for how long, and which signal was worst: the first of the summaries."""
    judged_ones = (summary.config.name for summary in summaries if not summary.missing)
    names = [name for name in dict.fromkeys(judged_ones) if not is_source(name)]
    several = f" ({len(names)} signals)" if len(names) > _MOST_NAMES else ""
    worst = summaries[0]
    what = f"{list_text(names, _MOST_NAMES)}{several}"
    return summary_sentence(what, len(names), "judged", duration_s, worst.config.name, worst.shares)


def _parts(widths: Sequence[int], room: int) -> Iterator[slice]:
    """Yields successive columns that fit into a width, at least one at a time."""
    start = used = 0
    for at, width in enumerate(widths):
        if used and used + width - _GAP > room:
            yield slice(start, at)
            start, used = at, 0
        used += width
    yield slice(start, len(widths))
