"""How what a history has is written: in lines, in JSON, in rows of a CSV file. The notes on an alert follow it."""

from __future__ import annotations

import argparse
import csv
import json
import math
import shutil
import sqlite3
import sys
from typing import Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Sequence, TextIO, Tuple, Union

from ...core.nodes.outlets import json_line
from ...core.values.errors import ConfigError
from ...core.values.formatting import count_text, duration_text, list_text, number_text, printable, with_hint
from ...core.values.model import Level
from ...ops.store import queries
from ...ops.store.notes import Note, notes_of
from ...ops.store.queries import MonitorEvent
from ...ops.store.rows import StoredTransition
from ...ops.store.silences import SilenceEvent
from ...ops.store.summary import SignalSummary
from ...runtime.times import DATE_TIME, iso_time, local_time
from ..output.lines import COLOURS, coloured, is_coloured, readable, share_text

CSV_HEAD = (
    "id", "time", "robot", "signal", "from_level", "to_level", "value", "statistic", "bound", "repeat", "fingerprint",
    "text", "hint", "event", "matchers", "author", "reason", "until", "cause", "effects",
)  # fmt: skip
_MOST_NAMES = 3
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


_PLOT_COLUMNS = 100
_LEAST_PLOT_COLUMNS = 10
_PLOT_ROWS = 12


class NotedAlert(NamedTuple):
    """A transition with the notes on it."""

    transition: StoredTransition
    notes: Sequence[Note]

    @property
    def wall_s(self) -> float:
        """When it happened, in s since 1970."""
        return self.transition.wall_s


class Listing(NamedTuple):
    """What a command shows, in each of its forms, of which one is written."""

    json: Iterable[str]
    head: Sequence[str]
    """Names of the columns of `rows`; others are left out."""
    rows: Iterable[Mapping[str, object]]
    lines: Iterable[str]
    nothing: str = ""
    """Written to stderr if there are no lines."""

    def write(self, stream: TextIO, form: str) -> None:
        """Writes the form `json`, `csv` or `lines`."""
        if form == "json":
            stream.writelines(f"{line}\n" for line in self.json)
        elif form == "csv":
            writer = csv.DictWriter(stream, self.head, "", "ignore", lineterminator="\n")
            writer.writeheader()
            writer.writerows({name: csv_cell(value) for name, value in row.items()} for row in self.rows)
        else:
            line = self.nothing
            for line in self.lines:
                stream.write(readable(f"{line}\n", stream))
            if line is self.nothing and line:
                sys.stderr.write(f"{line}\n")


Entry = Union[NotedAlert, MonitorEvent, SilenceEvent]


def time_text(wall_s: float) -> str:
    """Returns a wall time in the local time zone, with its offset from UTC."""
    return local_time(wall_s, f"{DATE_TIME} %z")


def entry_lines(entry: Entry, with_colour: bool) -> Iterator[str]:
    """Yields an entry in lines; with colours, the line of an alert has that of its new level."""
    if not isinstance(entry, NotedAlert):
        yield f"{time_text(entry.wall_s)} {printable(event_text(entry))}"
        return
    alert = entry.transition
    text = printable(f"{time_text(alert.wall_s)} #{alert.id} {alert.robot}: {with_hint(alert.text, alert.hint)}")
    yield coloured(text, COLOURS[alert.to_level]) if with_colour else text
    if alert.effects:
        yield printable(f"{time_text(alert.wall_s)} #{alert.id} {effects_text(alert.effects)}")
    for note in entry.notes:
        yield f"{time_text(note.wall_s)} #{alert.id} {_note_text(note)}"


def note_text(note: Note) -> str:
    """Returns a note on one line, with its local time."""
    return f"{local_time(note.wall_s)} {_note_text(note)}"


def _note_text(note: Note) -> str:
    return f"note{f' by {note.author}' if note.author else ''}: {note.text}"


def effects_text(effects: Sequence[str]) -> str:
    """Returns what an alert kept from being announced: `6 affected: left, right, lift and 3 more`."""
    return f"{len(effects)} affected: {list_text(effects, _MOST_NAMES)}"


