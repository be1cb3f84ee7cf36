"""The live table of one robot: a row per signal with its level, the reason with the value, bounds, statistics, trend.

Rows that do not fit are counted. A reason is never cut off: other columns give way, and it continues on further lines.
"""

from __future__ import annotations

from typing import Callable, Iterable, List, NamedTuple, Sequence

from rich.cells import cell_len
from rich.text import Text

from robot_health_monitor.core.formatting import bound_text
from robot_health_monitor.core.model import Status
from robot_health_monitor.core.signal_config import LINK, SignalConfig

from .status_text import level_text, rank, rank_counts, reason_text
from .text_cells import GAP, INDENT, cells_line, wrapped

__all__ = ["TREND_SAMPLES", "SignalRow", "short_bounds", "signal_lines"]

_BARS = "▁▂▃▄▅▆▇█"
TREND_SAMPLES = 16
"""Width of the trend, in samples and in cells."""
_STATISTICS = ("mean", "min", "max")
_WIDEST_NAME = 24
_MIN_REASON = 16
"""Narrowest column for the reason, in cells; in less room it has separate lines."""


class SignalRow(NamedTuple):
    """What is shown of one signal."""

    status: Status
    bounds: str
    """As `short_bounds` returns them."""
    trend: Sequence[float]
    """The latest values, the oldest first; NaN where there was none."""


def short_bounds(config: SignalConfig) -> str:
    """Returns the bounds of a signal: `WARN < 20, ERROR < 10`; comparisons are strict."""
    parts = ((name.partition("_"), bound) for name, bound in config.bounds.items())
    return ", ".join(
        f"{level.upper()} {'<' if side == 'below' else '>'} {bound_text(bound)}" for (level, _, side), bound in parts
    )


def signal_lines(
    rows: Sequence[SignalRow], width: int, room: int, shown: Callable[[str], str], bars: bool = True
) -> List[Text]:
    """Returns the lines of the table.

    Args:
        rows: the signals, in the order of the configuration. A link that is up takes no line.
        width: width of the terminal in cells.
        room: most lines to return; the worst signals come first if not all fit.
        shown: makes a text from outside fit for the terminal.
        bars: draw trends, which need UTF-8.
    """
    rows = [row for row in rows if row.status.name != LINK or rank(row.status) > 0]
    layout = _Layout(rows, width, shown, bars)
    blocks = [layout.row(row) for row in rows]
    order = list(range(len(rows)))
    room = max(2, room) - 1  # the header
    if sum(map(len, blocks)) > room:
        order.sort(key=lambda index: -rank(rows[index].status))
        used, fitting = 1, 0  # the line that counts the others
        for index in order:
            if fitting and used + len(blocks[index]) > room:
                break
            used, fitting = used + len(blocks[index]), fitting + 1
        hidden = rank_counts([rank(rows[index].status) for index in order[fitting:]])
        order = order[:fitting]
    else:
        hidden = ""
    lines = [layout.header(), *(line for index in order for line in blocks[index])]
    if hidden:
        lines.append(Text(f"and {len(rows) - len(order)} more: {hidden}", style="dim"))
        lines[-1].truncate(width, overflow="ellipsis")
    return lines


class _Layout:
    """Which columns fit: reasons first, then bounds, trend, statistics."""

    def __init__(self, rows: Sequence[SignalRow], width: int, shown: Callable[[str], str], bars: bool) -> None:
        self._width = width
        self._shown = shown
        self._name = min(_widest("signal", (shown(row.status.name) for row in rows)), _WIDEST_NAME, max(8, width // 3))
        self._level = _widest("level", (level_text(row.status).plain for row in rows))
        self._reason = width - self._name - self._level - 2 * GAP
        self._beside = self._reason >= _MIN_REASON
        self._bounds = self._trend = 0
        self._statistics: List[int] = []
        if not self._beside:
            self._reason = width - len(INDENT)
            return
        reasons = _widest("value", (shown(reason_text(row.status)) for row in rows))
        spare = self._reason - reasons - GAP
        # A reason that is not OK names the bound: it may take the column of the bounds.
        values = _widest("value", (shown(reason_text(row.status)) for row in rows if rank(row.status) == 0))
        bounds = _widest("", (row.bounds for row in rows))
        both = max(reasons, values + GAP + bounds)
        if bounds and both <= self._reason:
            self._value, self._bounds, spare = values, both - values - GAP, self._reason - both - GAP
        else:
            self._value = min(reasons, self._reason)
        if bars and any(row.trend for row in rows) and spare >= TREND_SAMPLES:
            self._trend, spare = TREND_SAMPLES, spare - TREND_SAMPLES - GAP
            widths = [_widest(name, (row.status.values.get(name, "") for row in rows)) for name in _STATISTICS]
            if spare >= sum(widths) + GAP * (len(widths) - 1):
                self._statistics = widths

    def header(self) -> Text:
        """Returns the line with the names of the columns."""
        cells = [(Text("signal"), self._name), (Text("level"), self._level)]
        if self._beside:
            cells.append((Text("value"), self._value))
            cells += [(Text("bounds"), self._bounds)] if self._bounds else []
            cells += [(Text(name), width) for name, width in zip(_STATISTICS, self._statistics)]
            cells += [(Text("trend"), self._trend)] if self._trend else []
        return cells_line(cells, self._width, style="bold")

    def row(self, row: SignalRow) -> List[Text]:
        """Returns the lines of a signal."""
        reason = self._shown(reason_text(row.status))
        cells = [(Text(self._shown(row.status.name)), self._name), (level_text(row.status), self._level)]
        if not self._beside:
            return [cells_line(cells, self._width), *(Text(INDENT + part) for part in wrapped(reason, self._reason))]
        if rank(row.status) == 0 and self._bounds:
            cells += [(Text(reason), self._value), (Text(row.bounds, style="dim"), self._bounds)]
            parts = [""]
        else:
            width = self._value + (GAP + self._bounds if self._bounds else 0)
            parts = wrapped(reason, width)
            cells.append((Text(parts[0]), width))
        for name, width in zip(_STATISTICS, self._statistics):
            cells.append((Text(self._shown(row.status.values.get(name, "-"))), width))
        if self._trend:
            cells.append((Text(_bars(row.trend)), self._trend))
        indent = " " * (self._name + self._level + 2 * GAP)
        return [cells_line(cells, self._width), *(Text(indent + part) for part in parts[1:])]


def _widest(header: str, texts: Iterable[str]) -> int:
    return max([cell_len(header), *(cell_len(text) for text in texts)])


def _bars(values: Sequence[float]) -> str:
    """Draws values between their own extremes; a blank where there was none."""
    known = [value for value in values if value == value]
    if not known:
        return ""
    low, span = min(known), max(known) - min(known)
    top = len(_BARS) - 1
    return "".join(
        " " if value != value else _BARS[round((value - low) / span * top) if span > 0.0 else top // 2]
        for value in values
    )
