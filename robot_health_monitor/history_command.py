"""`robot-health history`: past alerts and silences, from a history file."""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import re
import shutil
import sqlite3
import sys
import time
from datetime import datetime
from typing import Any, Dict, Iterator, List, Optional, Sequence, TextIO, Tuple, TypeVar, Union

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import count_text, duration_text, number_text, printable, with_hint
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.outlets import json_line
from robot_health_monitor.ops.history import queries
from robot_health_monitor.ops.history import samples as stored_samples
from robot_health_monitor.ops.history.queries import MonitorEvent
from robot_health_monitor.ops.history.rows import StoredTransition
from robot_health_monitor.ops.history.samples import SAMPLES_FIELDS, StoredSamples, samples_fields
from robot_health_monitor.ops.history.summary import SignalSummary, summarize
from robot_health_monitor.ops.matchers import matchers_text
from robot_health_monitor.ops.silences import SilenceEvent, silence_events
from robot_health_monitor.runtime.interrupts import Interrupts
from robot_health_monitor.runtime.times import DATE_TIME, local_time

from .arguments import Parser, identifier
from .exit_codes import ExitCode
from .history_file import DEFAULT_FILE, history_file, iso_time, reading_history
from .output.lines import is_terminal, plain_table, readable, share_text

_LEVELS = (Level.OK, Level.WARN, Level.ERROR, Level.STALE)
_COLOURS = {Level.OK: "32", Level.WARN: "33", Level.ERROR: "1;31", Level.STALE: "35"}
_CSV_HEAD = (
    "id", "time", "robot", "signal", "from_level", "to_level", "value", "statistic", "bound", "repeat", "fingerprint",
    "text", "hint", "event", "matchers", "author", "reason", "until",
)  # fmt: skip
Event = Union[MonitorEvent, SilenceEvent]
AnyEvent = TypeVar("AnyEvent", bound=Event)

_SUMMARY_HEAD = ("robot", "signal", *(level.name for level in _LEVELS), "unknown", "alerts", "longest outage")
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_PLOT_COLUMNS = 100
_LEAST_PLOT_COLUMNS = 10
_PLOT_ROWS = 12
_UNITS_S = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86_400.0, "w": 604_800.0}


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Shows the alerts in a history file, with starts and stops of the monitor, resets and changes of "
        "the configuration. The monitor may be running."
    )
    parser.add_argument(
        "file", metavar="FILE", nargs="?", help=f"the history file (default: named by --ops, else {DEFAULT_FILE})"
    )
    parser.add_argument("--ops", metavar="FILE", help="an ops.yaml that names the history")
    parser.add_argument(
        "--since",
        dest="since_s",
        metavar="TIME",
        type=_moment,
        help="only what is newer: 90s, 1h30m, 24h, 7d, or a local time such as 2026-11-22T08:00",
    )
    parser.add_argument("--robot", metavar="R", help="only this robot; * and ? as in file names")
    parser.add_argument("--signal", metavar="S", help="only this signal; * and ? as in file names")
    parser.add_argument(
        "--level", metavar="L", type=_level, help="only transitions to this level: OK, WARN, ERROR or STALE"
    )
    content = parser.add_mutually_exclusive_group()
    content.add_argument(
        "--summary", action="store_true", help="per signal: share of time per level, alerts, longest time not OK"
    )
    content.add_argument(
        "--samples",
        action="store_true",
        help="per 10 s (after two days: 5 min): smallest, largest, mean and last value, samples, worst level",
    )
    content.add_argument("--alert", metavar="ID", type=_number, help="one transition, with a plot of its samples")
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="one JSON object per line")
    form.add_argument("--csv", action="store_true", help="comma-separated values")


def _moment(text: str) -> float:
    """Returns a time in s since 1970: so long ago, or a date and time by ISO 8601."""
    parts = re.findall(r"(\d{1,9}(?:\.\d{1,9})?)(min|[smhdw])", text, re.ASCII)
    if parts and "".join(number + unit for number, unit in parts) == text:
        return time.time() - sum(float(number) * _UNITS_S[unit] for number, unit in parts)
    try:
        return datetime.fromisoformat(text).timestamp()
    except (ValueError, OverflowError, OSError):
        raise argparse.ArgumentTypeError(
            f"expected a duration such as 24h or a time such as 2026-11-22T08:00, got {text!r}"
        ) from None


def _level(text: str) -> str:
    if text.upper() not in Level.__members__:
        raise argparse.ArgumentTypeError(f"expected OK, WARN, ERROR or STALE, got {text!r}")
    return text.upper()


