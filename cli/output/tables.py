"""The live tables: of one robot, a row per signal; of several, a row per robot with its worst signal.

A reason is never cut off: other columns give way, and it continues on further lines. Rows that do not fit are counted.
"""

from __future__ import annotations

import time
from typing import Callable, Iterable, List, NamedTuple, Optional, Sequence, Tuple

from rich.cells import cell_len, chop_cells
from rich.text import Text

from ...core.config.signal_config import LINK, OF_ARRIVALS, SignalConfig
from ...core.values.formatting import bound_text, count_text, with_hint
from ...core.values.model import Level, Status
from ...runtime.times import local_time
from .lines import Shown

STYLE_OF_LEVEL = {
    Level.OK: "green",
    Level.WARN: "black on bright_yellow",  # readable on a dark and on a light terminal
    Level.ERROR: "bold red",
    Level.STALE: "magenta",
}
_STYLE_OF_UNKNOWN = "cyan"
_RANKS = ((6, "ERROR"), (4, "STALE"), (2, "WARN"), (1, "unknown"), (0, "OK"))
UNKNOWN_STATES = ("waiting", "unreachable")
"""States in which the level is not known: neither OK nor an alarm."""

_BARS = "▁▂▃▄▅▆▇█"
TREND_SAMPLES = 16
"""Width of the trend, in samples and in cells."""
_STATISTICS = ("mean", "min", "max")
_NOTHING = "no signal is watched: run `robot-health init`"
_GAP = 2
"""Blanks between columns."""
_INDENT = "  "
"""Before a text that has a line to itself."""
_MOST_LINES = 6
_WIDEST_ROBOT, _WIDEST_SIGNAL = 20, 24
_NARROW_NAME, _NARROWEST_NAME = 14, 10
_MIN_REASON, _MIN_FLEET_REASON = 16, 28
"""Narrowest column for the reason, in cells; in less room it has separate lines."""
_DAY_S = 86_400.0

Escape = Callable[[str], str]
"""Makes a text from outside fit for the terminal."""


def rank(status: Status) -> int:
    """Orders statuses from OK (0) to the worst; an unknown one is above OK and below every alarm."""
    return _rank_of(status.level, status.state)


def _rank_of(level: Level, state: str) -> int:
    return 1 if state in UNKNOWN_STATES else 2 * level.severity


def rank_counts(ranks: Sequence[int]) -> str:
    """Returns how many there are of each rank: `2 ERROR, 198 OK`."""
    counts = [(ranks.count(number), name) for number, name in _RANKS]
    return ", ".join(f"{count} {name}" for count, name in counts if count)


def level_text(status: Status) -> Text:
    """Returns the level, or the state while the level is not known; says if an alert is silenced."""
    is_unknown = status.state in UNKNOWN_STATES
    text = Text(status.state if is_unknown else status.level.name)
    text.stylize(_STYLE_OF_UNKNOWN if is_unknown else STYLE_OF_LEVEL[status.level])
    return text.append(" silenced") if status.silence is not None and rank(status) > 1 else text


def cells_line(cells: Sequence[Tuple[Text, int]], width: int, rest: str = "", style: str = "") -> Text:
    """Returns one line: each text padded or shortened to its width, then `rest`; at most `width` cells."""
    line = Text(style=style)
    for cell, cell_width in cells:
        cell.truncate(cell_width, overflow="ellipsis", pad=True)
        line.append_text(cell)
        line.append(" " * _GAP)
    line.append(rest)
    line.rstrip()
    line.truncate(width)
    return line


def wrapped(text: str, width: int) -> List[str]:
    """Divides a text at blanks into parts of at most `width` cells; at least one part, and at most six."""
    parts: List[str] = [""]
    for word in text.split(" "):
        for piece in chop_cells(word, max(1, width)) or [""]:
            joined = f"{parts[-1]} {piece}" if parts[-1] else piece
            if cell_len(joined) <= width:
                parts[-1] = joined
            else:
                parts.append(piece)
    return parts if len(parts) <= _MOST_LINES else [*parts[: _MOST_LINES - 1], "..."]


def _reason(status: Status, shown: Escape) -> str:
    outlook = f", {status.outlook}" if status.outlook else ""
    affects = f" (+ {status.affects} affected)" if status.affects else ""
    return shown(with_hint(f"{status.message}{outlook}", status.hint)) + affects


def _fitting(blocks: Iterable[Sequence[Text]], room: int) -> int:
    """Returns how many blocks of lines fit into `room` lines, at least one."""
    fitting = used = 0
    for block in blocks:
        used += len(block)
        if used > room and fitting:
            break
        fitting += 1
    return fitting


