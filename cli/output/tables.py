"""The live tables: of one robot, a row per signal; of several, a row per robot with its worst signal.

A reason is never cut off: other columns give way, and it continues on further lines. Rows that do not fit are counted.
"""

from __future__ import annotations

import time
from itertools import accumulate
from typing import Callable, Iterable, List, NamedTuple, Optional, Sequence, Union

from rich.cells import cell_len
from rich.console import Console
from rich.text import Text

from ...core.config.signal_config import LINK, OF_ARRIVALS, SignalConfig
from ...core.values.formatting import bound_text, count_text, with_hint
from ...core.values.model import Level, Status
from ...runtime.times import local_time
from .lines import Monitors

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
"""Blanks between columns, and before a reason that has lines to itself."""
_MOST_LINES = 6
_NARROWEST_NAME = 10
_NARROWEST_REASON = 16
"""In cells; in less room the reason has separate lines."""
_DAY_S = 86_400.0

_CONSOLE = Console()

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


def _reason(status: Status) -> str:
    outlook = f", {status.outlook}" if status.outlook else ""
    affects = f" (+ {status.affects} affected)" if status.affects else ""
    return with_hint(f"{status.message}{outlook}", status.hint) + affects


def _widest(texts: Iterable[Union[str, Text]]) -> int:
    return max(cell_len(str(text)) for text in texts)


class _Row(NamedTuple):
    """A row of a table."""

    rank: int
    """What is shown first where there is no room for all."""
    cells: Sequence[Union[str, Text]]
    """Of the first columns. A narrow terminal shows two of them, and the fourth before the reason."""
    reason: str
    values: Sequence[str] = ()
    """In place of a reason, in one line: as many as fit."""
    more: Sequence[str] = ()
    """Of further columns, which are shown where there is room."""


