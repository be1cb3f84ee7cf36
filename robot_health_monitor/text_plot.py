"""A plot of samples as lines of text, for any terminal."""

from __future__ import annotations

import math
from typing import Dict, List, Optional, Sequence, Tuple

from robot_health_monitor.core.formatting import number_text
from robot_health_monitor.runtime.times import local_time

_ROWS = 12
_LEAST_COLUMNS = 10


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
    bound_row = None if bound is None else _row(bound, low, high)
    labels = {0: number_text(high), _ROWS - 1: number_text(low)}
    if bound is not None and bound_row is not None:
        labels[bound_row] = number_text(bound)
    margin = max(map(len, labels.values()))
    columns = max(_LEAST_COLUMNS, width - margin - 2)
    grid = [["-" if row == bound_row else " "] * columns for row in range(_ROWS)]
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
            for row in range(_row(max(numbers), low, high), _row(min(numbers), low, high) + 1):
                grid[row][column] = "*"
    lines = [f"{labels.get(row, ''):>{margin}} |{''.join(cells)}".rstrip() for row, cells in enumerate(grid)]
    axis = " " * margin + " +"
    lines.append(axis + "".join("-" if mark == " " else mark for mark in bad))
    begin, end = local_time(first_s, "%H:%M:%S"), local_time(last_s, "%H:%M:%S")
    has_room = columns > len(begin) + len(end)
    lines.append(" " * len(axis) + begin + (end.rjust(columns - len(begin)) if has_room else ""))
    return lines


def _row(value: float, low: float, high: float) -> int:
    """Returns the row of a value, 0 at the top; halves and divides first, because the range may exceed a float's."""
    if high <= low:
        return _ROWS // 2
    share = (value / 2.0 - low / 2.0) / (high / 2.0 - low / 2.0)
    return _ROWS - 1 - round(share * (_ROWS - 1))
