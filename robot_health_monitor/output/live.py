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
from typing import Deque, Dict, List, Optional, Sequence, TextIO, Tuple

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Level, Report, Status, Transition

from .choice import Shown
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
    """Draws monitors on a terminal."""

    def __init__(self, stream: TextIO, name_robots: bool = False) -> None:
        """Takes the terminal; `close` gives it back.

        Args:
            stream: the terminal to draw on.
            name_robots: write the robot's name before each transition, for there may be several.
        """
        self._stream = stream
        self._name_robots = name_robots
        self._console = Console(file=stream, highlight=False, soft_wrap=False)
        self._frame: List[Tuple[str, int]] = []
        """The lines of the table as it stands on the terminal, and their widths in cells."""
        self._trends: Dict[Tuple[str, str], Deque[float]] = {}
        self._started_s = time.monotonic()
        self._drawn_s = float("-inf")
        stream.write(_HIDE_CURSOR)

    def show(self, events: Sequence[Event], shown: Shown) -> None:
        """Writes events above the table, and draws the table anew when it is time to."""
        now_s = time.monotonic()
        due = now_s - self._drawn_s >= _REDRAW_S
        if due:
            self._drawn_s = now_s
            self._note_trends(shown)
        if due or events:
            self.draw(events, shown)

    def draw(self, events: Sequence[Event], shown: Shown) -> None:
        """Writes events above the table and draws the table, fitted to the size that the terminal has now."""
        width, height = self._size()
        self._console.size = (width, height)
        reports = [monitor.report(shown.now_s) for monitor in shown.monitors]
        with self._console.capture() as lines:
            for event in events:
                self._console.print(_event_text(event, self._name_robots))
        with self._console.capture() as frame:
            self._console.print(self._title(reports, shown.system_health, width), no_wrap=True, overflow="ellipsis")
            self._console.print(self._table(reports, width, height))
        to_top = self._to_top(width)
        self._frame = [(line, cell_len(_STYLING.sub("", line))) for line in frame.get().rstrip().split("\n")]
        first, rest = (lines.get() + "\n".join(line for line, _ in self._frame)).split("\n", 1)
        # The first line is cleared by itself: tmux takes a clear from the top of the screen on for the end of a screen
        # worth keeping, and puts a copy of it into its history.
        self._stream.write(f"{to_top}{_CLEAR_LINE}{first}\n{_CLEAR_BELOW}{rest}")
        self._stream.flush()

    def attach(self, loop: asyncio.AbstractEventLoop, shown: Shown) -> None:
        """Redraws when the window changes its size, and gives the terminal back while Ctrl-Z stops the process."""
        loop.add_signal_handler(signal.SIGWINCH, lambda: self.draw((), shown))
        loop.add_signal_handler(signal.SIGTSTP, lambda: self._stop_process(shown))

    def close(self) -> None:
        """Gives the terminal back, with the last table left on it."""
        self._stream.write(f"\n{_SHOW_CURSOR}")
        self._stream.flush()

    def _stop_process(self, shown: Shown) -> None:
        self.close()
        os.kill(os.getpid(), signal.SIGSTOP)
        # Here the process goes on, perhaps a day later, and draws below whatever others wrote.
        self._frame = []
        self._stream.write(_HIDE_CURSOR)
        self.draw((), shown)

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

    def _note_trends(self, shown: Shown) -> None:
        for monitor in shown.monitors:
            for name in monitor.config.signals:
                value = monitor.fresh_value(name)
                trend = self._trends.setdefault((monitor.robot, name), deque(maxlen=_TREND_SAMPLES))
                trend.append(float("nan") if value is None else value)

    def _title(self, reports: Sequence[Report], health: Optional[float], width: int) -> Text:
        overall = Level.worst(report.overall for report in reports)
        if len(reports) == 1:
            title = Text(reports[0].robot, style="bold")
            title.append(" is ", style="not bold")
        else:
            title = Text(f"{len(reports)} robots", style="bold")
            title.append(", the worst is ", style="not bold")
        title.append(overall.name, style=_STYLE_OF_LEVEL[overall])
        if health is not None and width >= 60:
            title.append(f"   system_health {health:.1f}", style="not bold")
        minutes, seconds = divmod(int(time.monotonic() - self._started_s), 60)
        title.append(f"   {minutes // 60}:{minutes % 60:02}:{seconds:02}", style="not bold dim")
        if width >= 60:
            title.append("   Ctrl-C ends", style="not bold dim")
        return title

    def _table(self, reports: Sequence[Report], width: int, height: int) -> Table:
        wide, widest = width >= 76, width >= 110
        table = Table(box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="bold")
        if len(reports) > 1:
            table.add_column("robot", no_wrap=True, overflow="ellipsis", max_width=16)
        table.add_column("signal", no_wrap=True, overflow="ellipsis", max_width=max(8, width - 22) if not wide else 24)
        table.add_column("value", no_wrap=True, justify="right", min_width=10)
        table.add_column("level", no_wrap=True, min_width=5)
        if wide:
            for statistic in ("mean", "min", "max"):
                table.add_column(statistic, no_wrap=True, justify="right", min_width=5)
            table.add_column("trend", no_wrap=True, min_width=_TREND_SAMPLES)
        if widest:
            table.add_column("message", no_wrap=True, overflow="ellipsis")
        statuses = [(report.robot, status) for report in reports for status in report.statuses.values()]
        room = max(1, height - 4)
        hidden = len(statuses) - room
        if hidden > 0:  # those that matter most
            statuses = sorted(statuses, key=lambda item: -item[1].level.severity)[:room]
        for robot, status in statuses:
            name = [Text(robot)] if len(reports) > 1 else []
            table.add_row(*name, *self._row(robot, status, wide, widest))
        if hidden > 0:
            table.add_row(Text(f"and {hidden} more", style="dim"))
        return table

    def _row(self, robot: str, status: Status, wide: bool, widest: bool) -> List[Text]:
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
            row.append(Text(self._trend(robot, status.name), style=style))
        if widest:
            row.append(Text(status.message))
        return row

    def _trend(self, robot: str, name: str) -> str:
        """Draws the last values of a signal between their own extremes; a blank where there was none."""
        values = self._trends.get((robot, name), ())
        known = [value for value in values if value == value]
        if not known or not self._console.encoding.lower().startswith("utf"):
            return ""
        low, span = min(known), max(known) - min(known)
        top = len(_BARS) - 1
        return "".join(
            " " if value != value else _BARS[round((value - low) / span * top) if span > 0.0 else top // 2]
            for value in values
        )


def _event_text(event: Event, name_robots: bool) -> Text:
    if isinstance(event, Transition):
        style = _STYLE_OF_LEVEL[event.to_level]
    else:
        style = _STYLE_OF_SEVERITY.get(event.severity, "dim")
    return Text(plain_line(event, "%H:%M:%S", name_robots=name_robots), style=style)
