"""The live table of several robots: a row per robot with its worst signal, the reason, and since when.

Robots that are not OK come first, the worst at the top; further rows show their other signals that are not OK. What
does not fit is counted. The reason is never cut off: other columns give way, and it continues on further lines.
"""

from __future__ import annotations

import time
from typing import Callable, List, NamedTuple, Optional, Sequence

from rich.cells import cell_len
from rich.text import Text

from robot_health_monitor.core.formatting import count_text
from robot_health_monitor.core.model import Status
from robot_health_monitor.runtime.times import local_time

from .display import Shown
from .status_text import level_text, rank, rank_counts, rank_of, reason_text
from .text_cells import GAP, INDENT, cells_line, wrapped

__all__ = ["FleetState", "RobotState", "fleet_lines", "fleet_state", "fleet_summary"]

_WIDEST_ROBOT, _WIDEST_SIGNAL = 20, 24
_NARROW_NAME, _NARROWEST_NAME = 14, 10
_MIN_REASON = 28
"""Narrowest column for the reason, in cells; in less room it has separate lines."""
_DAY_S = 86_400.0


class RobotState(NamedTuple):
    """What is shown of one robot."""

    name: str
    rank: int
    """That of its worst signal."""
    worst: Optional[Status]
    """The status of its worst signal; None while nothing is known, and for a robot that is OK."""
    alarms: int
    """Number of its signals that are not OK, silent or invalid ones included, unknown ones not."""
    others: Sequence[Status]
    """Statuses of its other alarms, the worst first; as many as could be shown."""


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
        alarms = sum(rank > 1 for rank in ranks[index].values())
        wanted = min(max(alarms, 1), 1 + max(0, room)) if worst[index] > 0 else 0
        found = (systems[index].status(name) for name in names[:wanted])
        statuses = [status for status in found if status is not None]
        first = statuses.pop(0) if statuses else None
        room -= len(statuses)
        robots.append(RobotState(systems[index].robot, worst[index], first, alarms, statuses))
    silenced = sum(
        rank > 1 and system.silence_of(name) is not None
        for system, of_robot in zip(systems, ranks)
        for name, rank in of_robot.items()
    )
    return FleetState(robots, len(systems), [worst[index] for index in order], silenced)


def fleet_summary(state: FleetState, shown: Callable[[str], str]) -> Text:
    """Returns how many robots have which level, and which robot is the worst.

    Args:
        state: what to show.
        shown: makes a text from outside fit for the terminal.
    """
    text = Text(f"{state.total} robots", style="bold")
    worst = state.robots[0] if state.robots else None
    if worst is not None and worst.rank > 0:
        text.append(", worst: ", style="not bold")
        text.append(shown(worst.name))
        if worst.worst is not None:
            text.append(" ")
            text.append(level_text(worst.worst))
    text.append(f"   {rank_counts(state.ranks)}", style="not bold")
    if state.silenced:
        text.append(f"   {state.silenced} silenced", style="not bold")
    return text


def fleet_lines(state: FleetState, width: int, room: int, shown: Callable[[str], str]) -> List[Text]:
    """Returns the lines of the table.

    Args:
        state: what to show.
        width: width of the terminal in cells.
        room: most lines to return.
        shown: makes a text from outside fit for the terminal.
    """
    layout = _Layout(state, width, shown)
    blocks = [layout.robot(robot) for robot in state.robots]
    further = [[layout.signal(status) for status in robot.others] for robot in state.robots]
    hidden = sum(max(0, robot.alarms - 1) for robot in state.robots)
    room = max(1, room - 1)  # the header
    needed = sum(map(len, blocks)) + sum(len(signal) for of_robot in further for signal in of_robot)
    if needed > room or len(blocks) < state.total or sum(map(len, further)) < hidden:
        room -= 1  # for what does not fit
    fitting, used = 0, 0
    for block in blocks:
        if used + len(block) > room and fitting:
            break
        fitting, used = fitting + 1, used + len(block)
    hidden = sum(max(0, robot.alarms - 1) for robot in state.robots[:fitting])
    lines = [layout.header()]
    for block, signals in zip(blocks[:fitting], further):
        lines.extend(block)
        for signal in signals:
            if used + len(signal) > room:
                break
            used, hidden = used + len(signal), hidden - 1
            lines.extend(signal)
    more = []
    if fitting < state.total:
        more.append(f"{count_text(state.total - fitting, 'more robot')}: {rank_counts(state.ranks[fitting:])}")
    if hidden:
        more.append(f"{count_text(hidden, 'more signal')} not OK")
    if more:
        lines.append(Text(f"and {'; '.join(more)}", style="dim"))
        lines[-1].truncate(width, overflow="ellipsis")
    return lines