def outage_cells(summary: SignalSummary) -> Tuple[str, str, str]:
    """Returns availability, longest outage and mean time to recover of a signal, as texts."""
    available, recover_s = summary.availability, summary.mean_time_to_recover_s
    return (
        "-" if available is None else share_text(available),
        duration_text(summary.longest_outage_s) if summary.longest_outage_s > 0.0 else "none",
        "-" if recover_s is None else duration_text(recover_s),
    )


def entry_json(entry: Union[NotedAlert, SilenceEvent], **more: object) -> str:
    """Returns an entry as one JSON object; `more`: further fields of an alert."""
    if isinstance(entry, NotedAlert):
        alert = entry.transition
        notes = [{"time": iso_time(note.wall_s), "author": note.author, "text": note.text} for note in entry.notes]
        own = {"id": alert.id, "alert_id": alert.alert_id, "time": iso_time(alert.wall_s), "effects": alert.effects}
        return json_line(alert, **own, notes=notes, **more)
    fields = {"id": entry.silence.id, "time": iso_time(entry.wall_s), **_silence_fields(entry)}
    every = entry.silence.every
    rule = {"every": every, "timezone": entry.silence.timezone} if every else {}
    return json.dumps({**fields, "until_resolved": entry.silence.until_resolved, **rule})


def entry_rows(entry: Union[NotedAlert, SilenceEvent]) -> Iterator[Dict[str, object]]:
    """Yields the rows of an entry, with columns of `CSV_HEAD` and others."""
    if isinstance(entry, NotedAlert):
        alert = entry.transition
        levels = {"from_level": alert.from_level.name, "to_level": alert.to_level.name}
        own = {"event": "alert", "effects": ", ".join(alert.effects)}
        yield {**alert._asdict(), "time": iso_time(alert.wall_s), **levels, **own}
        for note in entry.notes:
            names = {"id": alert.id, "robot": alert.robot, "signal": alert.signal}
            time = iso_time(note.wall_s)
            yield {**names, "time": time, "event": "note", "author": note.author, "text": note.text}
    else:
        yield {"id": entry.silence.id, "time": iso_time(entry.wall_s), **_silence_fields(entry)}


def csv_cell(value: object) -> object:
    """Returns a value of a cell; a text that a spreadsheet would run as a formula gets an apostrophe before it."""
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if value.startswith(_FORMULA) else text


def _silence_text(event: SilenceEvent) -> str:
    silence = event.silence
    author, reason = _author_and_reason(event)
    text = f"silence {silence.id} {event.kind}{f' by {author}' if author else ''}: {silence.matchers}"
    if event.kind == "added":
        text += f", {silence.end_text(time_text)}"
    return f"{text} ({reason})" if reason else text


def _author_and_reason(event: SilenceEvent) -> Tuple[str, str]:
    """Returns who caused an event of a silence, and why."""
    silence = event.silence
    is_begin = event.kind == "added"
    return (silence.author, silence.reason) if is_begin else (silence.ended_by, silence.ended_reason)


def _silence_fields(event: SilenceEvent) -> Dict[str, object]:
    author, reason = _author_and_reason(event)
    until_s = event.silence.until_s
    return {
        "text": _silence_text(event),
        "event": f"silence {event.kind}",
        "matchers": event.silence.matchers,
        "author": author,
        "reason": reason,
        "until": None if until_s is None else iso_time(until_s),
    }


def event_text(event: Union[MonitorEvent, SilenceEvent]) -> str:
    """Returns an event in words, without its time."""
    if isinstance(event, SilenceEvent):
        return _silence_text(event)
    return {
        "started": f"monitor started (version {event.detail})",
        "stopped": "monitor stopped",
        "killed": "monitor ended without stopping (killed, or a power cut)",
        "reset": f"{event.robot}: latched alerts reset",
        "configuration": f"{event.robot}: configuration {event.detail[:12]} in force",
    }[event.kind]


