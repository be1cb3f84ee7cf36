"""`robot-health history`: past alerts and silences, from a history file."""

from __future__ import annotations

import argparse
import heapq
import itertools
import os
import sqlite3
import sys
import time
from datetime import datetime
from operator import attrgetter
from typing import Any, Iterable, Iterator

from ...core.values import ConfigError, Level, ServiceError, printable
from ...ops.report.summaries import SHARES, table
from ...ops.store import queries
from ...ops.store import samples as stored_samples
from ...ops.store.notes import notes_of
from ...ops.store.rows import select
from ...ops.store.samples import SAMPLES_FIELDS, StoredSamples, samples_fields
from ...ops.store.silences import parse_duration_s, silence_events
from ...ops.store.summary import SignalSummary, summarize
from ...runtime.interrupts import Interrupts
from ..arguments import Parser, add, alert_id, checked
from ..history.history_entries import (  # fmt: skip
    CSV_HEAD,
    Listing,
    NotedAlert,
    alert_listing,
    entry_fields,
    entry_lines,
    entry_rows,
    summary_row,
    time_text,
)
from ..history.history_file import DEFAULT_FILE, history_file, reading_history
from ..output.lines import plain_table

_WALL_S = attrgetter("wall_s")
_SUMMARY_HEADS = ("robot", "signal", *SHARES, "available", "alerts", "longest outage", "recovery")
_SUMMARY_FIELDS = (
    "robot", "signal", "duration_s", "unknown", "alerts", "longest_outage_s", "availability", "mean_time_to_recover_s",
)  # fmt: skip


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Shows the alerts in a history file, with starts and stops of the monitor, resets and changes of "
        "the configuration. The monitor may be running."
    )
    add(parser, "[FILE]", f"the history file (default: named by --ops, else {DEFAULT_FILE})")
    add(parser, "--ops FILE", "an ops.yaml that names the history")
    moment = checked("a duration such as 24h or a time such as 2026-11-22T08:00", _moment)
    meaning = "only what is newer: 90s, 1h30m, 24h, 7d, or a local time such as 2026-11-22T08:00"
    add(parser, "--since TIME", meaning, type=moment, dest="since_s")
    add(parser, "--robot R", "only this robot; * and ? as in file names")
    add(parser, "--signal S", "only this signal; * and ? as in file names")
    level = checked("OK, WARN, ERROR or STALE", lambda text: Level[text.upper()])
    add(parser, "--level L", "only transitions to this level: OK, WARN, ERROR or STALE", type=level)
    content = parser.add_mutually_exclusive_group()
    add(
        content,
        "--summary",
        "per signal: share of time per level, of OK in known time, alerts, longest outage, mean time to recover",
    )
    meaning = "per 10 s (after two days: 5 min): smallest, largest, mean and last value, samples, worst level"
    add(content, "--samples", meaning)
    add(content, "--report FILE", "write a page with plots, one HTML file")
    add(content, "--alert ID", "one transition, with its samples", type=alert_id)
    add(parser, "--force", "let --report replace any file, except those that are read")
    form = parser.add_mutually_exclusive_group()
    add(form, "--json", "one JSON object per line")
    add(form, "--csv", "comma-separated values")
    parser.check = _check_form


def _check_form(arguments: argparse.Namespace) -> str:
    is_listed = arguments.json or arguments.csv
    return "--report: not allowed with --json or --csv" if arguments.report is not None and is_listed else ""