class _Table:
    """A table that is fitted to `width` cells and `room` lines; `shown` is for texts from outside."""

    def __init__(self, head: _Row, rows: Sequence[_Row], width: int, room: int, shown: Escape) -> None:
        self._width = width
        self._shown = shown
        columns = list(zip(*([self._text(cell) for cell in row.cells] for row in (head, *rows))))
        widest_name = max(_NARROWEST_NAME, 2 * width // (3 * len(columns)))
        self._widths = [min(_widest(column), width if at == 1 else widest_name) for at, column in enumerate(columns)]
        self._indent = sum(self._widths) + _GAP * len(columns)
        self._reason = width - self._indent
        self._more: List[int] = []
        self._is_narrow = self._reason < _NARROWEST_REASON
        if self._is_narrow:
            self._indent, self._reason = _GAP, width - _GAP
        else:
            self._add_further_columns([head, *rows])
        self._header = self._block(head)[:1]
        self._header[0].stylize("bold")
        self._blocks = list(map(self._block, rows))
        self.chosen = list(range(len(rows)))
        """Places of the rows that are shown: all in their order, or as many as fit of the highest ranks."""
        needed = 1
        if sum(map(len, self._blocks)) + needed > room:
            order = sorted(self.chosen, key=lambda at: -rows[at].rank)
            needed += 1  # for what does not fit
            ends = accumulate(len(self._blocks[at]) for at in order)
            self.chosen = [at for at, end in zip(order, ends) if at == order[0] or needed + end <= room]

    def lines(self, chosen: Iterable[int], rest: str) -> List[Text]:
        """Returns the lines of rows, and one that says what does not fit."""
        lines = [*self._header, *(line for at in chosen for line in self._blocks[at])]
        if rest:
            lines.append(Text(f"and {rest}", style="dim"))
            lines[-1].truncate(self._width, overflow="ellipsis")
        return lines

    def _add_further_columns(self, rows: Sequence[_Row]) -> None:
        """Adds the columns for which there is room beside the widest reason."""
        reason = _widest(self._shown(row.reason) for row in rows)
        spare, widths = self._reason - reason, []
        for at, column in enumerate(zip(*(row.more for row in rows))):
            spare -= _widest(column) + _GAP if any(column[1:]) else 0
            if any(column[1:]) and spare >= 0:
                self._more.append(at)
                widths.append(_widest(column))
        self._widths += [reason if widths else self._reason, *widths]

    def _block(self, row: _Row) -> List[Text]:
        """Returns the lines of a row."""
        cells = list(map(self._text, row.cells))
        if self._is_narrow:
            parts = self._wrapped(": ".join([*map(str, row.cells[3:]), row.reason])) if row.reason else []
        else:
            lists = (", ".join(row.values[:count]) for count in range(len(row.values), 0, -1))
            fitting = (text for text in lists if cell_len(self._shown(text)) <= self._reason)
            part, *parts = self._wrapped(row.reason or next(fitting, ""))
            cells += [Text(part), *(self._text(row.more[at]) for at in self._more)]
        line = Text()
        for cell, width in zip(cells, self._widths):
            cell.truncate(width, overflow="ellipsis", pad=True)
            line.append_text(cell).append(" " * _GAP)
        line.rstrip()
        line.truncate(self._width)
        return [line, *(Text(" " * self._indent + part) for part in parts)]

    def _text(self, cell: Union[str, Text]) -> Text:
        return Text(self._shown(cell)) if isinstance(cell, str) else cell.copy()

    def _wrapped(self, reason: str) -> List[str]:
        """Divides a reason at blanks into at least one part, and at most six."""
        parts = [part.plain.rstrip() for part in self._text(reason).wrap(_CONSOLE, self._reason, overflow="fold")]
        return parts if len(parts) <= _MOST_LINES else [*parts[: _MOST_LINES - 1], "..."]


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
        return list(Text(_NOTHING).wrap(_CONSOLE, width))
    names = {row.status.name for row in rows}
    table = [
        _Row(
            rank(status),
            (status.name, level_text(status)),
            _reason(status),
            more=(bounds, _bars(trend) if bars else "", *(_statistic(status, name) for name in _STATISTICS)),
        )
        for status, bounds, trend in rows
        # Effects are counted at their cause.
        if status.cause not in names and (status.name != LINK or rank(status) > 0)
    ]
    head = _Row(0, ("signal", "level"), "value", more=("bounds", "trend".ljust(TREND_SAMPLES), *_STATISTICS))
    fitted = _Table(head, table, width, room, shown)
    hidden = [row.rank for at, row in enumerate(table) if at not in fitted.chosen]
    return fitted.lines(fitted.chosen, f"{len(hidden)} more: {rank_counts(hidden)}" if hidden else "")


def _statistic(status: Status, name: str) -> str:
    """Returns a statistic of the values; empty if there is none, or the values mean nothing."""
    return "" if status.values.get("statistic") in OF_ARRIVALS else status.values.get(name, "")


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


def fleet_state(shown: Monitors, lines: int) -> FleetState:
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
    rows: List[_Row] = []
    for robot in state.robots:
        if robot.worst is None:
            level = Text("waiting", _STYLE_OF_UNKNOWN) if robot.rank else Text("OK", STYLE_OF_LEVEL[Level.OK])
            values = [f"{status.name} {status.message}" for status in robot.main]
            rows.append(_Row(1, (robot.name, level, "", ""), "no connection yet" if robot.rank else "", values))
            continue
        for number, status in enumerate((robot.worst, *robot.others)):
            cells = ("" if number else robot.name, level_text(status), _since_text(status), status.name)
            rows.append(_Row(int(number == 0), cells, _reason(status)))
    fitted = _Table(_Row(0, ("robot", "level", "since", "signal"), "reason"), rows, width, room, shown)
    count = sum(rows[at].rank for at in fitted.chosen)
    hidden = sum(max(0, robot.alarms - 1) for robot in state.robots[:count]) - (len(fitted.chosen) - count)
    rest = []
    if count < state.total:
        rest.append(f"{count_text(state.total - count, 'more robot')}: {rank_counts(state.ranks[count:])}")
    if hidden:
        rest.append(f"{count_text(hidden, 'more signal')} not OK")
    return fitted.lines(sorted(fitted.chosen), "; ".join(rest))


def _since_text(status: Status) -> str:
    """Returns since when a level lasts, as local time; the date if that was more than a day ago."""
    form = "%H:%M:%S" if status.lasts_s < _DAY_S else "%b %d"
    return "" if rank(status) == 0 else local_time(max(0.0, time.time() - status.lasts_s), form)
