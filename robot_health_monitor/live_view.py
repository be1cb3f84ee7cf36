"""The live view of a terminal: a table that stays at the bottom, alert lines that scroll by above it.

rich lays out and colours; the cursor is moved here, because rich's own Live leaves fragments behind when a window
becomes narrower.
"""

from __future__ import annotations

import asyncio
import os
import re
import signal
import time
from collections import deque
from typing import Deque, Dict, List, Sequence, TextIO, Tuple

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from .core.middleware import Severity
from .core.model import Level, Report, Status, Transition
from .embedded import EmbeddedMonitor
from .lines import Event, plain_line

_STYLE_OF_LEVEL = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "magenta"}
_STYLE_OF_SEVERITY = {Severity.WARN: "yellow", Severity.ERROR: "red", Severity.FATAL: "bold red"}
_STYLING = re.compile("\x1b\\[[0-9;]*m")
_BARS = "▁▂▃▄▅▆▇█"
_TREND_SAMPLES = 16
_REDRAW_S = 0.9
"""A little less than the second after which there is something new to show."""

_HIDE_CURSOR = "\x1b[?25l"
_SHOW_CURSOR = "\x1b[?25h"
_CLEAR_LINE = "\x1b[2K"
_CLEAR_BELOW = "\x1b[J"


