"""How what a history has is written: in lines, in JSON, in rows of a CSV file. The notes on an alert follow it."""

from __future__ import annotations

import argparse
import csv
import json
import math
import sqlite3
import sys
from typing import Any, Iterable, Iterator, Mapping, NamedTuple, Sequence, TextIO, Union

from ...core.nodes.outlets import json_line
from ...core.values import (
    ConfigError,
    JsonObject,
    count_text,
    duration_text,
    list_text,
    number_text,
    printable,
    with_hint,
)
from ...ops.report.summaries import SummaryRow, share_text
from ...ops.store import queries
from ...ops.store.notes import Note, notes_of
from ...ops.store.queries import MonitorEvent
from ...ops.store.rows import StoredTransition
from ...ops.store.silences import SilenceEvent
from ...ops.store.summary import SignalSummary
from ...runtime.times import DATE_TIME, iso_time, local_time
from ..output.lines import readable

CSV_HEAD = (
    "id", "time", "robot", "signal", "from_level", "to_level", "value", "statistic", "bound", "repeat", "fingerprint",
    "text", "hint", "event", "matchers", "author", "reason", "until", "cause", "effects",
)  # fmt: skip
_MOST_NAMES = 3
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


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

    json: Iterable[JsonObject]
    head: Sequence[str]
    """Names of the columns of `rows`; others are left out."""
    rows: Iterable[Mapping[str, object]]
    lines: Iterable[str]
    nothing: str = ""
    """Written to stderr if there are no lines."""

    def write(self, stream: TextIO, form: str) -> None:
        """Writes the form `json`, `csv` or `lines`."""
        if form == "json":
            stream.writelines(f"{json.dumps(each)}\n" for each in self.json)
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


def entry_lines(entry: Entry) -> Iterator[str]:
    """Yields an entry in lines."""
    if not isinstance(entry, NotedAlert):
        yield f"{time_text(entry.wall_s)} {printable(event_text(entry))}"
        return
    alert = entry.transition
    yield printable(f"{time_text(alert.wall_s)} #{alert.id} {alert.robot}: {with_hint(alert.text, alert.hint)}")
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


def summary_row(summary: SignalSummary, **figures: str) -> SummaryRow:
    """Returns what a table shows of a signal, with `figures` of its samples."""
    available, outage_s, recover_s = summary.availability, summary.longest_outage_s, summary.mean_time_to_recover_s
    figures["available"] = "-" if available is None else share_text(available)
    figures["longest outage"] = duration_text(outage_s) if outage_s > 0.0 else "none"
    figures["recovery"] = "-" if recover_s is None else duration_text(recover_s)
    shares, unknown = summary.shares, summary.unknown
    return SummaryRow(summary.signal, summary.robot, summary.cause, shares, unknown, summary.alerts, figures)


def entry_fields(entry: NotedAlert | SilenceEvent, **more: object) -> dict[str, Any]:
    """Returns an entry as the fields of a JSON object; `more` are further fields of an alert."""
    if isinstance(entry, NotedAlert):
        alert = entry.transition
        notes = [{"time": iso_time(note.wall_s), "author": note.author, "text": note.text} for note in entry.notes]
        own = {"id": alert.id, "alert_id": alert.alert_id, "time": iso_time(alert.wall_s), "effects": alert.effects}
        fields: dict[str, Any] = json.loads(json_line(alert, **own, notes=notes, **more))
        return fields
    silence = entry.silence
    author, reason = _author_and_reason(entry)
    return {
        "id": silence.id,
        "time": iso_time(entry.wall_s),
        "text": _silence_text(entry),
        "event": f"silence {entry.kind}",
        "matchers": silence.matchers,
        "author": author,
        "reason": reason,
        "until": None if silence.until_s is None else iso_time(silence.until_s),
        "until_resolved": silence.until_resolved,
        **({"every": silence.every, "timezone": silence.timezone} if silence.every else {}),
    }


def entry_rows(entry: NotedAlert | SilenceEvent) -> Iterator[dict[str, Any]]:
    """Yields the rows of an entry, with columns of `CSV_HEAD` and others."""
    fields = entry_fields(entry)
    if not isinstance(entry, NotedAlert):
        yield fields
        return
    value, effects = entry.transition.value, ", ".join(fields["effects"])
    yield {**fields, "event": "alert", "value": value, "effects": effects}
    for note in fields["notes"]:
        yield {**{name: fields[name] for name in ("id", "robot", "signal")}, "event": "note", **note}


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
        text += f", {silence.end_text}"
    return f"{text} ({reason})" if reason else text


def _author_and_reason(event: SilenceEvent) -> tuple[str, str]:
    """Returns who caused an event of a silence, and why."""
    silence = event.silence
    is_begin = event.kind == "added"
    return (silence.author, silence.reason) if is_begin else (silence.ended_by, silence.ended_reason)


def event_text(event: MonitorEvent | SilenceEvent) -> str:
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
    line, *notes = entry_lines(alert)
    statistics = [
        f"{name} {'undefined' if value is None else number_text(value)}"
        for name, value in transition.statistics.items()
    ]
    lines = [line, printable(f"  {count_text(len(samples), 'sample')} stored; {', '.join(statistics)}")]
    lines += [f"  {each}" for each in notes]
    lines += [f"  {local_time(time_s)} {number_text(value)}" for time_s, value in samples]
    head = ("time", "value")
    return Listing([entry_fields(alert, evidence=evidence)], head, [dict(zip(head, each)) for each in times], lines)
