"""The live tables: of one robot, a row per signal; of several, a row per robot with its worst signal.

A reason is never cut off: other columns give way, and it continues on further lines. Rows that do not fit are counted.
"""

from __future__ import annotations

import time
from itertools import accumulate
from typing import Callable, Iterable, List, NamedTuple, Optional, Sequence, Tuple, Union

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


class Row(NamedTuple):
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


class View(NamedTuple):
    """What is shown of one robot or of several, read at one moment."""

    title: Text
    further: str
    """Follows the title where there is room."""
    head: Row
    rows: Sequence[Row]
    """In the order in which they are shown. There may be none: then nothing is watched."""
    rest: Callable[[Sequence[int]], str]
    """Returns what is not shown if these rows are: `3 more: 3 OK`; empty if everything is."""


def table_lines(view: View, width: int, room: int, shown: Escape) -> List[Text]:
    """Returns a table of at most `room` lines of at most `width` cells, at least one row; of its rows the worst.

    `shown` is for texts from outside.
    """
    if not view.rows:
        return list(Text(_NOTHING).wrap(_CONSOLE, width))
    layout = _Layout([view.head, *view.rows], width, shown)
    header = layout.block(view.head)[0]
    header.stylize("bold")
    blocks = list(map(layout.block, view.rows))
    chosen = list(range(len(blocks)))
    if 1 + sum(map(len, blocks)) > room or view.rest(chosen):
        order = sorted(chosen, key=lambda at: -view.rows[at].rank)
        ends = accumulate(len(blocks[at]) for at in order)
        chosen = sorted(at for at, end in zip(order, ends) if at == order[0] or 2 + end <= room)
    lines = [header, *(line for at in chosen for line in blocks[at])]
    rest = view.rest(chosen)
    if rest:
        lines.append(Text(f"and {rest}", style="dim"))
        lines[-1].truncate(width, overflow="ellipsis")
    return lines