def alert_listing(connection: sqlite3.Connection, arguments: argparse.Namespace) -> Listing:
    """Returns one alert; raises ConfigError if there is none."""
    transition = queries.transition(connection, arguments.alert)
    if transition is None:
        raise ConfigError(f"there is no transition {arguments.alert} in this history")
    alert = NotedAlert(transition, notes_of(connection, transition.id))
    samples = queries.evidence(connection, transition.id)
    times = [(iso_time(time_s), value) for time_s, value in samples]
    evidence = [(time, value if math.isfinite(value) else None) for time, value in times]
    line, *notes = entry_lines(alert, is_coloured(sys.stdout))
    lines = [line, *(f"  {name}: {printable(value)}" for name, value in _details(transition, samples))]
    lines += [f"  {each}" for each in notes]
    if samples:
        width = min(shutil.get_terminal_size().columns, _PLOT_COLUMNS)
        bound = transition.bound if transition.statistic in ("last", "mean", "min", "max", "forecast") else None
        lines += text_plot(samples, bound, width)
    head = ("time", "value")
    return Listing([entry_json(alert, evidence=evidence)], head, [dict(zip(head, each)) for each in times], lines)


def _details(transition: StoredTransition, samples: Sequence[object]) -> List[Tuple[str, str]]:
    statistics = ", ".join(
        f"{name} {'undefined' if value is None else number_text(value)}"
        for name, value in transition.statistics.items()
    )
    bound = "none" if transition.bound is None else f"{number_text(transition.bound)} (on {transition.statistic})"
    count = f"{count_text(len(samples), 'sample')} stored"
    lasted_s = transition.now_s - transition.since_s
    never_known = transition.from_level is Level.OK and lasted_s <= 0.0
    level = "unknown" if never_known else f"{transition.from_level.name} for {duration_text(lasted_s)}"
    return [("level before", level), ("bound", bound), ("window", f"{count}; {statistics}" if statistics else count)]


def text_plot(samples: Sequence[Tuple[float, float]], bound: Optional[float], width: int) -> List[str]:
    """Returns a plot: `*` for samples, `-` for the bound, `x` below the axis for values that are no numbers.

    Every column shows the range of its samples (wall time in s since 1970, and value), so that no extreme is lost.
    Lines have at most `width` characters.
    """
    values = [value for _, value in samples if math.isfinite(value)]
    if not values:
        return ["no samples that are numbers"]
    shown = values if bound is None else [*values, bound]
    low, high = min(shown), max(shown)
    bound_row = None if bound is None else _plot_row(bound, low, high)
    labels = {0: number_text(high), _PLOT_ROWS - 1: number_text(low)}
    if bound is not None and bound_row is not None:
        labels[bound_row] = number_text(bound)
    margin = max(map(len, labels.values()))
    columns = max(_LEAST_PLOT_COLUMNS, width - margin - 2)
    grid = [["-" if row == bound_row else " "] * columns for row in range(_PLOT_ROWS)]
    bad = [" "] * columns
    first_s, last_s = samples[0][0], samples[-1][0]
    span_s = last_s - first_s
    found: Dict[int, List[float]] = {}
    for time_s, value in samples:
        share = (time_s - first_s) / span_s if span_s > 0.0 else 0.0
        found.setdefault(round(min(max(share, 0.0), 1.0) * (columns - 1)), []).append(value)
    for column, of_column in found.items():
        numbers = [value for value in of_column if math.isfinite(value)]
        if len(numbers) < len(of_column):
            bad[column] = "x"
        if numbers:
            for row in range(_plot_row(max(numbers), low, high), _plot_row(min(numbers), low, high) + 1):
                grid[row][column] = "*"
    lines = [f"{labels.get(row, ''):>{margin}} |{''.join(cells)}".rstrip() for row, cells in enumerate(grid)]
    axis = " " * margin + " +"
    lines.append(axis + "".join("-" if mark == " " else mark for mark in bad))
    begin, end = local_time(first_s, "%H:%M:%S"), local_time(last_s, "%H:%M:%S")
    has_room = columns > len(begin) + len(end)
    lines.append(" " * len(axis) + begin + (end.rjust(columns - len(begin)) if has_room else ""))
    return lines


def _plot_row(value: float, low: float, high: float) -> int:
    """Returns the row of a value, 0 at the top. It halves before it subtracts: the range may exceed a float's."""
    if high <= low:
        return _PLOT_ROWS // 2
    share = (value / 2.0 - low / 2.0) / (high / 2.0 - low / 2.0)
    return _PLOT_ROWS - 1 - round(share * (_PLOT_ROWS - 1))
