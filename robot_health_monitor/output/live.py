"""The live view of a terminal: a table that stays at the bottom while events scroll by above it.

rich lays out and colours. The cursor is moved here, because rich's own Live leaves fragments behind when a window
becomes narrower.
"""

from __future__ import annotations

import asyncio
import os
import re
import signal
import time
from collections import deque
from typing import Deque, Dict, List, Mapping, NamedTuple, Optional, Sequence, TextIO, Tuple, Union

from rich.cells import cell_len
from rich.console import Console
from rich.table import Table
from rich.text import Text

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Level, Status, Transition

from .display import Shown
from .events import Entry
from .fleet_table import FleetState, fleet_lines, fleet_state, fleet_summary
from .plain import dropped_line, plain_line
from .status_text import STYLE_OF_LEVEL, level_text, rank, style, value_text
from .stream_writer import StreamWriter

_STYLE_OF_SEVERITY = {Severity.WARN: "yellow", Severity.ERROR: "red", Severity.FATAL: "bold red"}
_STYLING = re.compile("\x1b\\[[0-9;]*m")
_BARS = "▁▂▃▄▅▆▇█"
_TREND_SAMPLES = 16
_STATISTICS = ("mean", "min", "max")
_GAP = 2
"""Blanks between columns."""
_WIDEST_NAME = 24
_MIN_MESSAGE = 16
"""Narrowest message column worth showing, in cells."""
_REDRAW_S = 0.9
"""Slightly less than the period of the values."""
_SUSPEND_S = 0.5
"""Time to restore the terminal before Ctrl-Z stops the process."""

_HIDE_CURSOR = "\x1b[?25l"
_SHOW_CURSOR = "\x1b[?25h"
_CLEAR_LINE = "\x1b[2K"
_CLEAR_BELOW = "\x1b[J"


class _State(NamedTuple):
    """What the table of one robot shows."""

    robot: str
    statuses: Sequence[Status]
    system_health: Optional[float]
    trends: Mapping[str, Sequence[float]]
    """The latest values by signal."""