def _remainder(text: str, width: int) -> Text:
    """Returns the last line, which counts what does not fit."""
    line = Text(f"and {text}", style="dim")
    line.truncate(width, overflow="ellipsis")
    return line


class SignalRow(NamedTuple):
    """What is shown of one signal."""

    status: Status
    bounds: str
    """As `short_bounds` returns them."""
    trend: Sequence[float]
    """The latest values, the oldest first; NaN where there was none."""


def short_bounds(config: SignalConfig) -> str:
    """Returns the bounds of a signal: `WARN < 20, ERROR < 10`; comparisons are strict."""
    parts = ((name.partition("_"), bound) for name, bound in config.bounds.items())
    return ", ".join(
        f"{level.upper()} {'<' if side == 'below' else '>'} {bound_text(bound)}" for (level, _, side), bound in parts
    )


def watches_nothing(rows: Sequence[SignalRow]) -> bool:
    """Whether no signal is watched; a link that is up is none."""
    return all(row.status.name == LINK and rank(row.status) == 0 for row in rows)


def signal_lines(rows: Sequence[SignalRow], width: int, room: int, shown: Escape, bars: bool = True) -> List[Text]:
    """Returns the lines of the table of one robot: at most `room`, of at most `width` cells.

    The signals are in the order of `rows`, but the worst come first if not all fit. A link that is up takes no line.
    `bars` draws trends, which need UTF-8.
    """
    if watches_nothing(rows):
        return [Text(part) for part in wrapped(_NOTHING, width)]
    names = {row.status.name for row in rows}
    # Effects are counted at their cause.
    rows = [row for row in rows if row.status.cause not in names and (row.status.name != LINK or rank(row.status) > 0)]
    columns = _SignalColumns(rows, width, shown, bars)
    blocks = [(rank(row.status), columns.row(row)) for row in rows]
    room = max(2, room) - 1  # the header
    hidden: List[int] = []
    if sum(len(block) for _, block in blocks) > room:
        blocks.sort(key=lambda block: -block[0])
        fitting = _fitting((block for _, block in blocks), room - 1)
        hidden = [number for number, _ in blocks[fitting:]]
        blocks = blocks[:fitting]
    lines = [columns.header(), *(line for _, block in blocks for line in block)]
    return [*lines, _remainder(f"{len(hidden)} more: {rank_counts(hidden)}", width)] if hidden else lines


