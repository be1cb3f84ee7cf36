"""The live table of several robots: a row per robot with its worst signal, the reason, and since when.

Robots that are not OK come first, the worst at the top. As far as there is room, further rows show their other signals
that are not OK, then all signals. The reason is never cut off: other columns give way, and it continues on further
lines.
"""

from __future__ import annotations

import time
from typing import Iterator, List, NamedTuple, Optional, Sequence

from rich.cells import cell_len, chop_cells
from rich.text import Text

from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.model import Status

from .display import Shown
from .status_text import level_text, rank, rank_of, value_text

__all__ = ["FleetState", "RobotState", "fleet_lines", "fleet_state", "fleet_summary"]

_GAP = 2
"""Blanks between columns."""
_WIDEST_ROBOT, _WIDEST_SIGNAL = 20, 24
_NARROW_NAME, _NARROWEST_NAME = 14, 10
_MIN_REASON = 28
"""Narrowest column for the reason, in cells; in less room it has separate lines."""
_MOST_REASON_LINES = 6
_INDENT = "  "
_DAY_S = 86_400.0
_RANKS = ((6, "ERROR"), (4, "STALE"), (2, "WARN"), (1, "unknown"), (0, "OK"))


class RobotState(NamedTuple):
    """What is shown of one robot."""

    name: str
    rank: int
    """That of its worst signal."""
    worst: Optional[Status]
    """The status of its worst signal; None while nothing is known, and for a robot that is OK."""
    others: Sequence[Status]
    """Statuses of its other signals, the worst first; as many as could be shown."""


class FleetState(NamedTuple):
    """What the table shows, read at one moment."""

    robots: Sequence[RobotState]
    """The worst first; as many as could be shown."""
    total: int
    """Number of all robots."""
    ranks: Sequence[int]
    """Ranks of all robots, in the order of `robots`."""
    silenced: int
    """Number of signals that are not OK and silenced."""


def fleet_state(shown: Shown, lines: int) -> FleetState:
    """Reads the state of all robots. Statuses are made only for what `lines` lines can show.

    Args:
        shown: the robots.
        lines: height of the terminal.
    """
    systems = [robot.alert_system for robot in shown.robots]
    ranks = [
        {name: rank_of(level, state) for name, (level, state) in system.monitor.levels().items()} for system in systems
    ]
    worst = [max(of_robot.values(), default=1) for of_robot in ranks]
    order = sorted(range(len(systems)), key=lambda index: -worst[index])
    room = lines
    robots: List[RobotState] = []
    for index in order[:lines]:
        names = sorted(ranks[index], key=lambda name: -ranks[index][name])
        found = (systems[index].status(name) for name in names[: 1 + max(0, room)])
        statuses = [status for status in found if status is not None]
        first = statuses.pop(0) if worst[index] > 0 and statuses else None
        room -= len(statuses)
        robots.append(RobotState(systems[index].robot, worst[index], first, statuses))
    silenced = sum(
        rank > 1 and system.silence_of(name) is not None
        for system, of_robot in zip(systems, ranks)
        for name, rank in of_robot.items()
    )
    return FleetState(robots, len(systems), [worst[index] for index in order], silenced)


def fleet_summary(state: FleetState) -> Text:
    """Returns how many robots have which level, and which robot is the worst."""
    text = Text(f"{state.total} robots", style="bold")
    worst = state.robots[0] if state.robots else None
    if worst is not None and worst.rank > 0:
        text.append(", worst: ", style="not bold")
        text.append(printable(worst.name))
        if worst.worst is not None:
            text.append(" ")
            text.append(level_text(worst.worst))
    text.append(f"   {_counts(state.ranks)}", style="not bold")
    if state.silenced:
        text.append(f"   {state.silenced} silenced", style="not bold")
    return text


def fleet_lines(state: FleetState, width: int, room: int) -> List[Text]:
    """Returns the lines of the table.

    Args:
        state: what to show.
        width: width of the terminal in cells.
        room: most lines to return.
    """
    layout = _Layout(state, width)
    blocks = [layout.robot(robot) for robot in state.robots]
    room = max(1, room - 1)  # the header
    fitting, used = 0, 0
    for number, block in enumerate(blocks):
        is_last = number + 1 == state.total
        if used + len(block) > room - (0 if is_last else 1) and fitting:
            break
        fitting, used = number + 1, used + len(block)
    hidden = state.total - fitting
    used += 1 if hidden else 0
    expanded: List[List[Text]] = [[] for _ in range(fitting)]
    for wanted in (_not_ok, _others):
        for number in range(fitting):
            for status in wanted(state.robots[number]):
                lines = layout.signal(status)
                if used + len(lines) > room:
                    break
                used += len(lines)
                expanded[number].extend(lines)
    lines = [layout.header()]
    for block, below in zip(blocks[:fitting], expanded):
        lines.extend((*block, *below))
    if hidden:
        lines.append(Text(f"and {hidden} more: {_counts(state.ranks[fitting:])}", style="dim"))
    return lines


def _counts(ranks: Sequence[int]) -> str:
    """Returns how many robots have which level: `2 ERROR, 198 OK`."""
    counts = [(ranks.count(number), name) for number, name in _RANKS]
    return ", ".join(f"{count} {name}" for count, name in counts if count)


