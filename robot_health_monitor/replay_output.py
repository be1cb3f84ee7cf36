"""What a replay prints: alert lines while it runs, a progress bar on a terminal, and a table at the end."""

from __future__ import annotations

import os
import sys
import time
from typing import Any, Optional, Sequence

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.transition_json import json_line
from robot_health_monitor.runtime.libraries import missing_libraries, missing_text

from .output.events import Entry
from .output.lines import plain_line, readable
from .replay_table import plain_table, rich_tables

_STYLE_OF_LEVEL = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "magenta"}
_REFRESH_S = 0.1


class ReplayOutput:
    """Writes alerts to stdout and everything else about the replay to where it does not disturb them."""

    def __init__(self, as_json: bool) -> None:
        """Prepares the output; nothing is written yet.

        Args:
            as_json: one JSON object per transition on stdout, the rest on stderr.
        """
        self._as_json = as_json
        self._console: Any = None
        self._stdout_is_terminal = _is_terminal(sys.stdout)
        if self._stdout_is_terminal or _is_terminal(sys.stderr):
            self._console = _console(use_stderr=not self._stdout_is_terminal)
        self._progress: Any = None
        self._task: Any = None
        self._refreshed_s = 0.0

    def __enter__(self) -> ReplayOutput:
        """Shows the progress bar, on a terminal."""
        if self._console is not None:
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

            columns = (TextColumn("judging"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
            # Redirecting would send the alerts to this terminal even if stdout is a file or a pipe.
            self._progress = Progress(
                *columns,
                console=self._console,
                transient=True,
                auto_refresh=False,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._task = self._progress.add_task("judging", total=1.0)
            self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Removes the progress bar."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None

    def progress(self, fraction: float) -> None:
        """Moves the progress bar."""
        if self._progress is None or (time.monotonic() - self._refreshed_s < _REFRESH_S and fraction < 1.0):
            return
        self._refreshed_s = time.monotonic()
        self._progress.update(self._task, completed=fraction)
        self._progress.refresh()

    def transition(self, wall_s: float, transition: Transition, file: str) -> None:
        """Writes a transition.

        Args:
            wall_s: when, in s since 1970.
            transition: what changed.
            file: name of its configuration; empty: there is only one.
        """
        if self._as_json:
            line = json_line(transition, **({"file": file} if file else {}))
        else:
            line = readable(plain_line(Entry(wall_s, transition), prefix=file), sys.stdout)
        self._write(line, _STYLE_OF_LEVEL[transition.to_level])

    def log(self, wall_s: float, line: LogLine) -> None:
        """Writes a line of a node; INFO lines go where the alerts are, except with JSON."""
        text = plain_line(Entry(wall_s, line))
        if line.severity >= Severity.WARN or self._as_json:
            self.warn(text)
        else:
            self._write(text, "dim")

    def warn(self, text: str) -> None:
        """Writes a line to stderr."""
        if self._progress is not None and _is_terminal(sys.stderr):
            self._print(text, "yellow")  # above the progress bar, which is on this terminal
            return
        sys.stdout.flush()
        sys.stderr.write(f"{printable(text)}\n")
        sys.stderr.flush()

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], last_line: str) -> None:
        """Writes the table, with a line below it."""
        if self._stdout_is_terminal and self._console is not None and not self._as_json:
            shown = [[readable(cell, sys.stdout) for cell in cells] for cells in rows]
            for table in rich_tables(head, shown, self._console.width):
                self._console.print()
                self._console.print(table)
            self._print(last_line, "bold")
            return
        stream = sys.stderr if self._as_json else sys.stdout
        shown = [[readable(cell, stream) for cell in cells] for cells in rows]
        stream.write("".join(f"{line}\n" for line in ("", *plain_table(head, shown), printable(last_line))))
        stream.flush()

    def _write(self, line: str, style: str) -> None:
        if self._stdout_is_terminal and self._console is not None:
            self._print(line, style)
        else:
            sys.stdout.write(f"{line}\n")

    def _print(self, line: str, style: str) -> None:
        from rich.text import Text

        self._console.print(Text(printable(line), style=style), soft_wrap=True)


def _is_terminal(stream: Any) -> bool:
    return bool(stream.isatty()) and os.environ.get("TERM") not in (None, "", "dumb", "unknown")


def _console(use_stderr: bool) -> Optional[Any]:
    try:
        from rich.console import Console
    except ModuleNotFoundError as error:
        sys.stderr.write(f"{missing_text(missing_libraries(error, 'rich'))} (no progress bar, no colours)\n")
        return None
    return Console(stderr=use_stderr, highlight=False)