class _SignalColumns:
    """Which columns fit: reasons first, then bounds, trend, statistics."""

    def __init__(self, rows: Sequence[SignalRow], width: int, shown: Escape, bars: bool) -> None:
        self._width = width
        self._shown = shown
        self._name = min(
            _widest("signal", (shown(row.status.name) for row in rows)), _WIDEST_SIGNAL, max(8, width // 3)
        )
        self._level = _widest("level", (level_text(row.status).plain for row in rows))
        self._reason = width - self._name - self._level - 2 * _GAP
        self._beside = self._reason >= _MIN_REASON
        self._bounds = self._trend = 0
        self._statistics: List[int] = []
        if not self._beside:
            self._reason = width - len(_INDENT)
            return
        reasons = _widest("value", (_reason(row.status, shown) for row in rows))
        spare = self._reason - reasons - _GAP
        # A reason that is not OK names the bound: it may take the column of the bounds.
        values = _widest("value", (_reason(row.status, shown) for row in rows if rank(row.status) == 0))
        bounds = _widest("", (row.bounds for row in rows))
        both = max(reasons, values + _GAP + bounds)
        if bounds and both <= self._reason:
            self._value, self._bounds, spare = values, both - values - _GAP, self._reason - both - _GAP
        else:
            self._value = min(reasons, self._reason)
        if bars and any(row.trend for row in rows) and spare >= TREND_SAMPLES:
            self._trend, spare = TREND_SAMPLES, spare - TREND_SAMPLES - _GAP
            widths = [_widest(name, (_statistic(row.status, name) for row in rows)) for name in _STATISTICS]
            if spare >= sum(widths) + _GAP * (len(widths) - 1):
                self._statistics = widths

    def header(self) -> Text:
        cells = [(Text("signal"), self._name), (Text("level"), self._level)]
        if self._beside:
            cells.append((Text("value"), self._value))
            cells += [(Text("bounds"), self._bounds)] if self._bounds else []
            cells += [(Text(name), width) for name, width in zip(_STATISTICS, self._statistics)]
            cells += [(Text("trend"), self._trend)] if self._trend else []
        return cells_line(cells, self._width, style="bold")

    def row(self, row: SignalRow) -> List[Text]:
        """Returns the lines of a signal."""
        reason = _reason(row.status, self._shown)
        cells = [(Text(self._shown(row.status.name)), self._name), (level_text(row.status), self._level)]
        if not self._beside:
            return [cells_line(cells, self._width), *(Text(_INDENT + part) for part in wrapped(reason, self._reason))]
        parts = [""]
        if rank(row.status) == 0 and self._bounds:
            cells += [(Text(reason), self._value), (Text(row.bounds, style="dim"), self._bounds)]
        else:
            width = self._value + (_GAP + self._bounds if self._bounds else 0)
            parts = wrapped(reason, width)
            cells.append((Text(parts[0]), width))
        for name, width in zip(_STATISTICS, self._statistics):
            cells.append((Text(self._shown(_statistic(row.status, name) or "-")), width))
        if self._trend:
            cells.append((Text(_bars(row.trend)), self._trend))
        indent = " " * (self._name + self._level + 2 * _GAP)
        return [cells_line(cells, self._width), *(Text(indent + part) for part in parts[1:])]


def _statistic(status: Status, name: str) -> str:
    """Returns a statistic of the values; empty if there is none, or the values mean nothing."""
    return "" if status.values.get("statistic") in OF_ARRIVALS else status.values.get(name, "")


def _widest(header: str, texts: Iterable[str]) -> int:
    return max([cell_len(header), *(cell_len(text) for text in texts)])


def _bars(values: Sequence[float]) -> str:
    """Draws values between their own extremes; a blank where there was none."""
    known = [value for value in values if value == value]
    if not known:
        return ""
    low, span = min(known), max(known) - min(known)
    top = len(_BARS) - 1
    return "".join(
        " " if value != value else _BARS[round((value - low) / span * top) if span > 0.0 else top // 2]
        for value in values
    )


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
    main: Sequence[Status]
    """Statuses of its main signals; none unless it is OK."""


class FleetState(NamedTuple):
    """What the table of several robots shows, read at one moment."""

    robots: Sequence[RobotState]
    """The worst first; as many as could be shown."""
    total: int
    """Number of all robots."""
    ranks: Sequence[int]
    """Ranks of all robots, in the order of `robots`."""
    silenced: int
    """Number of signals that are not OK and silenced."""


def fleet_state(shown: Shown, lines: int) -> FleetState:
    """Reads the state of all robots. Statuses are made only for what a terminal of `lines` lines can show."""
    systems = [robot.alert_system for robot in shown.robots]
    ranks = [
        {name: _rank_of(level, state) for name, (level, state) in system.monitor.levels().items()} for system in systems
    ]
    worst = [max(of_robot.values(), default=1) for of_robot in ranks]
    order = sorted(range(len(systems)), key=lambda index: -worst[index])
    room = lines
    robots: List[RobotState] = []
    for index in order[:lines]:
        monitor, of_robot = systems[index].monitor, ranks[index]
        # Effects are counted at their cause.
        judgements = monitor.judgements(shown.robots[index].now_s) if worst[index] > 1 else {}
        effects = {name for name, judgement in judgements.items() if judgement.cause}
        names = sorted((name for name in of_robot if name not in effects), key=lambda name: -of_robot[name])
        alarms = sum(of_robot[name] > 1 for name in names)
        wanted = min(max(alarms, 1), 1 + max(0, room)) if worst[index] > 0 else 0
        found = (systems[index].status(name) for name in names[:wanted])
        statuses = [status for status in found if status is not None]
        first = statuses.pop(0) if statuses else None
        room -= len(statuses)
        main = monitor.config.main_signals if worst[index] == 0 else ()
        values = [status for status in map(systems[index].status, main) if status is not None]
        robots.append(RobotState(systems[index].robot, worst[index], first, alarms, statuses, values))
    silenced = sum(
        rank > 1 and system.silence_of(name) is not None
        for system, of_robot in zip(systems, ranks)
        for name, rank in of_robot.items()
    )
    return FleetState(robots, len(systems), [worst[index] for index in order], silenced)


def fleet_summary(state: FleetState, shown: Escape) -> Text:
    """Returns how many robots have which level, and which robot is the worst."""
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


def fleet_lines(state: FleetState, width: int, room: int, shown: Escape) -> List[Text]:
    """Returns the lines of the table of several robots: at most `room`, of at most `width` cells."""
    columns = _FleetColumns(state, width, shown)
    blocks = [columns.robot(robot) for robot in state.robots]
    further = [[columns.signal(Text(), status) for status in robot.others] for robot in state.robots]
    others = [max(0, robot.alarms - 1) for robot in state.robots]
    room = max(1, room - 1)  # the header
    needed = sum(map(len, blocks)) + sum(len(signal) for signals in further for signal in signals)
    if needed > room or len(blocks) < state.total or sum(map(len, further)) < sum(others):
        room -= 1  # for what does not fit
    fitting = _fitting(blocks, room)
    used, hidden = sum(map(len, blocks[:fitting])), sum(others[:fitting])
    lines = [columns.header()]
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
    return [*lines, _remainder("; ".join(more), width)] if more else lines


class _FleetColumns:
    """Which columns fit, and how a row is divided into lines."""

    def __init__(self, state: FleetState, width: int, shown: Escape) -> None:
        self._width = width
        self._shown = shown
        statuses = [status for robot in state.robots for status in (robot.worst, *robot.others) if status is not None]
        robots = _widest("robot", (shown(robot.name) for robot in state.robots))
        self._robot = min(robots, max(_WIDEST_ROBOT, width // 4))
        self._signal = min(_widest("signal", (shown(status.name) for status in statuses)), _WIDEST_SIGNAL)
        self._level = _widest("waiting", (level_text(status).plain for status in statuses))
        self._since = 8
        if self._room() < _MIN_FLEET_REASON:
            self._robot = min(self._robot, _NARROW_NAME)
            self._signal = min(self._signal, _NARROW_NAME)
            self._since = 5
        if self._room() < 0:
            self._robot = min(self._robot, _NARROWEST_NAME)
            self._signal = 0  # before the reason
        self._beside = self._room() >= _MIN_FLEET_REASON

    def header(self) -> Text:
        return self._line(Text("robot"), Text("level"), "since", "signal", "reason" if self._beside else "", "bold")

    def robot(self, robot: RobotState) -> List[Text]:
        """Returns the lines of a robot: its worst signal."""
        name = Text(self._shown(robot.name), style="bold" if robot.rank > 1 else "")
        if robot.worst is not None:
            return self.signal(name, robot.worst)
        if robot.rank == 0:
            return [self._line(name, Text("OK", style="green"), "", "", self._values(robot.main))]
        return self._lines(name, Text("waiting", style="cyan"), "", "", "no connection yet")

    def _values(self, main: Sequence[Status]) -> str:
        """Returns the main values of a robot that is OK, as many as fit into its line."""
        text = ""
        for status in main if self._beside else ():
            longer = f"{text}{', ' if text else ''}{self._shown(status.name)} {self._shown(status.message)}"
            if cell_len(longer) > self._room():
                break
            text = longer
        return text

    def signal(self, robot: Text, status: Status) -> List[Text]:
        """Returns the lines of a signal; `robot` is empty in those below the first one of a robot."""
        reason = _reason(status, self._shown)
        return self._lines(robot, level_text(status), self._since_text(status), self._shown(status.name), reason)

    def _lines(self, robot: Text, level: Text, since: str, signal: str, reason: str) -> List[Text]:
        if self._beside:
            parts = wrapped(reason, self._room())
            indent = " " * (self._width - self._room())
            return [self._line(robot, level, since, signal, parts[0]), *(Text(indent + part) for part in parts[1:])]
        if signal and not self._signal:
            reason = f"{signal}: {reason}"
        parts = [part for part in wrapped(reason, self._width - len(_INDENT)) if part]
        return [self._line(robot, level, since, signal, ""), *(Text(_INDENT + part) for part in parts)]

    def _line(self, robot: Text, level: Text, since: str, signal: str, reason: str, style: str = "") -> Text:
        cells = [(robot, self._robot), (level, self._level), (Text(since), self._since)]
        cells += [(Text(signal), self._signal)] if self._signal else []
        return cells_line(cells, self._width, reason, style)

    def _room(self) -> int:
        """Returns the cells that are left for the reason."""
        return self._width - (self._robot + self._level + self._since + self._signal + 4 * _GAP)

    def _since_text(self, status: Status) -> str:
        """Returns since when a level lasts, as local time; the date if that was more than a day ago."""
        if rank(status) == 0:
            return ""
        form = "%H:%M:%S" if self._since >= 8 else "%H:%M"
        if status.lasts_s >= _DAY_S:
            form = "%b %d"
        return local_time(max(0.0, time.time() - status.lasts_s), form)