class LiveView:
    """Draws monitors on a terminal.

    The state is read in the loop's thread; layout and writing happen in the writer's.
    """

    def __init__(self, stream: TextIO, name_robots: bool = False) -> None:
        """Prepares the view; `start` begins drawing.

        Args:
            stream: the terminal to draw on.
            name_robots: put the robot's name before each transition.
        """
        self._stream = stream
        self._name_robots = name_robots
        self._console = Console(file=stream, highlight=False, soft_wrap=False)
        self._writer = StreamWriter(stream, self._render, first=_HIDE_CURSOR, last=f"\n{_SHOW_CURSOR}")
        self._frame: List[Tuple[str, int]] = []
        """The lines of the table as it stands on the terminal, and their widths in cells."""
        self._state: Union[_State, FleetState, None] = None
        self._trends: Dict[str, Deque[float]] = {}
        self._started_s = time.monotonic()
        self._drawn_s = float("-inf")
        self._has_news = False
        self._suspending = False
        self._cursor_hidden = True

    @property
    def reader_is_gone(self) -> bool:
        """Whether the terminal was closed."""
        return self._writer.reader_is_gone

    @property
    def problem(self) -> str:
        """Why the terminal is not written at present; empty: it is."""
        return self._writer.problem

    def start(self, loop: asyncio.AbstractEventLoop, shown: Shown) -> None:
        """Begins drawing; redraws when the window is resized, restores the terminal while Ctrl-Z stops the process."""
        loop.add_signal_handler(signal.SIGWINCH, self._writer.wake)
        loop.add_signal_handler(signal.SIGTSTP, self._stop_process)
        self._writer.start()

    def add(self, entry: Entry) -> None:
        """Writes an event above the table; never blocks."""
        self._has_news = True
        self._writer.put(entry)

    def show(self, shown: Shown) -> None:
        """Redraws the table once a second, and at once after an event."""
        now_s = time.monotonic()
        due = now_s - self._drawn_s >= _REDRAW_S
        if due:
            self._drawn_s = now_s
        if due or self._has_news:
            self._has_news = False
            if len(shown.robots) == 1:
                self._state = self._state_of_one(shown, due)
            else:
                self._state = fleet_state(shown, self._size()[1])
            self._writer.wake()

    def close(self) -> None:
        """Restores the terminal, with the last table left on it."""
        self._writer.close()

    def _stop_process(self) -> None:
        self._suspending = True
        self._writer.wake()
        self._writer.drain(_SUSPEND_S)
        os.kill(os.getpid(), signal.SIGSTOP)
        # Continued, perhaps a day later: the table is drawn below what others have written meanwhile.
        self._suspending = False
        self._writer.wake()

    def _state_of_one(self, shown: Shown, due: bool) -> _State:
        """Returns the state of the only robot; notes its values if that is `due`."""
        (robot,) = shown.robots
        system = robot.alert_system
        if due:
            trends = {}
            for name in system.monitor.config.signals:
                value = system.monitor.fresh_value(name)
                trend = self._trends.get(name, deque(maxlen=_TREND_SAMPLES))
                trend.append(float("nan") if value is None else value)
                trends[name] = trend
            self._trends = trends
        report = system.monitor.report(robot.now_s)
        statuses = [system.status(name) or status for name, status in report.statuses.items()]
        return _State(report.robot, statuses, shown.system_health, {name: tuple(v) for name, v in self._trends.items()})

    # In the writer's thread

    def _render(self, entries: Sequence[Entry], dropped: int) -> str:
        """Returns what writes events above the table and draws the table, fitted to the terminal's present size."""
        suspending = self._suspending
        width, height = self._size()
        self._console.size = (width, height)
        with self._console.capture() as lines:
            if dropped:
                self._console.print(Text(dropped_line(dropped), style="bold red"))
            for entry in entries:
                self._console.print(_entry_text(entry, self._name_robots))
        to_top = self._to_top(width)
        self._frame = self._table_lines(width, height)
        first, _, rest = (lines.get() + "\n".join(line for line, _ in self._frame)).partition("\n")
        cursor = "" if self._cursor_hidden else _HIDE_CURSOR
        self._cursor_hidden = True
        # The first line is cleared by itself: a clear from the top of the screen on makes tmux copy the screen into
        # its history.
        text = f"{cursor}{to_top}{_CLEAR_LINE}{first}\n{_CLEAR_BELOW}{rest}"
        if suspending:
            text += f"\n{_SHOW_CURSOR}"
            self._frame = []
            self._cursor_hidden = False
        return text

    def _table_lines(self, width: int, height: int) -> List[Tuple[str, int]]:
        """Returns the lines of the table with their widths in cells."""
        state = self._state
        if state is None:
            return []
        with self._console.capture() as table:
            self._console.print(self._title(state, width), no_wrap=True, overflow="ellipsis")
            if isinstance(state, FleetState):
                for line in fleet_lines(state, width, max(2, height - 3)):
                    self._console.print(line, no_wrap=True, overflow="ellipsis")
            else:
                self._print_table(state, width, height)
        return [(line, cell_len(_STYLING.sub("", line))) for line in table.get().rstrip().split("\n")]

    def _size(self) -> Tuple[int, int]:
        try:
            size = os.get_terminal_size(self._stream.fileno())
        except OSError:
            return 80, 24
        return max(size.columns, 20) if size.columns else 80, size.lines or 24

    def _to_top(self, width: int) -> str:
        """Returns what moves the cursor to the top of the last table, which wraps when a window becomes narrower."""
        rows = sum(max(1, -(-cells // width)) for _, cells in self._frame)
        return "\r" + (f"\x1b[{rows - 1}A" if rows > 1 else "")

    def _title(self, state: Union[_State, FleetState], width: int) -> Text:
        if isinstance(state, FleetState):
            title = fleet_summary(state)
        else:
            title = Text(printable(state.robot), style="bold")
            title.append(" is ", style="not bold")
            worst = max(state.statuses, key=rank, default=None)
            title.append(level_text(worst) if worst else Text("OK", style=STYLE_OF_LEVEL[Level.OK]))
            if state.system_health is not None and width >= 60:
                title.append(f"   system_health {state.system_health:.1f}", style="not bold")
        minutes, seconds = divmod(int(time.monotonic() - self._started_s), 60)
        title.append(f"   {minutes // 60}:{minutes % 60:02}:{seconds:02}", style="not bold dim")
        if width >= 60:
            title.append("   Ctrl-C ends", style="not bold dim")
        return title

    def _print_table(self, state: _State, width: int, height: int) -> None:
        statuses = state.statuses
        room = max(1, height - 4)
        hidden = len(statuses) - room
        if hidden > 0:  # the worst ones
            statuses = sorted(statuses, key=lambda status: -rank(status))[:room]
        layout = _Layout(statuses, width)
        table = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")
        table.add_column("signal", no_wrap=True, overflow="ellipsis", max_width=layout.name)
        table.add_column("value", no_wrap=True, overflow="ellipsis", justify="right", min_width=10)
        table.add_column("level", no_wrap=True, min_width=5)
        if layout.statistics:
            for statistic in _STATISTICS:
                table.add_column(statistic, no_wrap=True, justify="right", min_width=5)
            table.add_column("trend", no_wrap=True, min_width=_TREND_SAMPLES)
        if layout.message:
            table.add_column("message", no_wrap=True, overflow="ellipsis", max_width=layout.message)
        for status in statuses:
            row = [Text(printable(status.name)), Text(value_text(status)), level_text(status)]
            if layout.statistics:
                row += [Text(printable(status.values.get(statistic, "-"))) for statistic in _STATISTICS]
                row.append(Text(self._trend(state.trends.get(status.name, ())), style=style(status)))
            if layout.message:
                row.append(Text(printable(status.message)))
            table.add_row(*row)
        self._console.print(table)
        if hidden > 0:
            self._console.print(Text(f"and {hidden} more", style="dim"))

    def _trend(self, values: Sequence[float]) -> str:
        """Draws values between their own extremes; a blank where there was none."""
        known = [value for value in values if value == value]
        if not known or not self._console.encoding.lower().startswith("utf"):
            return ""
        low, span = min(known), max(known) - min(known)
        top = len(_BARS) - 1
        return "".join(
            " " if value != value else _BARS[round((value - low) / span * top) if span > 0.0 else top // 2]
            for value in values
        )


class _Layout:
    """Which columns fit. Reasons come first: statistics give way to the message of a signal that is not OK."""

    def __init__(self, statuses: Sequence[Status], width: int) -> None:
        """Fits columns for `statuses` into `width` cells."""
        longest = max((cell_len(status.name) for status in statuses), default=6)
        self.name = min(max(longest, 6), _WIDEST_NAME, max(8, width - 22))
        """Width of the names."""
        value = max([10, *(cell_len(value_text(status)) for status in statuses)])
        level = max([5, *(cell_len(level_text(status).plain) for status in statuses)])
        room = width - self.name - value - level - 2 * _GAP
        cells = [max([5, *(cell_len(status.values.get(name, "")) for status in statuses)]) for name in _STATISTICS]
        statistics = sum(cells) + _TREND_SAMPLES + 4 * _GAP
        reasons = [cell_len(status.message) for status in statuses if status.level is not Level.OK]
        self.statistics = room >= statistics + (max(reasons) + _GAP if reasons else 0)
        """Whether to show statistics and trend."""
        room -= (statistics if self.statistics else 0) + _GAP
        self.message = room if room >= _MIN_MESSAGE else 0
        """Width of the message; 0: not shown."""


def _entry_text(entry: Entry, name_robots: bool) -> Text:
    event = entry.event
    if isinstance(event, Transition):
        style = STYLE_OF_LEVEL[event.to_level]
    else:
        style = _STYLE_OF_SEVERITY.get(event.severity, "dim")
    return Text(plain_line(entry, "%H:%M:%S", name_robots=name_robots), style=style)