class _Layout:
    """Which columns of a table fit, and how a row is divided into lines of at most `width` cells."""

    def __init__(self, rows: Sequence[Row], width: int, shown: Escape) -> None:
        self._width = width
        self._shown = shown
        columns = list(zip(*([self._text(cell) for cell in row.cells] for row in rows)))
        widest_name = max(_NARROWEST_NAME, 2 * width // (3 * len(columns)))
        self._widths = [min(_widest(column), width if at == 1 else widest_name) for at, column in enumerate(columns)]
        self._indent = sum(self._widths) + _GAP * len(columns)
        self._reason = width - self._indent
        self._more: List[int] = []
        self._is_narrow = self._reason < _NARROWEST_REASON
        if self._is_narrow:
            self._indent, self._reason = _GAP, width - _GAP
            return
        # Further columns, if there is room beside the widest reason.
        reason = _widest(shown(row.reason) for row in rows)
        spare, widths = self._reason - reason, []
        for at, column in enumerate(zip(*(row.more for row in rows))):
            spare -= _widest(column) + _GAP if any(column[1:]) else 0
            if any(column[1:]) and spare >= 0:
                self._more.append(at)
                widths.append(_widest(column))
        self._widths += [reason if widths else self._reason, *widths]

    def block(self, row: Row) -> List[Text]:
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


def short_bounds(config: SignalConfig) -> str:
    """Returns the bounds of a signal: `WARN < 20, ERROR < 10`; comparisons are strict."""
    parts = ((name.partition("_"), bound) for name, bound in config.bounds.items())
    return ", ".join(
        f"{level.upper()} {'<' if side == 'below' else '>'} {bound_text(bound)}" for (level, _, side), bound in parts
    )


def robot_view(
    robot: str,
    signals: Sequence[Tuple[Status, str, Sequence[float]]],
    system_health: Optional[float],
    shown: Escape,
    bars: bool = True,
) -> View:
    """Returns what is shown of one robot, with a row for each of its signals.

    `signals` has their statuses, bounds as `short_bounds` returns them, and trends: the latest values, the oldest
    first, NaN where there was none. `bars` draws trends, which need UTF-8. A link that is up takes no line.
    """
    names = {status.name for status, _, _ in signals}
    rows = [
        Row(
            rank(status),
            (status.name, level_text(status)),
            _reason(status),
            more=(bounds, _bars(trend) if bars else "", *(_statistic(status, name) for name in _STATISTICS)),
        )
        for status, bounds, trend in signals
        # Effects are counted at their cause.
        if status.cause not in names and (status.name != LINK or rank(status) > 0)
    ]
    title = Text(shown(robot), style="bold").append(" is ", style="not bold")
    statuses = [status for status, _, _ in signals]
    title.append(level_text(max(statuses, key=rank)) if rows else Text("not watched", style=_STYLE_OF_UNKNOWN))

    def rest(chosen: Sequence[int]) -> str:
        hidden = [row.rank for at, row in enumerate(rows) if at not in chosen]
        return f"{len(hidden)} more: {rank_counts(hidden)}" if hidden else ""

    head = Row(0, ("signal", "level"), "value", more=("bounds", "trend".ljust(TREND_SAMPLES), *_STATISTICS))
    further = "" if system_health is None else f"   system_health {system_health:.1f}"
    return View(title, further, head, rows, rest)


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


def fleet_view(fleet: Monitors, lines: int, shown: Escape) -> View:
    """Returns what is shown of several robots. Statuses are made only for what a terminal of `lines` lines can show."""
    systems = [robot.alert_system for robot in fleet.robots]
    levels = [
        {name: _rank_of(level, state) for name, (level, state) in system.monitor.levels().items()} for system in systems
    ]
    worst = [max(of_robot.values(), default=1) for of_robot in levels]
    order = sorted(range(len(systems)), key=lambda index: -worst[index])
    room = lines
    rows: List[Row] = []
    alarms: List[int] = []  # signals of each robot that are not OK, silent or invalid ones included, unknown ones not
    for index in order[:lines]:
        system, of_robot = systems[index], levels[index]
        # Effects are counted at their cause.
        judgements = system.monitor.judgements(fleet.robots[index].now_s) if worst[index] > 1 else {}
        effects = {name for name, judgement in judgements.items() if judgement.cause}
        names = sorted((name for name in of_robot if name not in effects), key=lambda name: -of_robot[name])
        alarms.append(sum(of_robot[name] > 1 for name in names))
        wanted = min(max(alarms[-1], 1), 1 + max(0, room)) if worst[index] > 0 else 0
        statuses = [status for status in map(system.announcements.status, names[:wanted]) if status is not None]
        room -= max(0, len(statuses) - 1)
        for number, status in enumerate(statuses):
            cells = ("" if number else system.robot, level_text(status), _since_text(status), status.name)
            rows.append(Row(int(number == 0), cells, _reason(status)))
        if not statuses:
            main = system.monitor.config.main_signals if worst[index] == 0 else ()
            values = [
                f"{each.name} {each.message}" for each in map(system.announcements.status, main) if each is not None
            ]
            level = Text("waiting", _STYLE_OF_UNKNOWN) if worst[index] else Text("OK", STYLE_OF_LEVEL[Level.OK])
            rows.append(Row(1, (system.robot, level, "", ""), "no connection yet" if worst[index] else "", values))
    ranks = [worst[index] for index in order]

    def rest(chosen: Sequence[int]) -> str:
        count = sum(rows[at].rank for at in chosen)
        hidden = sum(max(0, number - 1) for number in alarms[:count]) - (len(chosen) - count)
        robots = f"{count_text(len(systems) - count, 'more robot')}: {rank_counts(ranks[count:])}"
        signals = f"{count_text(hidden, 'more signal')} not OK"
        return "; ".join([*([robots] if count < len(systems) else []), *([signals] if hidden else [])])

    title = Text(f"{len(systems)} robots", style="bold")
    if ranks and ranks[0] > 0:
        title.append(", worst: ", style="not bold").append(shown(systems[order[0]].robot))
        if rows[0].cells[3]:
            title.append(" ").append(rows[0].cells[1])
    title.append(f"   {rank_counts(ranks)}", style="not bold")
    silenced = sum(
        rank > 1 and system.silence_of(name) is not None
        for system, of_robot in zip(systems, levels)
        for name, rank in of_robot.items()
    )
    if silenced:
        title.append(f"   {silenced} silenced", style="not bold")
    return View(title, "", Row(0, ("robot", "level", "since", "signal"), "reason"), rows, rest)


def _since_text(status: Status) -> str:
    """Returns since when a level lasts, as local time; the date if that was more than a day ago."""
    form = "%H:%M:%S" if status.lasts_s < _DAY_S else "%b %d"
    return "" if rank(status) == 0 else local_time(max(0.0, time.time() - status.lasts_s), form)
