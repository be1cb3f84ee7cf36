"""`robot-health history --alert ID`: one alert, with its notes and a plot of its samples."""

from __future__ import annotations

import argparse
import math
import shutil
import sqlite3
from typing import Dict, List, Optional, Sequence, TextIO, Tuple

from ...core.values.errors import ConfigError
from ...core.values.formatting import count_text, duration_text, number_text, printable
from ...core.values.model import Level
from ...ops.store import queries
from ...ops.store.notes import notes_of
from ...ops.store.rows import StoredTransition
from ...runtime.times import local_time
from ..output.lines import is_coloured
from .history_entries import Listing, NotedAlert, entry_json, entry_lines
from .history_file import iso_time

_PLOT_COLUMNS = 100
_LEAST_PLOT_COLUMNS = 10
_PLOT_ROWS = 12


def alert_listing(connection: sqlite3.Connection, arguments: argparse.Namespace, stream: TextIO) -> Listing:
    """Returns one alert; raises ConfigError if there is none."""
    transition = queries.transition(connection, arguments.alert)
    if transition is None:
        raise ConfigError(f"there is no transition {arguments.alert} in this history")
    alert = NotedAlert(transition, notes_of(connection, transition.id))
    samples = queries.evidence(connection, transition.id)
    times = [(iso_time(time_s), value) for time_s, value in samples]
    evidence = [(time, value if math.isfinite(value) else None) for time, value in times]
    line, *notes = entry_lines(alert, is_coloured(stream))
    lines = [line, *(f"  {name}: {printable(value)}" for name, value in _details(transition, samples))]
    lines += [f"  {each}" for each in notes]
    if samples:
        width = min(shutil.get_terminal_size().columns, _PLOT_COLUMNS)
        bound = transition.bound if transition.statistic in ("last", "mean", "min", "max", "forecast") else None
        lines += text_plot(samples, bound, width)
    head = ("time", "value")
    return Listing([entry_json(alert, evidence=evidence)], head, [dict(zip(head, each)) for each in times], lines)


def _details(transition: StoredTransition, samples: Sequence[object]) -> List[Tuple[str, str]]:
    statistics = ", ".join(
        f"{name} {'undefined' if value is None else number_text(value)}"
        for name, value in transition.statistics.items()
    )
    bound = "none" if transition.bound is None else f"{number_text(transition.bound)} (on {transition.statistic})"
    count = f"{count_text(len(samples), 'sample')} stored"
    lasted_s = transition.now_s - transition.since_s
    never_known = transition.from_level is Level.OK and lasted_s <= 0.0
    level = "unknown" if never_known else f"{transition.from_level.name} for {duration_text(lasted_s)}"
    return [("level before", level), ("bound", bound), ("window", f"{count}; {statistics}" if statistics else count)]


def text_plot(samples: Sequence[Tuple[float, float]], bound: Optional[float], width: int) -> List[str]:
    """Returns a plot: `*` for samples, `-` for the bound, `x` below the axis for values that are no numbers.

    Every column shows the range of its samples (wall time in s since 1970, and value), so that no extreme is lost.
    Lines have at most `width` characters.
    """
    values = [value for _, value in samples if math.isfinite(value)]
    if not values:
        return ["no samples that are numbers"]
    shown = values if bound is None else [*values, bound]
    low, high = min(shown), max(shown)
    bound_row = None if bound is None else _plot_row(bound, low, high)
    labels = {0: number_text(high), _PLOT_ROWS - 1: number_text(low)}
    if bound is not None and bound_row is not None:
        labels[bound_row] = number_text(bound)
    margin = max(map(len, labels.values()))
    columns = max(_LEAST_PLOT_COLUMNS, width - margin - 2)
    grid = [["-" if row == bound_row else " "] * columns for row in range(_PLOT_ROWS)]
    bad = [" "] * columns
    first_s, last_s = samples[0][0], samples[-1][0]
    span_s = last_s - first_s
    found: Dict[int, List[float]] = {}
    for time_s, value in samples:
        share = (time_s - first_s) / span_s if span_s > 0.0 else 0.0
        found.setdefault(round(min(max(share, 0.0), 1.0) * (columns - 1)), []).append(value)
    for column, of_column in found.items():
        numbers = [value for value in of_column if math.isfinite(value)]
        if len(numbers) < len(of_column):
            bad[column] = "x"
        if numbers:
            for row in range(_plot_row(max(numbers), low, high), _plot_row(min(numbers), low, high) + 1):
                grid[row][column] = "*"
    lines = [f"{labels.get(row, ''):>{margin}} |{''.join(cells)}".rstrip() for row, cells in enumerate(grid)]
    axis = " " * margin + " +"
    lines.append(axis + "".join("-" if mark == " " else mark for mark in bad))
    begin, end = local_time(first_s, "%H:%M:%S"), local_time(last_s, "%H:%M:%S")
    has_room = columns > len(begin) + len(end)
    lines.append(" " * len(axis) + begin + (end.rjust(columns - len(begin)) if has_room else ""))
    return lines


def _plot_row(value: float, low: float, high: float) -> int:
    """Returns the row of a value, 0 at the top. It halves before it subtracts: the range may exceed a float's."""
    if high <= low:
        return _PLOT_ROWS // 2
    share = (value / 2.0 - low / 2.0) / (high / 2.0 - low / 2.0)
    return _PLOT_ROWS - 1 - round(share * (_PLOT_ROWS - 1))
