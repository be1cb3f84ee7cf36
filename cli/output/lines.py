"""The interface of outputs, and those that write lines: plain ones for people, JSON for programs."""

from __future__ import annotations

import os
import sys
import threading
import time
from typing import TYPE_CHECKING, Sequence, TextIO, Union

from ...core.nodes.outlets import json_line
from ...core.port import LogLine, Severity
from ...core.values import ServiceError, Transition, count_text, printable, with_degree_sign, with_hint
from ...runtime.bounded_queue import BoundedQueue
from ...runtime.times import DATE_TIME, local_time
from ..standard_streams import StandardStreams
from .events import Entry

if TYPE_CHECKING:
    from ..embedded import EmbeddedMonitor
    from ..fleet import Fleet

MOST_EVENTS = 2_000
"""Events that wait while stdout is not read."""
_AT_ONCE = 50
_MOST_UNREAD_BYTES = 30_000
"""In the pipe to stdout, which then has room for so many events."""
_CLOSE_S = 0.5
_POLL_S = 0.01
_REFRESH_S = 0.1


class OutputError(ServiceError):
    """The output could not be written completely. `str()` says why."""


Monitors = Union["EmbeddedMonitor", "Fleet"]
"""What a process runs, shows and serves: one robot in it, or several over their bridges."""


class Output:
    """Shows monitors, as plain lines, one per event. Only `close` waits for a reader, for 1 s at most.

    What is written goes through `StandardStreams`. While that is not read, events wait here, and the oldest of too many
    are dropped.
    """

    _last = ""
    """Written at the end."""

    def __init__(self, name_robots: bool = False) -> None:
        """Prepares the output; `name_robots` puts the robot's name before each transition."""
        self._name_robots = name_robots
        self._streams = StandardStreams()
        self._is_open = False
        self._lock = threading.Lock()
        self._events: BoundedQueue[Entry] = BoundedQueue(MOST_EVENTS)
        self.problem = ""
        """Why stdout is not written at present; empty if it is."""

    @property
    def reader_is_gone(self) -> bool:
        """Whether nothing reads stdout any more."""
        return self._streams.stdout.reader_is_gone

    def start(self) -> None:
        """Begins writing."""
        self._streams.on_change(self._note_change)
        self._streams.__enter__()
        self._is_open = True

    def put(self, entry: Entry) -> None:
        """Writes an event, now or when earlier ones have been read. May be called in any thread."""
        with self._lock:
            self._events.put(entry, 1)
            self._write_events()

    def show(self, shown: Monitors) -> None:
        """Shows the current state; called several times a second, in the loop's thread. Lines show only events."""
        with self._lock:
            self._write_events()

    def close(self) -> None:
        """Writes what is left, as far as it is read."""
        if self._is_open:
            end_s = time.monotonic() + _CLOSE_S
            while self._events and time.monotonic() < end_s:
                with self._lock:
                    self._write_events()
                time.sleep(_POLL_S)
            sys.stdout.write(self._last)
            self._streams.__exit__()

    def _write_events(self) -> None:
        while self._is_open and self._events and self._streams.stdout.unread_bytes < _MOST_UNREAD_BYTES:
            dropped, self._events.dropped = self._events.dropped, 0
            entries = [self._events.pop() for _ in range(min(len(self._events), _AT_ONCE))]
            if dropped:
                text = f"{count_text(dropped, 'event')} dropped: the output was not read"
                entries.insert(0, Entry(entries[0].wall_s, LogLine(0.0, "output", Severity.WARN, text)))
            self._write(entries)

    def _write(self, entries: Sequence[Entry]) -> None:
        """Writes events."""
        sys.stdout.write(readable(_plain_lines(entries, self._name_robots), sys.stdout))

    def _note_change(self, name: str, problem: str) -> None:
        if name == "stdout" and not self.reader_is_gone:
            self.problem = f"{name} {problem}" if problem else ""
            if problem.startswith("cannot"):
                sys.stderr.write(f"robot-health: {self.problem}; monitoring continues\n")


class JsonLines(Output):
    """JSON for programs: one object per transition on stdout, the log in plain lines on stderr."""

    def _write(self, entries: Sequence[Entry]) -> None:
        log = [entry for entry in entries if not isinstance(entry.event, Transition)]
        sys.stderr.write(_plain_lines(log))
        lines = (f"{json_line(entry.event)}\n" for entry in entries if isinstance(entry.event, Transition))
        sys.stdout.write("".join(lines))


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


def _plain_lines(entries: Sequence[Entry], name_robots: bool = False) -> str:
    return "".join(f"{plain_line(entry, name_robots=name_robots)}\n" for entry in entries)


def readable(text: str, stream: TextIO) -> str:
    """Returns a text for people as a stream can show it: with °C in place of degC where it is UTF-8."""
    return with_degree_sign(text) if (stream.encoding or "").lower().startswith("utf") else text


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