def _moment(text: str) -> float:
    """Returns a time in s since 1970: so long ago, or a date and time by ISO 8601."""
    try:
        return time.time() - parse_duration_s(text)
    except ConfigError:
        return datetime.fromisoformat(text).timestamp()


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Prints what a history file contains.

    Raises:
        ConfigError: the file does not exist, cannot be read, or is no history.
        ServiceError: stdout is closed.
    """
    make = _summary if arguments.summary else _samples if arguments.samples else _transitions
    if arguments.alert is not None:
        make = alert_listing
    file = history_file(arguments.file, arguments.ops)
    with reading_history(file) as connection:
        if arguments.report is not None:
            _write_report(connection, arguments, file)
            return
        if getattr(sys.stdout, "name", "") == os.devnull:  # `__main__` opened it in place of one that is closed
            raise ServiceError("stdout is closed: nothing can be shown")
        form = "json" if arguments.json else "csv" if arguments.csv else "lines"
        make(connection, arguments).write(sys.stdout, form)


def _transitions(connection: sqlite3.Connection, arguments: argparse.Namespace) -> Listing:
    level = arguments.level
    since_s, robot, signal = arguments.since_s or 0.0, arguments.robot, arguments.signal
    alerts = queries.transitions(connection, since_s=arguments.since_s, robot=robot, signal=signal, level=level)
    noted = (NotedAlert(each, notes_of(connection, each.id)) for each in alerts)
    silences = [] if level is not None else silence_events(connection, time.time(), since_s, robot, signal)
    others = [] if level is not None or signal is not None else queries.monitor_events(connection, since_s, robot)

    def merged(*events: Iterable[Any]) -> Iterator[Any]:
        """Yields alerts in their order, and each event before those that are younger."""
        return heapq.merge(sorted(itertools.chain(*events), key=_WALL_S), noted, key=_WALL_S)

    return Listing(
        json=map(entry_fields, merged(silences)),
        head=CSV_HEAD,
        rows=(row for entry in merged(silences) for row in entry_rows(entry)),
        lines=(line for entry in merged(silences, others) for line in entry_lines(entry)),
        nothing="no alerts",
    )


def _summaries(connection: sqlite3.Connection, arguments: argparse.Namespace) -> tuple[list[SignalSummary], float]:
    """Returns the summaries, and when they end, in s since 1970. Without any, one line on stderr says why."""
    ends = select(connection, "runs", (float,), "SELECT max(coalesce(stopped_s, alive_s)) AS end_s FROM runs")
    end_s = ends[0][0] if ends else time.time()
    summaries = summarize(connection, end_s, since_s=arguments.since_s, robot=arguments.robot, signal=arguments.signal)
    if not summaries and arguments.robot is None and arguments.signal is None:
        sys.stderr.write(f"the monitor did not run in this time; it last ran at {time_text(end_s)}\n")
    elif not summaries:
        sys.stderr.write("no signal matches\n")
    return summaries, end_s


def _write_report(connection: sqlite3.Connection, arguments: argparse.Namespace, file: str) -> None:
    from ..history.history_report import history_page
    from ..report_file import ReportFile

    inputs = [file + suffix for suffix in ("", "-wal", "-shm", ".lock")]
    report = ReportFile(arguments.report, [*inputs, *([arguments.ops] if arguments.ops else [])], arguments.force)
    summaries, end_s = _summaries(connection, arguments)
    if not summaries:
        raise ConfigError("--report: there is nothing to show")
    report.write(history_page(connection, arguments, summaries, end_s))


def _summary(connection: sqlite3.Connection, arguments: argparse.Namespace) -> Listing:
    summaries, end_s = _summaries(connection, arguments)
    shares = [{level.name: summary.shares.get(level, 0.0) for level in Level} for summary in summaries]
    fields = [{name: getattr(summary, name) for name in _SUMMARY_FIELDS} for summary in summaries]
    lines = []
    if summaries:
        rows = table(_SUMMARY_HEADS, list(map(summary_row, summaries)))
        begin_s = end_s - max(summary.duration_s for summary in summaries)
        lines = [f"{time_text(begin_s)} to {time_text(end_s)}", *plain_table(rows, 2)]
    return Listing(
        json=({**each, "shares": share} for each, share in zip(fields, shares)),
        head=[*_SUMMARY_FIELDS, *Level.__members__],
        rows=({**each, **share} for each, share in zip(fields, shares)),
        lines=lines,
    )


def _samples(connection: sqlite3.Connection, arguments: argparse.Namespace) -> Listing:
    samples = stored_samples.read(connection, robot=arguments.robot, signal=arguments.signal, since_s=arguments.since_s)
    chosen = (each for each in samples if arguments.level in (None, each.level))
    return Listing(
        json=map(samples_fields, chosen),
        head=SAMPLES_FIELDS,
        rows=map(samples_fields, chosen),
        lines=map(_samples_line, chosen),
        nothing="no samples",
    )


def _samples_line(samples: StoredSamples) -> str:
    values = (f"{name} {value}" for name, value in samples_fields(samples).items() if name != "start")
    return printable(f"{time_text(samples.start_s)} {', '.join(values)}")
