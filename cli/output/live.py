"""The live view of a terminal: a table that stays at the bottom while events scroll by above it. rich draws it."""

from __future__ import annotations

import time
from typing import Sequence, TextIO

from rich.console import Console
from rich.live import Live
from rich.text import Text

from ...core.port import Severity
from ...core.values import Level, Transition, printable
from .events import Entry
from .lines import Monitors, Output, dropped_line, plain_line, readable
from .tables import STYLE_OF_LEVEL, View, drawn, fleet_view, robot_view

_STYLE_OF_SEVERITY = {Severity.WARN: STYLE_OF_LEVEL[Level.WARN], Severity.ERROR: "red", Severity.FATAL: "bold red"}
_REDRAW_S = 0.9
"""Slightly less than the period of the values."""


class LiveView(Output):
    """Draws monitors on a terminal.

    The state is read in the loop's thread; layout and writing happen in the writer's.
    """

    def __init__(self, stream: TextIO, name_robots: bool = False) -> None:
        """Prepares the view; `name_robots` puts the robot's name before each transition."""
        super().__init__(stream, self._draw, last="\n")
        self._name_robots = name_robots
        self._console = Console(file=stream, highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
        self._view: View | None = None
        self._started_s = time.monotonic()
        self._drawn_s = float("-inf")

    def show(self, shown: Monitors) -> None:
        """Redraws the table once a second."""
        if time.monotonic() - self._drawn_s < _REDRAW_S:
            return
        self._drawn_s = time.monotonic()
        if len(shown.robots) == 1:
            (robot,) = shown.robots
            system = robot.alert_system
            known = (system.announcements.status(name) for name in system.monitor.signals())
            statuses = [each for each in known if each is not None]
            # Before the first call there are none, but the report says that they are waiting.
            statuses = statuses or list(system.monitor.report(robot.now_s).statuses.values())
            self._view = robot_view(system.robot, statuses, system.monitor.configs(), self._shown)
        else:
            self._view = fleet_view(shown, self._console.size.height, self._shown)
        self.wake()

    # In the writer's thread

    def _draw(self, entries: Sequence[Entry], dropped: int) -> str:
        """Returns what writes events above the table and draws the table, fitted to the terminal's present size."""
        with self._console.capture() as written:
            if not self._live.is_started:
                self._live.start()
                self._console.show_cursor(True)  # a process that is stopped or killed does not bring it back
            lines = [Text(dropped_line(dropped), style="bold red")] if dropped else []
            lines += map(self._entry_text, entries)
            if lines:
                self._console.print(Text("\n").join(lines))
            if self._view is not None:
                minutes, seconds = divmod(int(time.monotonic() - self._started_s), 60)
                lasted = f"   {minutes // 60}:{minutes % 60:02}:{seconds:02}   Ctrl-C ends"
                title = self._view.title.copy().append(lasted, style="not bold dim")
                self._live.update(drawn(self._view._replace(title=title), self._console, self._shown), refresh=True)
        return written.get()

    def _shown(self, text: str) -> str:
        """Returns a text from outside as it is written."""
        return printable(readable(text, self._stream))

    def _entry_text(self, entry: Entry) -> Text:
        """Returns the line of an event, with the word of its level in colour."""
        event = entry.event
        line = self._shown(plain_line(entry, "%H:%M:%S", name_robots=self._name_robots))
        if isinstance(event, Transition):
            word, style = event.to_level.name, STYLE_OF_LEVEL[event.to_level]
            start = line.find(f" {word}:") + 1
        else:
            word, style = event.severity.name, _STYLE_OF_SEVERITY.get(event.severity, "dim")
            start = line.find("[") + 1
        text = Text(line)
        text.stylize(style, start, start + len(word))
        return text