def _not_ok(robot: RobotState) -> Iterator[Status]:
    return (status for status in robot.others if rank(status) > 1)


def _others(robot: RobotState) -> Iterator[Status]:
    return (status for status in robot.others if rank(status) <= 1)


class _Layout:
    """Which columns fit, and how a row is divided into lines."""

    def __init__(self, state: FleetState, width: int) -> None:
        self._width = width
        statuses = [status for robot in state.robots for status in (robot.worst, *robot.others) if status is not None]
        names = [cell_len(printable(robot.name)) for robot in state.robots]
        signals = [cell_len(printable(status.name)) for status in statuses]
        self._robot = min(max([5, *names]), max(_WIDEST_ROBOT, width // 4))
        self._signal = min(max([6, *signals]), _WIDEST_SIGNAL)
        self._level = max([7, *(cell_len(level_text(status).plain) for status in statuses)])
        self._since = 8
        self._value = 0
        if self._room() < _MIN_REASON:
            self._robot = min(self._robot, _NARROW_NAME)
            self._signal = min(self._signal, _NARROW_NAME)
            self._since = 5
        if self._room() < 0:
            self._robot = min(self._robot, _NARROWEST_NAME)
            self._signal = 0  # before the reason
        reasons = [cell_len(printable(status.message)) for status in statuses if rank(status) > 0]
        values = max([5, *(cell_len(value_text(status)) for status in statuses)])
        if self._room() - values - _GAP >= max([_MIN_REASON, *reasons]):
            self._value = values
        self._beside = self._room() >= _MIN_REASON

    def header(self) -> Text:
        """Returns the line with the names of the columns."""
        reason = "reason" if self._beside else ""
        return self._line(Text("robot"), Text("level"), "since", "signal", "value", reason, "bold")

    def robot(self, robot: RobotState) -> List[Text]:
        """Returns the lines of a robot: its worst signal."""
        name = Text(printable(robot.name), style="bold" if robot.rank > 1 else "")
        if robot.worst is None:
            level = Text("OK", style="green") if robot.rank == 0 else Text("waiting", style="cyan")
            reason = "" if robot.rank == 0 else "no connection yet"
            return self._lines(name, level, "", "", "", reason)
        return self._row(name, robot.worst)

    def signal(self, status: Status) -> List[Text]:
        """Returns the lines of a further signal of the robot above."""
        return self._row(Text(""), status)

    def _row(self, name: Text, status: Status) -> List[Text]:
        reason = printable(status.message)
        return self._lines(
            name, level_text(status), self._since_text(status), printable(status.name), value_text(status), reason
        )

    def _lines(self, robot: Text, level: Text, since: str, signal: str, value: str, reason: str) -> List[Text]:
        if self._beside:
            parts = _wrapped(reason, self._room())
            lines = [self._line(robot, level, since, signal, value, parts[0])]
            indent = " " * (self._width - self._room())
            return lines + [Text(indent + part) for part in parts[1:]]
        lines = [self._line(robot, level, since, signal, value, "")]
        if signal and not self._signal:
            reason = f"{signal}: {reason}"
        return lines + [Text(_INDENT + part) for part in _wrapped(reason, self._width - len(_INDENT)) if part]

    def _line(
        self, robot: Text, level: Text, since: str, signal: str, value: str, reason: str, line_style: str = ""
    ) -> Text:
        line = Text(style=line_style)
        cells = [(robot, self._robot), (level, self._level), (Text(since), self._since)]
        cells += [(Text(signal), self._signal)] if self._signal else []
        cells += [(Text(value), self._value)] if self._value else []
        for cell, width in cells:
            cell.truncate(width, overflow="ellipsis", pad=True)
            line.append_text(cell)
            line.append(" " * _GAP)
        line.append(reason)
        line.rstrip()
        line.truncate(self._width)
        return line

    def _room(self) -> int:
        """Returns the cells that are left for the reason."""
        used = self._robot + self._level + self._since + self._signal + 4 * _GAP
        return self._width - used - (self._value + _GAP if self._value else 0)

    def _since_text(self, status: Status) -> str:
        """Returns since when a level lasts, as local time; the date if that was more than a day ago."""
        if rank(status) == 0:
            return ""
        try:
            lasts_s = float(status.values["lasts_s"])
        except (KeyError, ValueError):
            return ""
        form = "%b %d" if lasts_s >= _DAY_S else "%H:%M:%S" if self._since >= 8 else "%H:%M"
        return time.strftime(form, time.localtime(max(0.0, time.time() - lasts_s)))


def _wrapped(text: str, width: int) -> List[str]:
    """Divides a text at blanks into parts of at most `width` cells; at least one, and at most `_MOST_REASON_LINES`."""
    parts: List[str] = [""]
    for word in text.split(" "):
        for piece in chop_cells(word, max(1, width)) or [""]:
            joined = f"{parts[-1]} {piece}" if parts[-1] else piece
            if cell_len(joined) <= width:
                parts[-1] = joined
            else:
                parts.append(piece)
    if len(parts) > _MOST_REASON_LINES:
        parts = [*parts[: _MOST_REASON_LINES - 1], "..."]
    return parts
