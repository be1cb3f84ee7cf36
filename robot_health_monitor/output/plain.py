"""Plain lines for pipes, files and simple terminals."""

from __future__ import annotations

from typing import Sequence, TextIO

from robot_health_monitor.core.formatting import printable, with_degree_sign, with_hint
from robot_health_monitor.core.model import Transition
from robot_health_monitor.runtime.times import DATE_TIME, local_time

from .display import Shown
from .events import Entry
from .stream_writer import StreamWriter

__all__ = ["PlainLines", "dropped_line", "plain_line", "readable"]


class PlainLines:
    """Writes one line per event."""

    def __init__(self, stream: TextIO, name_robots: bool = False) -> None:
        """Prepares the output; `start` begins writing.

        Args:
            stream: where to write.
            name_robots: put the robot's name before each transition.
        """
        self._name_robots = name_robots
        self._stream = stream
        self._writer = StreamWriter(stream, self._render)

    @property
    def reader_is_gone(self) -> bool:
        """Whether nothing reads the output any more."""
        return self._writer.reader_is_gone

    @property
    def problem(self) -> str:
        """Why the output is not written at present; empty: it is."""
        return self._writer.problem

    def start(self, loop: object, shown: Shown) -> None:
        """Begins writing."""
        self._writer.start()

    def add(self, entry: Entry) -> None:
        """Writes an event; never blocks."""
        self._writer.put(entry)

    def show(self, shown: Shown) -> None:
        """Does nothing: plain output has no table."""

    def close(self) -> None:
        """Writes what is left, as far as it is read."""
        self._writer.close()

    def _render(self, entries: Sequence[Entry], dropped: int) -> str:
        lines = [plain_line(entry, name_robots=self._name_robots) for entry in entries]
        if dropped:
            lines.insert(0, dropped_line(dropped))
        return readable("".join(f"{line}\n" for line in lines), self._stream)


def plain_line(entry: Entry, time_format: str = DATE_TIME, *, name_robots: bool = False, prefix: str = "") -> str:
    """Formats an event for people, with the local time, without control characters.

    Args:
        entry: the event.
        time_format: as for `strftime`.
        name_robots: put the robot's name before a transition.
        prefix: text to put before a transition.
    """
    event = entry.event
    time_text = local_time(entry.wall_s, time_format)
    if isinstance(event, Transition):
        prefix = prefix or (event.robot if name_robots else "")
        robot = f"{prefix}: " if prefix else ""
        silenced = "" if entry.silenced is None else f" [silenced: {entry.silenced}]"
        return printable(f"{time_text} {robot}{with_hint(event.text, event.hint)}{silenced}")
    return printable(f"{time_text} [{event.severity.name}] {event.node.rpartition('/')[2]}: {event.text}")


def readable(text: str, stream: TextIO) -> str:
    """Returns a text for people as a stream can show it: with °C in place of degC where it is UTF-8."""
    return with_degree_sign(text) if (stream.encoding or "").lower().startswith("utf") else text


def dropped_line(dropped: int) -> str:
    """Returns the line in place of events that were dropped because the output was not read."""
    return f"... {dropped} {'line' if dropped == 1 else 'lines'} dropped: the output was not read"
