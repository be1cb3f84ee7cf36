"""How what a history has is written: in lines, in JSON, in rows of a CSV file. The notes on an alert follow it."""

from __future__ import annotations

import json
import os
from typing import Dict, Iterator, List, NamedTuple, Sequence, TextIO, Tuple, Union

from ...core.nodes.outlets import json_line
from ...core.values.formatting import duration_text, list_text, printable, with_hint
from ...core.values.model import Level
from ...ops.store.notes import Note
from ...ops.store.queries import MonitorEvent
from ...ops.store.rows import StoredTransition
from ...ops.store.silences import SilenceEvent
from ...ops.store.summary import SignalSummary
from ...runtime.times import DATE_TIME, local_time
from ..output.lines import is_terminal, share_text
from .history_file import iso_time

CSV_HEAD = (
    "id", "time", "robot", "signal", "from_level", "to_level", "value", "statistic", "bound", "repeat", "fingerprint",
    "text", "hint", "event", "matchers", "author", "reason", "until", "cause", "effects",
)  # fmt: skip
_COLOURS = {Level.OK: "32", Level.WARN: "33", Level.ERROR: "1;31", Level.STALE: "35"}
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


Entry = Union[NotedAlert, MonitorEvent, SilenceEvent]


def is_coloured(stream: TextIO) -> bool:
    """Whether lines on a stream have colours."""
    return is_terminal(stream) and "NO_COLOR" not in os.environ


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
    yield f"\x1b[{_COLOURS[alert.to_level]}m{text}\x1b[0m" if with_colour else text
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


def entry_rows(entry: Union[NotedAlert, SilenceEvent]) -> Iterator[List[object]]:
    """Yields the rows of an entry, with the columns of `CSV_HEAD`."""
    if isinstance(entry, NotedAlert):
        alert = entry.transition
        yield _row(
            alert.id, iso_time(alert.wall_s), alert.robot, alert.signal, alert.from_level.name, alert.to_level.name,
            alert.value, alert.statistic, alert.bound, alert.repeat, alert.fingerprint, alert.text, alert.hint,
            "alert", *[""] * 4, alert.cause, ", ".join(alert.effects),
        )  # fmt: skip
        for note in entry.notes:
            names = (alert.robot, alert.signal)
            yield _row(
                alert.id, iso_time(note.wall_s), *names, *[""] * 7, note.text, "", "note", "", note.author, *[""] * 4
            )
    else:
        text, *further = _silence_fields(entry).values()
        yield _row(entry.silence.id, iso_time(entry.wall_s), *[""] * 9, text, "", *further, "", "")


def _row(*values: object) -> List[object]:
    return [csv_cell(value) for value in values]


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
