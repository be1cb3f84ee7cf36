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
from typing import List, Optional, Sequence, TextIO, Tuple

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from ...core.port.middleware import Severity
from ...core.values.formatting import printable, with_degree_sign
from ...core.values.model import Level, Transition
from .events import Entry
from .lines import Monitors, Output, dropped_line, plain_line
from .tables import STYLE_OF_LEVEL, View, draw, fleet_view, robot_view

_STYLE_OF_SEVERITY = {Severity.WARN: STYLE_OF_LEVEL[Level.WARN], Severity.ERROR: "red", Severity.FATAL: "bold red"}
_STYLING = re.compile("\x1b\\[[0-9;]*m")
_REDRAW_S = 0.9
"""Slightly less than the period of the values."""
_SUSPEND_S = 0.5
"""Time to restore the terminal before Ctrl-Z stops the process."""

_HIDE_CURSOR = "\x1b[?25l"
_SHOW_CURSOR = "\x1b[?25h"
_CLEAR_LINE = "\x1b[2K"
_CLEAR_BELOW = "\x1b[J"


class LiveView(Output):
    """Draws monitors on a terminal.

    The state is read in the loop's thread; layout and writing happen in the writer's.
    """

    def __init__(self, stream: TextIO, name_robots: bool = False) -> None:
        """Prepares the view; `name_robots` puts the robot's name before each transition."""
        super().__init__(stream, self._draw, first=_HIDE_CURSOR, last=f"\n{_SHOW_CURSOR}")
        self._name_robots = name_robots
        self._console = Console(file=stream, highlight=False, soft_wrap=False)
        self._utf8 = self._console.encoding.lower().startswith("utf")
        self._frame: List[Tuple[str, int]] = []
        """The lines of the table as it stands on the terminal, and their widths in cells."""
        self._view: Optional[View] = None
        self._started_s = time.monotonic()
        self._drawn_s = float("-inf")
        self._has_news = False
        self._suspending = False
        self._cursor_hidden = True

    def start(self) -> None:
        """Begins drawing; redraws when the window is resized, restores the terminal while Ctrl-Z stops the process."""
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGWINCH, self.wake)
        loop.add_signal_handler(signal.SIGTSTP, self._stop_process)
        super().start()

    def put(self, item: Entry) -> None:
        """Writes an event above the table; never blocks."""
        self._has_news = True
        super().put(item)

    def show(self, shown: Monitors) -> None:
        """Redraws the table once a second, and at once after an event."""
        now_s = time.monotonic()
        due = now_s - self._drawn_s >= _REDRAW_S
        if due:
            self._drawn_s = now_s
        if due or self._has_news:
            self._has_news = False
            if len(shown.robots) == 1:
                self._view = self._view_of_one(shown)
            else:
                self._view = fleet_view(shown, self._size()[1], self._shown)
            self.wake()

    def _stop_process(self) -> None:
        self._suspending = True
        self.wake()
        self.drain(_SUSPEND_S)
        os.kill(os.getpid(), signal.SIGSTOP)
        # Continued, perhaps a day later: the table is drawn below what others have written meanwhile.
        self._suspending = False
        self.wake()

    def _view_of_one(self, shown: Monitors) -> View:
        """Returns what is shown of the only robot."""
        (robot,) = shown.robots
        system = robot.alert_system
        known = (system.announcements.status(name) for name in system.monitor.signals())
        statuses = [each for each in known if each is not None]
        # Before the first call there are none, but the report says that they are waiting.
        statuses = statuses or list(system.monitor.report(robot.now_s).statuses.values())
        return robot_view(system.robot, statuses, system.monitor.configs(), self._shown)

    # In the writer's thread

    def _draw(self, entries: Sequence[Entry], dropped: int) -> str:
        """Returns what writes events above the table and draws the table, fitted to the terminal's present size."""
        suspending = self._suspending
        width, height = self._size()
        self._console.size = (width, height)
        with self._console.capture() as lines:
            if dropped:
                self._console.print(Text(dropped_line(dropped), style="bold red"))
            for entry in entries:
                self._console.print(self._entry_text(entry))
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
        view = self._view
        if view is None:
            return []
        with self._console.capture() as table:
            self._console.print(self._title(view, width), no_wrap=True, overflow="ellipsis")
            draw(view, self._console, max(2, height - 2), self._shown)
        return [(line, cell_len(_STYLING.sub("", line))) for line in table.get().rstrip().split("\n")]

    def _shown(self, text: str) -> str:
        """Returns a text from outside as it is written."""
        return printable(with_degree_sign(text) if self._utf8 else text)

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

    def _title(self, view: View, width: int) -> Text:
        minutes, seconds = divmod(int(time.monotonic() - self._started_s), 60)
        title = view.title.copy().append(f"   {minutes // 60}:{minutes % 60:02}:{seconds:02}", style="not bold dim")
        return title.append("   Ctrl-C ends" if width >= 60 else "", style="not bold dim")

    def _entry_text(self, entry: Entry) -> Text:
        """Returns the line of an event, with the word of its level in colour."""
        event = entry.event
        line = self._shown(plain_line(entry, "%H:%M:%S", name_robots=self._name_robots))
        if isinstance(event, Transition):
            word, style = event.to_level.name, STYLE_OF_LEVEL[event.to_level]
            start = line.find(self._shown(event.text)) + len(self._shown(event.signal)) + 1
        else:
            word, style = event.severity.name, _STYLE_OF_SEVERITY.get(event.severity, "dim")
            start = line.find("[") + 1
        text = Text(line)
        text.stylize(style, start, start + len(word))
        return text