class LiveView:
    """Draws an embedded monitor on a terminal."""

    def __init__(self, stream: TextIO) -> None:
        """Takes the terminal; `close` gives it back.

        Args:
            stream: the terminal to draw on.
        """
        self._stream = stream
        self._console = Console(file=stream, highlight=False, soft_wrap=False)
        self._frame: List[Tuple[str, int]] = []
        """The lines of the table as it stands on the terminal, and their widths in cells."""
        self._trends: Dict[str, Deque[float]] = {}
        self._started_s = time.monotonic()
        self._drawn_s = float("-inf")
        stream.write(_HIDE_CURSOR)

    def show(self, events: Sequence[Event], monitor: EmbeddedMonitor) -> None:
        """Writes events above the table, and draws the table anew when it is time to."""
        now_s = time.monotonic()
        due = now_s - self._drawn_s >= _REDRAW_S
        if due:
            self._drawn_s = now_s
            self._note_trends(monitor)
        if due or events:
            self.draw(events, monitor)

    def draw(self, events: Sequence[Event], monitor: EmbeddedMonitor) -> None:
        """Writes events above the table and draws the table, fitted to the size that the terminal has now."""
        width, height = self._size()
        self._console.size = (width, height)
        report = monitor.alert_system.monitor.report(monitor.bus.now_s)
        with self._console.capture() as lines:
            for event in events:
                self._console.print(_event_text(event))
        with self._console.capture() as frame:
            self._console.print(self._title(report, monitor, width), no_wrap=True, overflow="ellipsis")
            self._console.print(self._table(report, width, height))
        to_top = self._to_top(width)
        self._frame = [(line, cell_len(_STYLING.sub("", line))) for line in frame.get().rstrip().split("\n")]
        first, rest = (lines.get() + "\n".join(line for line, _ in self._frame)).split("\n", 1)
        # The first line is cleared by itself: tmux takes a clear from the top of the screen on for the end of a screen
        # worth keeping, and puts a copy of it into its history.
        self._stream.write(f"{to_top}{_CLEAR_LINE}{first}\n{_CLEAR_BELOW}{rest}")
        self._stream.flush()

    def attach(self, loop: asyncio.AbstractEventLoop, monitor: EmbeddedMonitor) -> None:
        """Redraws when the window changes its size, and gives the terminal back while Ctrl-Z stops the process."""
        loop.add_signal_handler(signal.SIGWINCH, lambda: self.draw((), monitor))
        loop.add_signal_handler(signal.SIGTSTP, lambda: self._stop_process(monitor))

    def close(self) -> None:
        """Gives the terminal back, with the last table left on it."""
        self._stream.write(f"\n{_SHOW_CURSOR}")
        self._stream.flush()

    def _stop_process(self, monitor: EmbeddedMonitor) -> None:
        self.close()
        os.kill(os.getpid(), signal.SIGSTOP)
        # Here the process goes on, perhaps a day later, and draws below whatever others wrote.
        self._frame = []
        self._stream.write(_HIDE_CURSOR)
        self.draw((), monitor)

    def _size(self) -> Tuple[int, int]:
        try:
            size = os.get_terminal_size(self._stream.fileno())
        except OSError:
            return 80, 24
        return max(size.columns, 20) if size.columns else 80, size.lines or 24

    def _to_top(self, width: int) -> str:
        """Returns what brings the cursor to the top of the last table, which wraps when a window becomes narrower."""
        rows = sum(max(1, -(-cells // width)) for _, cells in self._frame)
        return "\r" + (f"\x1b[{rows - 1}A" if rows > 1 else "")

    def _note_trends(self, monitor: EmbeddedMonitor) -> None:
        judge = monitor.alert_system.monitor
        for name in judge.config.signals:
            value = judge.fresh_value(name)
            trend = self._trends.setdefault(name, deque(maxlen=_TREND_SAMPLES))
            trend.append(float("nan") if value is None else value)

    def _title(self, report: Report, monitor: EmbeddedMonitor, width: int) -> Text:
        title = Text(report.robot, style="bold")
        title.append(" is ", style="not bold")
        title.append(report.overall.name, style=_STYLE_OF_LEVEL[report.overall])
        health = monitor.system_health
        if health is not None and width >= 60:
            title.append(f"   system_health {health:.1f}", style="not bold")
        minutes, seconds = divmod(int(time.monotonic() - self._started_s), 60)
        title.append(f"   {minutes // 60}:{minutes % 60:02}:{seconds:02}", style="not bold dim")
        if width >= 60:
            title.append("   Ctrl-C ends", style="not bold dim")
        return title

    def _table(self, report: Report, width: int, height: int) -> Table:
        wide, widest = width >= 76, width >= 110
        table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="bold")
        table.add_column("signal", no_wrap=True, overflow="ellipsis", max_width=max(8, width - 22) if not wide else 24)
        table.add_column("value", no_wrap=True, justify="right", min_width=10)
        table.add_column("level", no_wrap=True, min_width=5)
        if wide:
            for statistic in ("mean", "min", "max"):
                table.add_column(statistic, no_wrap=True, justify="right", min_width=5)
            table.add_column("trend", no_wrap=True, min_width=_TREND_SAMPLES)
        if widest:
            table.add_column("message", no_wrap=True, overflow="ellipsis")
        statuses = list(report.statuses.values())
        room = max(1, height - 4)
        hidden = len(statuses) - room
        if hidden > 0:  # those that matter most
            statuses = sorted(statuses, key=lambda status: -status.level.severity)[:room]
        for status in statuses:
            table.add_row(*self._row(status, wide, widest))
        if hidden > 0:
            table.add_row(Text(f"and {hidden} more", style="dim"))
        return table

    def _row(self, status: Status, wide: bool, widest: bool) -> List[Text]:
        style = _STYLE_OF_LEVEL[status.level]
        values = status.values
        value = values["value"] or "-"
        row = [
            Text(status.name),
            Text(f"{value} {values['unit']}".strip()),
            Text(status.level.name, style=style),
        ]
        if wide:
            row += [Text(values.get(statistic, "-")) for statistic in ("mean", "min", "max")]
            row.append(Text(self._trend(status.name), style=style))
        if widest:
            row.append(Text(status.message))
        return row

    def _trend(self, name: str) -> str:
        """Draws the last values of a signal between their own extremes; a blank where there was none."""
        values = self._trends.get(name, ())
        known = [value for value in values if value == value]
        if not known or not self._console.encoding.lower().startswith("utf"):
            return ""
        low, span = min(known), max(known) - min(known)
        top = len(_BARS) - 1
        return "".join(
            " " if value != value else _BARS[round((value - low) / span * top) if span > 0.0 else top // 2]
            for value in values
        )


def _event_text(event: Event) -> Text:
    if isinstance(event, Transition):
        style = _STYLE_OF_LEVEL[event.to_level]
    else:
        style = _STYLE_OF_SEVERITY.get(event.severity, "dim")
    return Text(plain_line(event, "%H:%M:%S"), style=style)
