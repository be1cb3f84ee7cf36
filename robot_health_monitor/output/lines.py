"""What the monitor has to say, as lines: plain ones for pipes and files, JSON for programs."""

from __future__ import annotations

import json
import math
import select
from datetime import datetime
from typing import Any, Dict, List, Mapping, Optional, Sequence, TextIO, Union

from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.model import Level, Transition

Event = Union[LogLine, Transition]


class Events:
    """Collects what the nodes say until there is time to write it.

    A write that fails inside of a callback would be taken for a failure of the node; so nothing is written there.
    """

    def __init__(self, least: Severity = Severity.INFO) -> None:
        """Starts with nothing.

        Args:
            least: log lines below this are not collected; transitions always are.
        """
        self._least = least
        self._events: List[Event] = []
        self._last_line: Optional[LogLine] = None
        self.alerts = 0
        """How many transitions to another level than OK there were."""

    def on_log(self, line: LogLine) -> None:
        """Takes a line that a node logged."""
        self._last_line = line
        if line.severity >= self._least:
            self._events.append(line)

    def on_transition(self, transition: Transition) -> None:
        """Takes a transition in place of its line, which was logged right before."""
        if self._events and self._events[-1] is self._last_line and self._last_line.text == transition.text:
            self._events.pop()
        self._events.append(transition)
        if transition.to_level is not Level.OK:
            self.alerts += 1

    def take(self) -> List[Event]:
        """Returns what was collected since the last call, oldest first."""
        events, self._events = self._events, []
        return events


class PlainOutput:
    """Writes every event as a plain line."""

    def __init__(self, stream: TextIO, name_robots: bool = False) -> None:
        """Writes to `stream`, with the robot's name before each transition if there may be several."""
        self._stream = stream
        self._name_robots = name_robots

    def attach(self, loop: object, monitor: object) -> None:
        """Does nothing: nothing happens to a line that is written."""

    def show(self, events: Sequence[Event], monitor: object) -> None:
        """Writes events.

        Raises:
            BrokenPipeError: nobody reads them any more, even if there are none: whoever ran `| head` is not kept
                waiting for the next one.
        """
        _write(self._stream, [plain_line(event, name_robots=self._name_robots) for event in events])

    def close(self) -> None:
        """Does nothing: every line has been written."""


class JsonOutput:
    """Writes transitions as JSON for programs, and the log where it is not in their way."""

    def __init__(self, stream: TextIO, log: TextIO) -> None:
        """Writes transitions to `stream` and log lines to `log`."""
        self._stream = stream
        self._log = log

    def attach(self, loop: object, monitor: object) -> None:
        """Does nothing: nothing happens to a line that is written."""

    def show(self, events: Sequence[Event], monitor: object) -> None:
        """Writes events.

        Raises:
            BrokenPipeError: nobody reads the transitions any more.
        """
        for event in events:
            if isinstance(event, LogLine):
                self._log.write(f"{plain_line(event)}\n")
        self._log.flush()
        _write(self._stream, [json_line(event) for event in events if isinstance(event, Transition)])

    def close(self) -> None:
        """Does nothing: every line has been written."""


def plain_line(event: Event, time_format: str = "%Y-%m-%d %H:%M:%S", *, name_robots: bool = False) -> str:
    """Writes an event as people read it, with the local time before it; the event's time is in seconds since 1970."""
    time_text = datetime.fromtimestamp(event.now_s).strftime(time_format)
    if isinstance(event, Transition):
        robot = f"{event.robot}: " if name_robots else ""
        return f"{time_text} {robot}{event.text}"
    return f"{time_text} [{event.severity.name}] {event.node.rpartition('/')[2]}: {event.text}"


def json_line(transition: Transition) -> str:
    """Returns a transition as one JSON object: levels by name, NaN and infinities as null, without the whole status."""
    names = [name for name in Transition.__dataclass_fields__ if name != "status"]
    fields: Dict[str, Any] = {name: getattr(transition, name) for name in names}
    return json.dumps({name: _as_json(value) for name, value in fields.items()}, default=repr)


def _write(stream: TextIO, lines: Sequence[str]) -> None:
    if lines:
        stream.write("\n".join(lines) + "\n")
        stream.flush()
    elif _reader_is_gone(stream):
        raise BrokenPipeError


def _reader_is_gone(stream: TextIO) -> bool:
    """Says whether nobody reads any more what is written to a pipe or terminal."""
    try:
        watch = select.poll()
        watch.register(stream.fileno(), 0)
        return bool(watch.poll(0))
    except (OSError, ValueError):
        return False  # no file below it: a test's own stream


def _as_json(value: object) -> object:
    if isinstance(value, Level):
        return value.name
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _as_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_as_json(item) for item in value]
    return value
