"""The interface of outputs, and those that write lines: plain ones for people, JSON for programs."""

from __future__ import annotations

import os
import sys
import time
from typing import TYPE_CHECKING, Sequence, TextIO, Union

from ...core.nodes.outlets import json_line
from ...core.port import LogLine, Severity
from ...core.values import ServiceError, Transition, printable, with_degree_sign, with_hint
from ...runtime.times import DATE_TIME, local_time
from .events import Entry
from .stream_writer import StreamWriter

if TYPE_CHECKING:
    from ..embedded import EmbeddedMonitor
    from ..fleet import Fleet


_REFRESH_S = 0.1


class OutputError(ServiceError):
    """The output could not be written completely. `str()` says why."""


Monitors = Union["EmbeddedMonitor", "Fleet"]
"""What a process runs, shows and serves: one robot in it, or several over their bridges."""


class Output(StreamWriter[Entry]):
    """Shows monitors. Writing has its own thread: no method waits for a reader, except `close`, for 1 s."""

    def show(self, shown: Monitors) -> None:
        """Shows the current state; called several times a second, in the loop's thread. Lines show only events."""


class PlainLines(Output):
    """Plain lines for pipes, files and simple terminals, one per event."""

    def __init__(self, stream: TextIO, name_robots: bool = False) -> None:
        """Prepares the output; `name_robots` puts the robot's name before each transition."""
        super().__init__(stream, lambda entries, dropped: readable(_plain_lines(entries, dropped, name_robots), stream))


class JsonLines(Output):
    """JSON for programs: one object per transition on one stream, the log in plain lines on another."""

    def __init__(self, stream: TextIO, log: TextIO) -> None:
        """Prepares the output."""
        super().__init__(stream, self._render_transitions)
        self._log: StreamWriter[Entry] = StreamWriter(log, _plain_lines)

    def start(self) -> None:
        """Begins writing."""
        super().start()
        self._log.start()

    def put(self, item: Entry) -> None:
        """Writes an event soon; never blocks."""
        if isinstance(item.event, Transition):
            super().put(item)
        else:
            self._log.put(item)

    def close(self) -> bool:
        """Writes what is left; returns False if the transitions are not read."""
        is_read = super().close()
        self._log.close()
        return is_read

    def _render_transitions(self, entries: Sequence[Entry], dropped: int) -> str:
        if dropped and entries:
            line = LogLine(0.0, "output", Severity.ERROR, dropped_line(dropped))
            self._log.put(Entry(entries[0].wall_s, line))
        return "".join(f"{json_line(entry.event)}\n" for entry in entries if isinstance(entry.event, Transition))


def plain_line(entry: Entry, time_format: str = DATE_TIME, *, name_robots: bool = False, prefix: str = "") -> str:
    """Formats an event for people, with the local time, without control characters.

    Before a transition comes `prefix`, or the robot's name with `name_robots`.
    """
    event = entry.event
    time_text = local_time(entry.wall_s, time_format)
    if not isinstance(event, Transition):
        return printable(f"{time_text} [{event.severity.name}] {event.node.rpartition('/')[2]}: {event.text}")
    prefix = prefix or (event.robot if name_robots else "")
    robot = f"{prefix}: " if prefix else ""
    silenced = "" if entry.silenced is None else f" [silenced: {entry.silenced}]"
    return printable(f"{time_text} {robot}{with_hint(event.text, event.hint)}{silenced}")


def _plain_lines(entries: Sequence[Entry], dropped: int, name_robots: bool = False) -> str:
    lines = [dropped_line(dropped)] if dropped else []
    lines += [plain_line(entry, name_robots=name_robots) for entry in entries]
    return "".join(f"{line}\n" for line in lines)


def readable(text: str, stream: TextIO) -> str:
    """Returns a text for people as a stream can show it: with °C in place of degC where it is UTF-8."""
    return with_degree_sign(text) if (stream.encoding or "").lower().startswith("utf") else text


def dropped_line(dropped: int) -> str:
    """Returns the line in place of events that were dropped because the output was not read."""
    return f"... {dropped} {'line' if dropped == 1 else 'lines'} dropped: the output was not read"


def is_terminal(stream: TextIO) -> bool:
    """Returns whether a stream is a terminal that can show colours and move its cursor."""
    return stream.isatty() and os.environ.get("TERM") not in (None, "", "dumb", "unknown")


class ProgressLine:
    """A line on the terminal of stderr, if it is one, that says how far a command is. Clear it before other lines."""

    def __init__(self) -> None:
        """Shows nothing yet."""
        self._shown_s = float("-inf")
        self._is_shown = False

    def show(self, text: str) -> None:
        """Shows a text, at most ten times a second."""
        if is_terminal(sys.stderr) and time.monotonic() - self._shown_s >= _REFRESH_S:
            self._shown_s = time.monotonic()
            self._is_shown = True
            sys.stderr.write(f"\r\x1b[K{text}")
            sys.stderr.flush()

    def clear(self) -> None:
        """Removes the line."""
        if self._is_shown:
            self._is_shown = False
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()


def plain_table(rows: Sequence[Sequence[str]], texts: int) -> list[str]:
    """Returns the lines of a table with aligned columns: the first `texts` to the left, the others, numbers, right."""
    lines = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines)]
    aligned = (
        [cell.ljust(width) if at < texts else cell.rjust(width) for at, (cell, width) in enumerate(zip(line, widths))]
        for line in lines
    )
    return ["  ".join(cells).rstrip() for cells in aligned]
