"""A history file with thirty days of samples, as a monitor would have written it: for benchmarks and pictures."""

from __future__ import annotations

import math
import sqlite3
from pathlib import Path
from typing import Iterable, Iterator, List, Tuple

from robot_health_monitor.core import Level
from robot_health_monitor.core.judge.sample_summary import PERIOD_S
from robot_health_monitor.ops.configuration import HistorySettings
from robot_health_monitor.ops.store.history import History
from robot_health_monitor.ops.store.samples import CELL_S, FINE_S, MERGED_S

DAYS = 30.0
_CELLS = 96
_WARN_BELOW = 20.0
_SWING_S = 9000.0
_INSERT = "INSERT INTO samples VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
_INSERT_LEVEL = "INSERT OR REPLACE INTO robot_levels VALUES (?, ?, ?, ?)"


def write_past(file: Path, robots: Iterable[str], signal: str, end_s: float) -> int:
    """Writes the samples of a signal of each robot and the levels of its last 24 hours; returns the number of rows.

    Args:
        file: a history, new or without samples.
        robots: their names.
        signal: its name; its values swing around 55, between 15 and 95.
        end_s: end of the past, in s since 1970.
    """
    periods = list(_periods(end_s))
    history = History(HistorySettings(str(file), keep_mb=1e4))
    count = 0
    for number, robot in enumerate(robots):

        def write(connection: sqlite3.Connection, robot: str = robot, number: int = number) -> None:
            connection.executemany(_INSERT, ((robot, signal, *period) for period in periods))
            connection.executemany(_INSERT_LEVEL, ((robot, *cell) for cell in _cells(end_s, number)))

        history.run(write, 60.0)
        count += len(periods)
    history.close()
    return count


def _periods(end_s: float) -> Iterator[Tuple[object, ...]]:
    start_s = (end_s - DAYS * 86_400.0) // MERGED_S * MERGED_S
    fine_s = (end_s - FINE_S) // MERGED_S * MERGED_S
    while start_s < end_s:
        seconds = MERGED_S if start_s < fine_s else PERIOD_S
        value = 55.0 + 39.0 * math.sin(start_s / _SWING_S)
        level = Level.WARN if value - 1.0 < _WARN_BELOW else Level.OK
        yield (start_s, seconds, value - 1.0, value + 1.0, value, value, int(seconds), 0, int(level))
        start_s += seconds


def _cells(end_s: float, robot: int) -> List[Tuple[float, int, int]]:
    """Levels that change every 1 h 45 min; some robots were not watched all the time."""
    turns = (Level.OK, Level.OK, Level.WARN, None, Level.OK, Level.ERROR, Level.OK, Level.STALE)
    newest_s = end_s // CELL_S * CELL_S
    levels = [(newest_s - CELL_S * back, turns[(back // 7 + robot) % len(turns)]) for back in range(_CELLS)]
    return [(start_s, int(level), level.severity) for start_s, level in levels if level is not None]
