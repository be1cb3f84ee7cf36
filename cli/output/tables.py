"""The live tables: of one robot, a row per signal; of several, a row per robot with its worst signal.

A reason is never cut off: other columns give way, and it continues on further lines. Rows that do not fit are counted.
"""

from __future__ import annotations

import time
from typing import Callable, List, Mapping, NamedTuple, Sequence, Union

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ...core.config.signal_config import LINK, OF_ARRIVALS, SignalConfig
from ...core.judge.wording import bounds_text
from ...core.values.formatting import with_hint
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

_STATISTICS = ("mean", "min", "max")
_NOTHING = "no signal is watched: run `robot-health init`"
_GAP = 2
"""Blanks between columns."""
_NARROWEST_NAME = 10
_UNLIMITED = 10_000
"""A width in which every table has room."""
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


def _reason(status: Status) -> str:
    outlook = f", {status.outlook}" if status.outlook else ""
    affects = f" (+ {status.affects} affected)" if status.affects else ""
    return with_hint(f"{status.message}{outlook}", status.hint) + affects


class Row(NamedTuple):
    """A row of a table."""

    cells: Sequence[Union[str, Text]]
    """Of the first columns."""
    reason: str
    more: Sequence[str] = ()
    """Of further columns, which are shown where there is room."""


class View(NamedTuple):
    """What is shown of one robot or of several, read at one moment."""

    title: Text
    head: Row
    rows: Sequence[Row]
    """In the order in which they are shown. There may be none: then nothing is watched."""
    ranks: Sequence[int]
    """The rank of each row, and of what there is beyond them: the greatest are shown where there is no room for all."""


def draw(view: View, console: Console, room: int, shown: Escape) -> None:
    """Writes a table of at most `room` lines, and of at least one row; of its rows the worst.

    `shown` is for texts from outside.
    """
    if not view.rows:
        console.print(Text(_NOTHING))
        return
    order = sorted(range(len(view.rows)), key=lambda at: -view.ranks[at])
    count, height = min(len(order), room), room + 1
    while height > room:
        table = _table(view, sorted(order[:count]), console, shown)
        hidden = [rank for at, rank in enumerate(view.ranks) if at not in order[:count]]
        height = len(console.render_lines(table)) + bool(hidden)
        if count == 1:
            break
        count = max(1, min(count - 1, count * room // height))
    console.print(table)
    if hidden:
        text = Text(f"and {len(hidden):,} more: {rank_counts(hidden)}", style="dim")
        console.print(text, no_wrap=True, overflow="ellipsis")


def _table(view: View, places: Sequence[int], console: Console, shown: Escape) -> Table:
    """Returns the table of some of the rows, with as many of the further columns as there is room for."""
    widest_name = max(_NARROWEST_NAME, 2 * console.width // (3 * len(view.head.cells)))
    further = [at for at in range(len(view.head.more)) if any(row.more[at] for row in view.rows)]
    for more in (further[:count] for count in range(len(further), -1, -1)):
        table = Table(box=None, padding=(0, _GAP, 0, 0), pad_edge=False, header_style="bold")
        for head in view.head.cells:
            table.add_column(head, no_wrap=True, max_width=widest_name)
        table.add_column(view.head.reason, overflow="fold")
        for at in more:
            table.add_column(view.head.more[at], no_wrap=True)
        for row in (view.rows[at] for at in places):
            cells = (*row.cells, row.reason, *(row.more[at] for at in more))
            table.add_row(*(Text(shown(cell)) if isinstance(cell, str) else cell for cell in cells))
        if console.measure(table, options=console.options.update(width=_UNLIMITED)).maximum <= console.width:
            break
    return table


def robot_view(robot: str, signals: Sequence[Status], configs: Mapping[str, SignalConfig], shown: Escape) -> View:
    """Returns what is shown of one robot, with a row for each of its signals. A link that is up takes no line."""
    names = {status.name for status in signals}
    # Effects are counted at their cause.
    listed = [each for each in signals if each.cause not in names and (each.name != LINK or rank(each) > 0)]
    rows = []
    for status in listed:
        bounds = bounds_text(configs[status.name]) if status.name in configs else ""
        statistics = (_statistic(status, name) for name in _STATISTICS)
        rows.append(Row((status.name, level_text(status)), _reason(status), (bounds, *statistics)))
    title = Text(shown(robot), style="bold").append(" is ", style="not bold")
    title.append(level_text(max(signals, key=rank)) if rows else Text("not watched", style=_STYLE_OF_UNKNOWN))
    head = Row(("signal", "level"), "value", ("bounds", *_STATISTICS))
    return View(title, head, rows, list(map(rank, listed)))


def _statistic(status: Status, name: str) -> str:
    """Returns a statistic of the values; empty if there is none, or the values mean nothing."""
    return "" if status.values.get("statistic") in OF_ARRIVALS else status.values.get(name, "")


def fleet_view(fleet: Monitors, lines: int, shown: Escape) -> View:
    """Returns what is shown of several robots, with the worst signal of each.

    Statuses are made only for what a terminal of `lines` lines can show.
    """
    systems = [robot.alert_system for robot in fleet.robots]
    levels = [
        {name: _rank_of(level, state) for name, (level, state) in system.monitor.levels().items()} for system in systems
    ]
    worst = [max(of_robot.values(), default=1) for of_robot in levels]
    order = sorted(range(len(systems)), key=lambda index: -worst[index])
    rows: List[Row] = []
    for index in order[:lines]:
        system, of_robot = systems[index], levels[index]
        # Effects are counted at their cause.
        judgements = system.monitor.judgements(fleet.robots[index].now_s) if worst[index] > 1 else {}
        effects = {name for name, judgement in judgements.items() if judgement.cause}
        names = sorted((each for each in of_robot if each not in effects), key=lambda each: -of_robot[each])
        name, *others = names or [""]
        status = system.announcements.status(name) if worst[index] else None
        if status is not None:
            more = sum(of_robot[each] > 1 for each in others)
            reason = f"{name} {_reason(status)}" + (f" (+ {more} more)" if more else "")
            rows.append(Row((system.robot, level_text(status), _since_text(status)), reason))
        elif worst[index]:
            rows.append(Row((system.robot, Text("waiting", _STYLE_OF_UNKNOWN), ""), "no connection yet"))
        else:
            main = map(system.announcements.status, system.monitor.config.main_signals)
            values = ", ".join(f"{each.name} {each.message}" for each in main if each is not None)
            rows.append(Row((system.robot, Text("OK", STYLE_OF_LEVEL[Level.OK]), ""), values))
    ranks = [worst[index] for index in order]
    title = Text(f"{len(systems)} robots", style="bold")
    if ranks and ranks[0] > 0:
        title.append(f", worst: {shown(systems[order[0]].robot)} ", style="not bold").append(rows[0].cells[1])
    title.append(f"   {rank_counts(ranks)}", style="not bold")
    silenced = sum(system.announcements.count_silenced() for system in systems)
    if silenced:
        title.append(f"   {silenced} silenced", style="not bold")
    return View(title, Row(("robot", "level", "since"), "reason"), rows, ranks)


def _since_text(status: Status) -> str:
    """Returns since when a level lasts, as local time; the date if that was more than a day ago."""
    form = "%H:%M:%S" if status.lasts_s < _DAY_S else "%b %d"
    return "" if rank(status) == 0 else local_time(max(0.0, time.time() - status.lasts_s), form)
