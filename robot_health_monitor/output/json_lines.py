"""JSON for programs: one object per transition."""

from __future__ import annotations

import json
import math
from typing import Any, Dict, Mapping, Sequence, TextIO

from robot_health_monitor.core.formatting import datum_text
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Level, Transition

from .display import Shown
from .events import Entry
from .plain import dropped_line, plain_line
from .stream_writer import StreamWriter

FIELDS = tuple(name for name in Transition.__dataclass_fields__ if name != "status")
"""The fields of a transition that are written. Its status is left out: it repeats them as text."""


_LARGE = 10**1000


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


def json_line(transition: Transition, **further: str) -> str:
    """Formats a transition as one JSON object: levels by name, NaN and infinities as null, ASCII only.

    Args:
        transition: what to format.
        further: fields to add.
    """
    fields: Dict[str, Any] = {name: getattr(transition, name) for name in FIELDS}
    fields.update(further)
    return json.dumps({name: _as_json(value) for name, value in fields.items()})


def _render_log(entries: Sequence[Entry], dropped: int) -> str:
    lines = [plain_line(entry) for entry in entries]
    if dropped:
        lines.insert(0, dropped_line(dropped))
    return "".join(f"{line}\n" for line in lines)


def _as_json(value: object) -> object:
    if isinstance(value, Level):
        return value.name
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _as_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_as_json(item) for item in value]
    if value is None or isinstance(value, (str, bool)) or (isinstance(value, int) and abs(value) < _LARGE):
        return value
    return datum_text(value)  # such as an integer of 5,000 digits, which Python does not convert to text
