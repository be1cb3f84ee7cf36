"""The interface of outputs, and those that write lines: plain ones for people, JSON for programs."""

from __future__ import annotations

import os
import sys
import time
from typing import TYPE_CHECKING, Callable, Dict, List, Mapping, Optional, Sequence, TextIO, Tuple, TypeVar, Union

from ...core.config.signal_config import SignalConfig
from ...core.judge.wording import judged_unit
from ...core.nodes.outlets import json_line
from ...core.port.local import LogLine
from ...core.port.middleware import Severity
from ...core.values.errors import ServiceError
from ...core.values.formatting import duration_text, number_text, printable, with_degree_sign, with_hint, with_unit
from ...core.values.model import Level, Transition
from ...runtime.times import DATE_TIME, local_time
from .events import Entry
from .stream_writer import StreamWriter

if TYPE_CHECKING:
    from ..embedded import EmbeddedMonitor
    from ..fleet import Fleet


_REFRESH_S = 0.1
_WORST_FIRST = sorted((level for level in Level if level is not Level.OK), key=lambda level: -level.severity)


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
        super().__init__(stream, self._render_lines)
        self._name_robots = name_robots

    def _render_lines(self, entries: Sequence[Entry], dropped: int) -> str:
        return readable(_plain_lines(entries, dropped, self._name_robots), self._stream)


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


COLOURS = {Level.OK: "32", Level.WARN: "33", Level.ERROR: "1;31", Level.STALE: "35"}
"""Codes of a terminal."""


def is_coloured(stream: TextIO) -> bool:
    """Returns whether lines on a stream have colours."""
    return is_terminal(stream) and "NO_COLOR" not in os.environ


def coloured(line: str, code: str) -> str:
    """Returns a line in a colour; an empty code is none."""
    return f"\x1b[{code}m{line}\x1b[0m" if code else line


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


def plain_table(rows: Sequence[Sequence[str]], texts: int) -> List[str]:
    """Returns the lines of a table with aligned columns: the first `texts` to the left, the others, numbers, right."""
    lines = [[printable(cell) for cell in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines)]
    aligned = (
        [cell.ljust(width) if at < texts else cell.rjust(width) for at, (cell, width) in enumerate(zip(line, widths))]
        for line in lines
    )
    return ["  ".join(cells).rstrip() for cells in aligned]


Summary = TypeVar("Summary")


def below_causes(
    summaries: Sequence[Summary], key: Callable[[Summary], Tuple[str, str]], cause: Callable[[Summary], str]
) -> List[Tuple[Summary, int]]:
    """Returns summaries with each effect below its cause, and how many effects follow each: -1 for an effect.

    `key` returns group and name of a summary, `cause` the name of its cause in the group; empty: none.
    """
    effects: Dict[Tuple[str, str], List[Summary]] = {key(each): [] for each in summaries if not cause(each)}
    others = [each for each in summaries if (key(each)[0], cause(each)) not in effects]
    for each in summaries:
        effects.get((key(each)[0], cause(each)), []).append(each)
    ordered: List[Tuple[Summary, int]] = []
    for each in others:
        own = effects.get(key(each), [])
        ordered += [(each, len(own)), *((effect, -1) for effect in own)]
    return ordered


def folded_name(name: str, effects: int) -> str:
    """Returns a name in a table whose effects are below their cause, as `below_causes` counts them."""
    return f"  {name}" if effects < 0 else f"{name} (+ {effects} affected)" if effects else name


def share_text(share: float) -> str:
    """Returns a share, 0 to 1, in %. Only exactly 0 and exactly 1 are shown as 0 % and 100 %."""
    if share <= 0.0 or share >= 1.0:
        return "0 %" if share <= 0.0 else "100 %"
    return f"{min(max(share * 100.0, 0.1), 99.9):.1f} %"


def share_cells(shares: Mapping[Level, float], unknown: float) -> List[str]:
    """Returns the shares of the levels, in their order, and of the time in which the level is not known."""
    return [share_text(share) for share in (*(shares.get(level, 0.0) for level in Level), unknown)]


def badness(shares: Mapping[Level, float], *others: float) -> Tuple[float, ...]:
    """Returns the shares of the levels, the worst first, and `others`: the greater, the worse."""
    return (*(shares.get(level, 0.0) for level in _WORST_FIRST), *others)


def summary_sentence(
    what: str, count: int, done: str, duration_s: float, worst: str, shares: Mapping[Level, float], known: str = ""
) -> str:
    """Returns what was `done` with `what`, for how long, and which of `count` signals was the worst, with its shares.

    `known` is added if all were OK.
    """
    begin = f"{what} {'was' if count == 1 else 'were'} {done} over {duration_text(duration_s)}."
    parts = [f"{level.name} for {share_text(shares[level])}" for level in _WORST_FIRST if shares.get(level)]
    if parts:
        return f"{begin} The worst is {worst}: {', '.join(parts)} of the time."
    return f"{begin} {'It was' if count == 1 else 'All were'} OK{known}."


def range_cells(
    config: SignalConfig, smallest: Optional[float], mean: Optional[float], largest: Optional[float]
) -> List[str]:
    """Returns the cells min, mean and max: values of the statistic, or the levels of a driver, which have no mean."""
    if config.is_status and not config.is_template:
        ends = ["-" if value is None else Level(int(value)).name for value in (smallest, largest)]
        return [ends[0], "-", ends[1]]
    unit = judged_unit(config)
    return ["-" if value is None else with_unit(number_text(value), unit) for value in (smallest, mean, largest)]