def _number(text: str) -> int:
    return identifier(text[text.startswith("#") :], "the number of a transition")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Prints what a history file contains; returns the exit code."""
    show_history(arguments)
    return ExitCode.SUCCESS


def show_history(arguments: argparse.Namespace, stream: Optional[TextIO] = None) -> None:
    """Prints what a history file contains to a stream; None: stdout.

    Raises:
        ConfigError: the file does not exist, cannot be read, or is no history.
    """
    stream = stream or sys.stdout
    show = _show_summary if arguments.summary else _show_samples if arguments.samples else _show_transitions
    if arguments.alert is not None:
        show = _show_alert
    with reading_history(history_file(arguments.file, arguments.ops)) as connection:
        try:
            show(connection, arguments, stream)
        finally:
            stream.flush()


def time_text(wall_s: float) -> str:
    """Returns a wall time in the local time zone, with its offset from UTC."""
    return local_time(wall_s, f"{DATE_TIME} %z")


def _show_transitions(connection: sqlite3.Connection, arguments: argparse.Namespace, stream: TextIO) -> None:
    level = None if arguments.level is None else Level[arguments.level]
    transitions = queries.transitions(
        connection, since_s=arguments.since_s, robot=arguments.robot, signal=arguments.signal, level=level
    )
    silences: List[SilenceEvent] = []
    if level is None:
        since_s = arguments.since_s or 0.0
        silences = silence_events(connection, time.time(), since_s, arguments.robot, arguments.signal)
    if arguments.json:
        for item in _merged(transitions, silences):
            stream.write(f"{_json_line(item)}\n")
    elif arguments.csv:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(_CSV_HEAD)
        for item in _merged(transitions, silences):
            writer.writerow(_csv_row(item))
    else:
        events: List[Event] = [*silences]
        if arguments.signal is None and level is None:
            events += queries.monitor_events(connection, arguments.since_s or 0.0, arguments.robot)
            events.sort(key=lambda event: event.wall_s)
        is_coloured = _is_coloured(stream)
        count = 0
        for entry in _merged(transitions, events):
            count += 1
            stream.write(readable(f"{_line(entry, is_coloured)}\n", stream))
        if not count:
            sys.stderr.write("no alerts\n")


def _merged(
    transitions: Iterator[StoredTransition], events: Sequence[AnyEvent]
) -> Iterator[Union[StoredTransition, AnyEvent]]:
    """Yields transitions in their order, and each event before those that are younger."""
    place = 0
    for transition in transitions:
        while place < len(events) and events[place].wall_s <= transition.wall_s:
            yield events[place]
            place += 1
        yield transition
    yield from events[place:]


def _line(item: Union[StoredTransition, Event], is_coloured: bool) -> str:
    if not isinstance(item, StoredTransition):
        text = _event_text(item) if isinstance(item, MonitorEvent) else _silence_text(item)
        return f"{time_text(item.wall_s)} {printable(text)}"
    line = with_hint(item.text, item.hint)
    text = printable(f"{time_text(item.wall_s)} #{item.id} {item.robot}: {line}")
    return f"\x1b[{_COLOURS[item.to_level]}m{text}\x1b[0m" if is_coloured else text


def _silence_text(event: SilenceEvent) -> str:
    silence = event.silence
    author, reason = _author_and_reason(event)
    text = f"silence {silence.id} {event.kind}{f' by {author}' if author else ''}: {matchers_text(silence.matchers)}"
    if event.kind == "added":
        text += f", {silence.end_text(time_text)}"
    return f"{text} ({reason})" if reason else text


def _author_and_reason(event: SilenceEvent) -> Tuple[str, str]:
    """Returns who caused an event of a silence, and why."""
    silence = event.silence
    is_begin = event.kind == "added"
    return (silence.author, silence.reason) if is_begin else (silence.ended_by, silence.ended_reason)


def _event_text(event: MonitorEvent) -> str:
    return {
        "started": f"monitor started (version {event.detail})",
        "stopped": "monitor stopped",
        "killed": "monitor ended without stopping (killed, or a power cut)",
        "reset": f"{event.robot}: latched alerts reset",
        "configuration": f"{event.robot}: configuration {event.detail[:12]} in force",
    }[event.kind]


def _json_line(item: Union[StoredTransition, SilenceEvent]) -> str:
    if isinstance(item, StoredTransition):
        return json_line(item, id=item.id, time=iso_time(item.wall_s))
    fields = {"id": item.silence.id, "time": iso_time(item.wall_s), **_silence_fields(item)}
    return json.dumps({**fields, "until_resolved": item.silence.until_resolved})


def _silence_fields(event: SilenceEvent) -> Dict[str, object]:
    author, reason = _author_and_reason(event)
    until_s = event.silence.until_s
    return {
        "text": _silence_text(event),
        "event": f"silence {event.kind}",
        "matchers": matchers_text(event.silence.matchers),
        "author": author,
        "reason": reason,
        "until": None if until_s is None else iso_time(until_s),
    }


def _csv_row(item: Union[StoredTransition, SilenceEvent]) -> List[object]:
    row: Tuple[object, ...]
    if isinstance(item, StoredTransition):
        row = (
            item.id, iso_time(item.wall_s), item.robot, item.signal, item.from_level.name, item.to_level.name,
            item.value, item.statistic, item.bound, item.repeat, item.fingerprint, item.text, item.hint,
            "alert", *[""] * 4,
        )  # fmt: skip
    else:
        text, *further = _silence_fields(item).values()
        row = (item.silence.id, iso_time(item.wall_s), *[""] * 9, text, "", *further)
    return [_csv_cell(value) for value in row]


def _csv_cell(value: object) -> object:
    """Returns a value of a cell; a text that a spreadsheet would run as a formula gets an apostrophe before it."""
    if not isinstance(value, str):
        return value
    text = printable(value)
    return f"'{text}" if value.startswith(_FORMULA) else text


def _show_summary(connection: sqlite3.Connection, arguments: argparse.Namespace, stream: TextIO) -> None:
    end_s = connection.execute("SELECT max(coalesce(stopped_s, alive_s)) FROM runs").fetchone()[0]
    if end_s is None:
        end_s = time.time()
    summaries = summarize(connection, end_s, since_s=arguments.since_s, robot=arguments.robot, signal=arguments.signal)
    if arguments.json:
        for summary in summaries:
            stream.write(f"{json.dumps(_summary_fields(summary))}\n")
        return
    rows = [_summary_cells(summary) for summary in summaries]
    if arguments.csv:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(_SUMMARY_HEAD)
        writer.writerows([[_csv_cell(cell) for cell in row] for row in rows])
        return
    if not rows:
        if arguments.robot is None and arguments.signal is None:
            sys.stderr.write(f"the monitor did not run in this time; it last ran at {time_text(end_s)}\n")
        else:
            sys.stderr.write("no signal matches\n")
        return
    begin_s = end_s - max(summary.duration_s for summary in summaries)
    stream.write(f"{time_text(begin_s)} to {time_text(end_s)}\n")
    for line in plain_table([_SUMMARY_HEAD, *rows], 2):
        stream.write(f"{line}\n")


def _summary_fields(summary: SignalSummary) -> Dict[str, Any]:
    return {
        "robot": summary.robot,
        "signal": summary.signal,
        "duration_s": summary.duration_s,
        "shares": {level.name: summary.shares.get(level, 0.0) for level in _LEVELS},
        "unknown": summary.unknown,
        "alerts": summary.alerts,
        "longest_outage_s": summary.longest_outage_s,
    }


def _summary_cells(summary: SignalSummary) -> List[str]:
    shares = [share_text(summary.shares.get(level, 0.0)) for level in _LEVELS]
    outage = duration_text(summary.longest_outage_s) if summary.longest_outage_s > 0.0 else "none"
    return [summary.robot, summary.signal, *shares, share_text(summary.unknown), str(summary.alerts), outage]


def _show_samples(connection: sqlite3.Connection, arguments: argparse.Namespace, stream: TextIO) -> None:
    found = stored_samples.read(connection, robot=arguments.robot, signal=arguments.signal, since_s=arguments.since_s)
    chosen = (each for each in found if arguments.level in (None, each.level.name))
    if arguments.json:
        stream.writelines(f"{json.dumps(samples_fields(each))}\n" for each in chosen)
        return
    if arguments.csv:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(SAMPLES_FIELDS)
        writer.writerows([_csv_cell(value) for value in samples_fields(each).values()] for each in chosen)
        return
    name = None
    for each in chosen:
        if name != (each.robot, each.signal):
            name = each.robot, each.signal
            stream.write(readable(f"{printable(f'{each.robot}: {each.signal}')}\n", stream))
        stream.write(f"  {_samples_line(each)}\n")
    if name is None:
        sys.stderr.write("no samples\n")


def _samples_line(samples: StoredSamples) -> str:
    numbers = [("min", samples.least), ("max", samples.most), ("mean", samples.mean), ("last", samples.last)]
    values = " ".join(f"{label} {number_text(value)}" for label, value in numbers if value is not None)
    counts = count_text(samples.good, "sample") + (f", {samples.bad} bad" if samples.bad else "")
    begin = local_time(samples.start_s, DATE_TIME)
    return f"{begin} {samples.level.name:5} {duration_text(samples.seconds)}: {values or 'no value'} ({counts})"


def _show_alert(connection: sqlite3.Connection, arguments: argparse.Namespace, stream: TextIO) -> None:
    transition = queries.transition(connection, arguments.alert)
    if transition is None:
        raise ConfigError(f"there is no transition {arguments.alert} in this history")
    samples = queries.evidence(connection, transition.id)
    if arguments.json:
        evidence = [(iso_time(time_s), value if math.isfinite(value) else None) for time_s, value in samples]
        line = json_line(transition, id=transition.id, time=iso_time(transition.wall_s), evidence=evidence)
        stream.write(f"{line}\n")
        return
    if arguments.csv:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(("time", "value"))
        writer.writerows((iso_time(time_s), value) for time_s, value in samples)
        return
    stream.write(readable(f"{_line(transition, _is_coloured(stream))}\n", stream))
    for name, value in _details(transition, samples):
        stream.write(f"  {name}: {printable(value)}\n")
    if samples:
        width = min(shutil.get_terminal_size().columns, _PLOT_COLUMNS)
        bound = transition.bound if transition.statistic in ("last", "mean", "min", "max", "forecast") else None
        stream.write("".join(f"{line}\n" for line in text_plot(samples, bound, width)))


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


def _is_coloured(stream: TextIO) -> bool:
    return is_terminal(stream) and "NO_COLOR" not in os.environ


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
