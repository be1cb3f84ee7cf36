"""`robot-health history --report`: the stored past as one page, in the form of the report of a replay."""

from __future__ import annotations

import argparse
import math
import sqlite3
from dataclasses import replace
from typing import Mapping, Sequence

from ...core.config import SignalConfig, read_kept, read_signal, template_name
from ...core.values import ConfigError, Level, count_text, list_text
from ...ops.report.plotted_signal import PlottedSignal
from ...ops.report.report import MOST_ALERTS, Report, ReportedAlert, buckets_of, render
from ...ops.report.summaries import SHARES, range_cells
from ...ops.store import queries, samples
from ...ops.store.notes import notes_of
from ...ops.store.summary import SignalSummary
from .history_entries import note_text, summary_row

MOST_PLOTS = 200
"""Most signals that have a plot; all are in the table."""

_COLUMNS = (
    "samples", "bad", *SHARES, "available", "alerts", "min", "mean", "max", "longest outage", "recovery",
)  # fmt: skip
_MOST_NAMES = 6


def history_page(
    connection: sqlite3.Connection, arguments: argparse.Namespace, summaries: Sequence[SignalSummary], end_s: float
) -> str:
    """Returns the page for the signals that are summarized, until a time in s since 1970."""
    start_s = end_s - max(summary.duration_s for summary in summaries)
    robots = list(dict.fromkeys(sorted(summary.robot for summary in summaries)))
    several = len(robots) > 1
    problems: list[str] = []
    signals = {robot: _signals_of(connection, robot, end_s, problems) for robot in robots}
    if len(summaries) > MOST_PLOTS:
        problems.append(
            f"only the {MOST_PLOTS} worst of {len(summaries):,} signals have a plot; --robot and --signal choose others"
        )
    plots: dict[tuple[str, str], PlottedSignal] = {}
    rows = []
    for summary in sorted(summaries, key=lambda each: summary_row(each).badness, reverse=True):
        group = summary.robot if several else ""
        config = _config_of(signals[summary.robot], summary.signal)
        plot = PlottedSignal(config, group, start_s, end_s - start_s, buckets_of(min(len(summaries), MOST_PLOTS)))
        figures = _add_samples(connection, summary, (start_s, end_s), plot)
        rows.append(summary_row(summary, **figures)._replace(group=group))
        if len(plots) < MOST_PLOTS:
            plot.levels.clear()  # the OK from the first sample on
            for wall_s, level in summary.levels:
                plot.add_level(wall_s, "" if level is None else level.name)
            plots[group, summary.signal] = plot
    alerts, changes, count = _alerts(connection, arguments, start_s, several)
    return render(
        Report(
            title=f"History of {list_text(robots, _MOST_NAMES)}",
            verdict=count_text(count, "alert") if count else "no alerts",
            problems=problems,
            start_s=start_s,
            end_s=end_s,
            columns=_COLUMNS,
            rows=rows,
            plots=plots,
            alerts=alerts,
            all_alerts=changes,
            group="robot",
        )
    )


def _add_samples(
    connection: sqlite3.Connection, summary: SignalSummary, period_s: tuple[float, float], plot: PlottedSignal
) -> dict[str, str]:
    """Adds the stored samples of a signal to its plot; returns the cells of their numbers and of their range."""
    good = bad = weight = 0
    least, most, total = math.inf, -math.inf, 0.0
    names = (summary.robot, summary.signal)  # with a `*` in them they match others, too
    for each in samples.read(connection, robot=names[0], signal=names[1], since_s=period_s[0], until_s=period_s[1]):
        if (each.robot, each.signal) == names:
            good, bad = good + each.good, bad + each.bad
            if each.bad:
                plot.add_bad(each.start_s + each.seconds / 2.0)
            if each.least is not None and each.most is not None and each.mean is not None:
                plot.add_band(each.start_s, each.seconds, each.least, each.most)
                least, most = min(least, each.least), max(most, each.most)
                total, weight = total + each.mean * each.good, weight + each.good
    values: tuple[float | None, ...] = (least, total / weight, most) if weight else (None, None, None)
    return {"samples": str(good + bad), "bad": str(bad), **range_cells(plot.config, *values)}


def _signals_of(
    connection: sqlite3.Connection, robot: str, at_s: float, problems: list[str]
) -> Mapping[str, SignalConfig]:
    """Returns the signals of the configuration of a robot that was in force at a time; none if it cannot be read."""
    try:
        return read_kept(queries.configuration(connection, robot, at_s) or {})
    except ConfigError as error:
        problems.append(f"the bounds of {robot} cannot be read: {error}")
        return {}


def _config_of(signals: Mapping[str, SignalConfig], signal: str) -> SignalConfig:
    """Returns the configuration of a signal, without bounds where it is not known any more."""
    unknown = {"stale_after_s": 0.0}
    config = signals.get(signal) or signals.get(template_name(signal)) or read_signal("unknown", unknown)
    return replace(config, name=signal)


def _alerts(
    connection: sqlite3.Connection, arguments: argparse.Namespace, start_s: float, several: bool
) -> tuple[list[ReportedAlert], int, int]:
    """Returns the transitions for the table, how many there were, and how many alerts: one may change its level."""
    shown: list[ReportedAlert] = []
    changes, alerts = 0, set()
    names = {"robot": arguments.robot, "signal": arguments.signal}
    transitions = queries.transitions(connection, since_s=start_s, level=arguments.level, **names)
    for transition in transitions:
        if transition.repeat:
            continue
        changes += 1
        if transition.to_level is not Level.OK:
            alerts.add(transition.alert_id)
        if len(shown) < MOST_ALERTS:
            notes = [note_text(note) for note in notes_of(connection, transition.id)]
            group = transition.robot if several else ""
            shown.append(ReportedAlert(transition.wall_s, group, transition, notes, transition.effects))
    return shown, changes, len(alerts)
