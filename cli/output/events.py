"""Collects what monitors announce and log, for the output."""

from __future__ import annotations

import logging
import time
from typing import Callable, NamedTuple

from ...core.nodes.outlets import Event, Outlet
from ...core.port import LogLine, Severity
from ...core.values import Clock, Level, Transition


class Entry(NamedTuple):
    """One event, as the output receives it."""

    wall_s: float
    """Wall time in seconds since 1970, read when the event occurred.

    Not converted from the event's own time: that is monotonic, or simulated, and the wall clock may have been set.
    """
    event: LogLine | Transition
    """What happened."""
    silenced: str | None = None
    """Reason and end of the silence of the transition's signal; None if it is not silenced."""


class Events(logging.Handler):
    """Passes log lines and transitions to the output, and counts the alerts among them.

    As a handler of `logging` it turns the records of libraries into log lines, without tracebacks: on stderr they would
    break the live table.
    """

    def __init__(
        self,
        output: Callable[[Entry], None],
        least: Severity = Severity.INFO,
        *,
        silence_of: Callable[[str, str], str | None] = lambda robot, signal: None,
        wall_time_s: Clock = time.time,
    ) -> None:
        """`output` must not block; log lines less severe than `least` are left out, transitions never are.

        `silence_of` returns the text of the silence of a robot's signal, None without one; `wall_time_s` s since 1970.
        """
        super().__init__(logging.WARNING)
        self._output = output
        self._least = least
        self._wall_time_s = wall_time_s
        self._silence_of = silence_of
        self.alerts = 0
        """Number of transitions to a level other than OK."""

    def on_log(self, line: LogLine) -> None:
        """Receives a log line of a node."""
        if line.severity >= self._least:
            self._output(Entry(self._wall_time_s(), line))

    def outlet(self, node: str) -> Outlet:
        """Returns an outlet for an alert_system; `node` is the name shown before its notices."""

        def on_event(event: Event) -> None:
            if isinstance(event, Transition):
                self.on_transition(event)
            else:
                self.on_log(LogLine(event.now_s, node, event.severity, event.text))

        return on_event

    def on_transition(self, transition: Transition) -> None:
        """Receives a transition."""
        silenced = self._silence_of(transition.robot, transition.signal)
        self._output(Entry(self._wall_time_s(), transition, silenced))
        if transition.to_level is not Level.OK:
            self.alerts += 1

    def emit(self, record: logging.LogRecord) -> None:
        """Receives the record of a library."""
        text = record.getMessage().partition("\n")[0]
        error = record.exc_info[1] if record.exc_info else None
        if error is not None:
            text += f": {type(error).__name__}: {error}"
        severity = Severity.ERROR if record.levelno >= logging.ERROR else Severity.WARN
        self.on_log(LogLine(record.created, record.name, severity, text))
