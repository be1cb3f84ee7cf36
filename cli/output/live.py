"""The live view of a terminal: a table that stays at the bottom while events scroll by above it. rich draws it."""

from __future__ import annotations

import os
import sys
import time
from contextlib import suppress
from typing import Sequence

from rich.console import Console
from rich.live import Live
from rich.text import Text

from ...core.judge.monitor import Monitor
from ...core.port import Severity
from ...core.values import Level, Transition
from .events import Entry
from .lines import Monitors, Output, plain_line, readable
from .tables import STYLE_OF_LEVEL, drawn, fleet_view, robot_view

_STYLE_OF_SEVERITY = {Severity.WARN: STYLE_OF_LEVEL[Level.WARN], Severity.ERROR: "red", Severity.FATAL: "bold red"}
_REDRAW_S = 0.9
"""Slightly less than the period of the values."""


class LiveView(Output):
    """Draws monitors on a terminal."""

    _last = "\n"  # leaves the cursor below the table
    _drawn_s = float("-inf")

    def start(self) -> None:
        """Begins drawing."""
        super().start()
        self._console = Console(file=sys.stdout, highlight=False)
        self._live = Live(console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False)
        self._live.start()
        self._console.show_cursor(True)  # a process that is stopped or killed does not bring it back
        self._started_s = time.monotonic()

    def show(self, shown: Monitors) -> None:
        """Writes events, and redraws the table once a second, fitted to the terminal's present size."""
        super().show(shown)
        if time.monotonic() - self._drawn_s < _REDRAW_S or self._streams.stdout.unread_bytes:
            return  # an unread table would be an old one when it is read
        self._drawn_s = time.monotonic()
        with suppress(OSError):  # closed
            self._console.size = os.get_terminal_size(self._streams.stdout.original)
        if len(shown.alert_systems) == 1:
            (system,) = shown.alert_systems
            known = (system.announcements.status(name) for name in system.monitor.signals())
            statuses = [each for each in known if each is not None]
            # Before the first call there are none, but the report says that they are waiting.
            statuses = statuses or list(system.read(Monitor.report).statuses.values())
            view = robot_view(system.robot, statuses, system.monitor.configs())
        else:
            view = fleet_view(shown, self._console.size.height)
        minutes, seconds = divmod(int(time.monotonic() - self._started_s), 60)
        view.title.append(f"   {minutes // 60}:{minutes % 60:02}:{seconds:02}   Ctrl-C ends", style="not bold dim")
        with self._lock:
            self._live.update(drawn(view, self._console), refresh=True)

    def _write(self, entries: Sequence[Entry]) -> None:
        self._console.print(Text("\n").join(map(self._entry_text, entries)))

    def _entry_text(self, entry: Entry) -> Text:
        """Returns the line of an event, with the word of its level in colour."""
        event = entry.event
        line = readable(plain_line(entry, "%H:%M:%S", name_robots=self._name_robots), sys.stdout)
        if isinstance(event, Transition):
            word, style = event.to_level.name, STYLE_OF_LEVEL[event.to_level]
            start = line.find(f" {word}:") + 1
        else:
            word, style = event.severity.name, _STYLE_OF_SEVERITY.get(event.severity, "dim")
            start = line.find("[") + 1
        text = Text(line)
        text.stylize(style, start, start + len(word))
        return text
