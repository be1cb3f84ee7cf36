"""JSON for programs: one object per transition."""

from __future__ import annotations

from typing import Sequence, TextIO

from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Transition
from robot_health_monitor.core.transition_json import json_line

from .display import Shown
from .events import Entry
from .plain import dropped_line, plain_line
from .stream_writer import StreamWriter

__all__ = ["JsonLines"]


class JsonLines:
    """Writes transitions to one stream and the log to another."""

    def __init__(self, stream: TextIO, log: TextIO) -> None:
        """Prepares the output; `start` begins writing.

        Args:
            stream: for transitions.
            log: for log lines.
        """
        self._writer = StreamWriter(stream, self._render)
        self._log_writer = StreamWriter(log, _render_log)

    @property
    def reader_is_gone(self) -> bool:
        """Whether nothing reads the transitions any more."""
        return self._writer.reader_is_gone

    @property
    def problem(self) -> str:
        """Why transitions are not written at present; empty: they are."""
        return self._writer.problem

    def start(self, loop: object, shown: Shown) -> None:
        """Begins writing."""
        self._writer.start()
        self._log_writer.start()

    def add(self, entry: Entry) -> None:
        """Writes an event; never blocks."""
        writer = self._writer if isinstance(entry.event, Transition) else self._log_writer
        writer.put(entry)

    def show(self, shown: Shown) -> None:
        """Does nothing: JSON has no table."""

    def close(self) -> None:
        """Writes what is left, as far as it is read."""
        self._writer.close()
        self._log_writer.close()

    def _render(self, entries: Sequence[Entry], dropped: int) -> str:
        if dropped and entries:
            line = LogLine(0.0, "output", Severity.ERROR, dropped_line(dropped))
            self._log_writer.put(Entry(entries[0].wall_s, line))
        return "".join(f"{json_line(entry.event)}\n" for entry in entries if isinstance(entry.event, Transition))


def _render_log(entries: Sequence[Entry], dropped: int) -> str:
    lines = [plain_line(entry) for entry in entries]
    if dropped:
        lines.insert(0, dropped_line(dropped))
    return "".join(f"{line}\n" for line in lines)