class _Layout:
    """Which columns fit, and how a row is divided into lines."""

    def __init__(self, state: FleetState, width: int, shown: Callable[[str], str]) -> None:
        self._width = width
        self._shown = shown
        statuses = [status for robot in state.robots for status in (robot.worst, *robot.others) if status is not None]
        names = [cell_len(shown(robot.name)) for robot in state.robots]
        signals = [cell_len(shown(status.name)) for status in statuses]
        self._robot = min(max([5, *names]), max(_WIDEST_ROBOT, width // 4))
        self._signal = min(max([6, *signals]), _WIDEST_SIGNAL)
        self._level = max([7, *(cell_len(level_text(status).plain) for status in statuses)])
        self._since = 8
        if self._room() < _MIN_REASON:
            self._robot = min(self._robot, _NARROW_NAME)
            self._signal = min(self._signal, _NARROW_NAME)
            self._since = 5
        if self._room() < 0:
            self._robot = min(self._robot, _NARROWEST_NAME)
            self._signal = 0  # before the reason
        self._beside = self._room() >= _MIN_REASON

    def header(self) -> Text:
        """Returns the line with the names of the columns."""
        reason = "reason" if self._beside else ""
        return self._line(Text("robot"), Text("level"), "since", "signal", reason, "bold")

    def robot(self, robot: RobotState) -> List[Text]:
        """Returns the lines of a robot: its worst signal."""
        name = Text(self._shown(robot.name), style="bold" if robot.rank > 1 else "")
        if robot.worst is None:
            level = Text("OK", style="green") if robot.rank == 0 else Text("waiting", style="cyan")
            reason = "" if robot.rank == 0 else "no connection yet"
            return self._lines(name, level, "", "", reason)
        return self._row(name, robot.worst)

    def signal(self, status: Status) -> List[Text]:
        """Returns the lines of a further signal of the robot above."""
        return self._row(Text(""), status)

    def _row(self, name: Text, status: Status) -> List[Text]:
        reason = self._shown(reason_text(status))
        return self._lines(name, level_text(status), self._since_text(status), self._shown(status.name), reason)

    def _lines(self, robot: Text, level: Text, since: str, signal: str, reason: str) -> List[Text]:
        if self._beside:
            parts = wrapped(reason, self._room())
            indent = " " * (self._width - self._room())
            return [self._line(robot, level, since, signal, parts[0]), *(Text(indent + part) for part in parts[1:])]
        if signal and not self._signal:
            reason = f"{signal}: {reason}"
        parts = [part for part in wrapped(reason, self._width - len(INDENT)) if part]
        return [self._line(robot, level, since, signal, ""), *(Text(INDENT + part) for part in parts)]

    def _line(self, robot: Text, level: Text, since: str, signal: str, reason: str, style: str = "") -> Text:
        cells = [(robot, self._robot), (level, self._level), (Text(since), self._since)]
        cells += [(Text(signal), self._signal)] if self._signal else []
        return cells_line(cells, self._width, reason, style)

    def _room(self) -> int:
        """Returns the cells that are left for the reason."""
        return self._width - (self._robot + self._level + self._since + self._signal + 4 * GAP)

    def _since_text(self, status: Status) -> str:
        """Returns since when a level lasts, as local time; the date if that was more than a day ago."""
        if rank(status) == 0:
            return ""
        lasts_s = status.lasts_s
        form = "%b %d" if lasts_s >= _DAY_S else "%H:%M:%S" if self._since >= 8 else "%H:%M"
        return local_time(max(0.0, time.time() - lasts_s), form)
