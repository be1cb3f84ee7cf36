"""The live tables: of one robot, a row per signal; of several, a row per robot with its worst signal.

A row is one line: what has no room ends with an ellipsis, and bounds and statistics are shown where there is room.
Rows that do not fit are counted.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Mapping, NamedTuple, Sequence

from rich.console import Console, Group
from rich.table import Table
from rich.text import Text

from ...core.config import LINK, OF_ARRIVALS, SignalConfig
from ...core.judge import bounds_text
from ...core.values import Level, Status, printable, with_hint
from ...runtime.times import local_time
from .lines import Monitors, readable

if TYPE_CHECKING:
    from ...core.nodes import AlertSystem

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
_UNLIMITED = 10_000
"""A width in which every table has room."""
_OTHER_LINES = 4
"""Title, heads, the line that counts what is not shown, and one for alerts."""


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


class View(NamedTuple):
    """What is shown of one robot or of several, read at one moment."""

    title: Text
    heads: Sequence[str]
    columns: int
    """How many columns are shown where there is no room for all."""
    rows: Sequence[tuple[int, Sequence[str | Text]]]
    """Rank and cells of each, in the order in which they are shown. There are none if nothing is watched."""
    further: Sequence[int] = ()
    """The ranks of what has no row."""


def drawn(view: View, console: Console) -> Group:
    """Returns the title and the table, which fit on the terminal: of the rows the worst, and at least one."""
    width, height = console.size
    view.title.no_wrap, view.title.overflow = True, "ellipsis"
    if not view.rows:
        return Group(view.title, Text(_NOTHING))
    stream: Any = console.file
    room = max(1, height - _OTHER_LINES)
    places = sorted(range(len(view.rows)), key=lambda at: -view.rows[at][0])
    for columns in (len(view.heads), view.columns):
        table = Table(*view.heads[:columns], box=None, padding=(0, 2, 0, 0), pad_edge=False, header_style="bold")
        for at in sorted(places[:room]):
            cells = view.rows[at][1][:columns]
            texts = (printable(readable(cell, stream)) if isinstance(cell, str) else cell for cell in cells)
            table.add_row(*(Text("", no_wrap=True, overflow="ellipsis").append(text) for text in texts))
        if console.measure(table, options=console.options.update(width=_UNLIMITED)).maximum <= width:
            break
    hidden = [*(view.rows[at][0] for at in places[room:]), *view.further]
    more = [Text(f"and {len(hidden):,} more: {rank_counts(hidden)}", style="dim")] if hidden else []
    return Group(view.title, table, *more)


def robot_view(robot: str, signals: Sequence[Status], configs: Mapping[str, SignalConfig]) -> View:
    """Returns what is shown of one robot, with a row for each of its signals. A link that is up takes no line."""
    names = {status.name for status in signals}
    rows: list[tuple[int, Sequence[str | Text]]] = []
    for status in signals:
        # Effects are counted at their cause.
        if status.cause in names or (status.name == LINK and rank(status) == 0):
            continue
        bounds = bounds_text(configs[status.name]) if status.name in configs else ""
        # Those of arrivals mean nothing.
        values = {} if status.values.get("statistic") in OF_ARRIVALS else status.values
        statistics = (values.get(name, "") for name in _STATISTICS)
        rows.append((rank(status), (status.name, level_text(status), _reason(status), bounds, *statistics)))
    title = Text(printable(robot), style="bold").append(" is ", style="not bold")
    title.append(level_text(max(signals, key=rank)) if rows else Text("not watched", style=_STYLE_OF_UNKNOWN))
    return View(title, ("signal", "level", "value", "bounds", *_STATISTICS), 3, rows)


def fleet_view(fleet: Monitors, lines: int) -> View:
    """Returns what is shown of several robots, with the worst signal of each, the worst robot first.

    Statuses are made only for what a terminal of `lines` lines can show.
    """
    robots = fleet.alert_systems
    worst = [max((_rank_of(*each) for each in system.monitor.levels().values()), default=1) for system in robots]
    order = sorted(range(len(robots)), key=lambda at: -worst[at])
    ranks = [worst[at] for at in order]
    rows = [(worst[at], (robots[at].robot, *_robot_cells(robots[at], worst[at]))) for at in order[:lines]]
    title = Text(f"{len(robots)} robots", style="bold")
    if ranks and ranks[0] > 0:
        name, level, *_ = rows[0][1]
        title.append(f", worst: {printable(str(name))} ", style="not bold").append(level)
    title.append(f"   {rank_counts(ranks)}", style="not bold")
    silenced = sum(system.announcements.count_silenced() for system in robots)
    if silenced:
        title.append(f"   {silenced} silenced", style="not bold")
    return View(title, ("robot", "level", "since", "reason"), 4, rows, ranks[lines:])


def _robot_cells(system: AlertSystem, worst: int) -> Sequence[str | Text]:
    """Returns level, since when, and reason of the worst signal of a robot, or the main values of one that is OK."""
    names = system.monitor.levels() if worst else system.monitor.config.main_signals
    known = [each for each in map(system.announcements.status, names) if each is not None]
    if not worst:
        return Text("OK", STYLE_OF_LEVEL[Level.OK]), "", ", ".join(f"{each.name} {each.message}" for each in known)
    causes = [each for each in known if not each.cause]  # effects are counted at their cause
    if not causes:
        return Text("waiting", _STYLE_OF_UNKNOWN), "", "no connection yet"
    status = max(causes, key=rank)
    more = sum(rank(each) > 1 for each in causes if each is not status)
    reason = f"{status.name} {_reason(status)}" + (f" (+ {more} more)" if more else "")
    since = "" if rank(status) == 0 else local_time(max(0.0, time.time() - status.lasts_s), "%b %d %H:%M")
    return level_text(status), since, reason
