"""A report, of a replay or of a history: one HTML file with a plot per signal, which opens without a network.

Texts from recordings and configurations are escaped, and a content security policy allows only the file's two scripts
and its style sheet, by their hashes. The tables need no script.
"""

from __future__ import annotations

import base64
import hashlib
import json
import time
from datetime import timedelta, timezone
from html import escape
from itertools import islice, repeat
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Sequence, Tuple, Union

from ...core.config.signal_config import SignalConfig
from ...core.judge.wording import bounds_text, judged_unit
from ...core.values.formatting import bound_text, duration_text, printable, with_degree_sign, with_hint, with_unit
from ...core.values.model import Level, Transition
from ...core.values.version import package_version
from ...runtime.times import local_time
from ..plot import plot_bounds, plot_script, plot_style, read_text
from ..store.rows import StoredTransition
from .plotted_signal import PlottedSignal, line_ahead
from .summaries import SHARES, SummaryRow, folded, sentence

MARK = '<meta name="generator" content="robot-health report">'  # in the head of every report
MOST_ALERTS = 1000  # most alerts in the table. All are counted.
_MOST_BUCKETS = 4096
_FEWEST_BUCKETS = 256
_MANY_COLUMNS = 13
_LONGEST_UNBROKEN = 28  # characters of a name that stays on one line
_ALL_BUCKETS = 50_000  # buckets of all plots together: they make up most of the file


class ReportedAlert(NamedTuple):
    """A row in the table of alerts."""

    wall_s: float  # since 1970
    file: str  # name of the configuration or the robot; empty if there is only one
    transition: Union[Transition, StoredTransition]
    notes: Sequence[str] = ()  # lines that people wrote on it
    effects: Sequence[str] = ()  # names of the signals that it kept from being announced


class Report(NamedTuple):
    """Everything that the page shows. Times are in s since 1970."""

    title: str
    done: str  # what was done with the signals: `judged` or `watched`
    verdict: str  # the result in a few words
    problems: Sequence[str]  # what could not be read
    start_s: float  # begin of the recordings
    end_s: float
    columns: Sequence[str]  # heads of the table of signals after the name and the group
    rows: Sequence[SummaryRow]  # the table of signals, the worst first
    plots: Mapping[Tuple[str, str], PlottedSignal]  # by group and name of the signal
    alerts: Sequence[ReportedAlert]  # at most `MOST_ALERTS`
    all_alerts: int  # how many there were
    group: str = "file"  # head of the column with groups: `file` for configurations, or `robot`
    judged_by: str = ""  # names of the configurations
    events: Sequence[Tuple[float, str]] = ()  # what else happened: time and text


def buckets_of(signals: int) -> int:
    """Returns how many buckets each of so many signals gets."""
    return min(_MOST_BUCKETS, max(_FEWEST_BUCKETS, _ALL_BUCKETS // max(1, signals) // 2 * 2))


def render(report: Report) -> str:
    """Returns the page."""
    return _Page(report).text()


class _Page:
    """The page in the making."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._rows = folded(report.rows)
        keys = [(row.group, row.signal) for row, _ in self._rows]
        self._signals = [report.plots[key] for key in keys if key in report.plots]
        self._places = {(signal.file, signal.config.name): place for place, signal in enumerate(self._signals)}
        """Number of each plot, by group and signal."""
        self._groups = [report.group] if any(row.group for row in report.rows) else []
        """The head of the column with groups, if there are several."""
        self._offset_s = time.localtime(report.start_s).tm_gmtoff
        """Local time at the begin minus UTC, for all times that are shown."""

    def text(self) -> str:
        report = self._report
        scripts = [plot_script(), read_text(__package__, "report.js")]
        style = read_text(__package__, "report.css") + plot_style()
        policy = (
            f"default-src 'none'; script-src {' '.join(map(_source_hash, scripts))}; style-src {_source_hash(style)}; "
            "base-uri 'none'; form-action 'none'"
        )
        problems = [f"<li>{_text(problem)}</li>" for problem in report.problems]
        begin, end, offset = *map(self._time, (report.start_s, report.end_s)), local_time(report.start_s, "%z")
        lasted_s = report.end_s - report.start_s
        judged_by = f"judged by {report.judged_by}; " if report.judged_by else ""
        parts = [
            "<!DOCTYPE html>",
            '<html lang="en">',
            "<head>",
            '<meta charset="utf-8">',
            MARK,
            f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{_text(report.title)}</title>",
            f"<style>{style}</style>",
            "</head>",
            "<body>",
            "<main>",
            f"<h1>{_text(report.title)}</h1>",
            f'<p class="summary">{_text(sentence(report.rows, report.done, report.group, lasted_s))}</p>',
            f'<p class="verdict">{_text(report.verdict)}</p>',
            f'<p class="facts">{begin} to {end} ({duration_text(lasted_s)}), times in UTC{offset[:3]}:{offset[3:]}</p>',
            f'<p class="facts">{_text(judged_by)}robot-health {package_version()}</p>',
            *(['<ul class="problems">', *problems, "</ul>"] if problems else []),
            "<h2>Signals</h2>",
            *self._signal_table(),
            "<h2>Alerts</h2>",
            *self._alert_table(),
            *self._event_table(),
            *self._plots(),
            "</main>",
            f'<script type="application/json" id="data">{_json(self._data())}</script>',
            *(f"<script>{script}</script>" for script in scripts),
            "</body>",
            "</html>",
        ]
        return "\n".join(parts) + "\n"

    def _time(self, wall_s: float) -> str:
        return local_time(wall_s, zone=timezone(timedelta(seconds=self._offset_s)))

    def _signal_table(self) -> Iterable[str]:
        heads = ["signal", *self._groups, *self._report.columns]
        texts = len(heads) - len(self._report.columns)  # the columns before the numbers
        kinds = ["", ' class="file"'][:texts] + [' class="number"'] * len(self._report.columns)
        many = " many" if len(heads) > _MANY_COLUMNS else ""
        yield _table_begin(f"signals table{many}", heads, kinds)
        for row, effects in self._rows:
            place = self._places.get((row.group, row.signal))
            name = _text(row.signal) if place is None else f'<a href="#signal-{place}">{_text(row.signal)}</a>'
            cells = (_cell(heads[at], cell, at >= texts) for at, cell in enumerate(row.cells(heads)) if at)
            kind = ' class="effect"' if effects < 0 else f' data-effects="{effects}"' if effects else ""
            yield f'<tr{kind}><td class="name{_length(row.signal)}">{name}</td>{"".join(cells)}</tr>'
        yield _TABLE_END

    def _alert_table(self) -> Iterable[str]:
        alerts, count = self._report.alerts, self._report.all_alerts
        if not alerts:
            yield '<p class="hint" id="alerts">none</p>'
            return
        if count > len(alerts):
            yield f'<p class="hint">The first {len(alerts)} of {count}.</p>'
        yield _table_begin('alerts table" id="alerts', ["time", "level", *self._groups, "alert"])
        for number, alert in enumerate(alerts):
            level = alert.transition.to_level.name
            place = self._places.get((alert.file, alert.transition.signal))
            when = self._time(alert.wall_s)
            if place is not None:
                when = f'<a href="#signal-{place}" data-alert="alert-{number}" data-at="{alert.wall_s!r}">{when}</a>'
            file = f'<td class="file{_length(alert.file)}">{_text(alert.file)}</td>' if self._groups else ""
            notes = "".join(f'<p class="note">{_text(note)}</p>' for note in alert.notes)
            if alert.effects:
                names = _text(", ".join(alert.effects))
                notes = f"<details><summary>{len(alert.effects)} affected</summary>{names}</details>{notes}"
            yield (
                f'<tr id="alert-{number}"><td class="time">{when}</td><td class="level {level.lower()}">{level}</td>'
                f'{file}<td class="text">{_text(_line(alert.transition))}{notes}</td></tr>'
            )
        yield _TABLE_END

    def _event_table(self) -> Iterable[str]:
        if self._report.events:
            yield "<h2>Monitor and silences</h2>"
            yield _table_begin("events table", ["time", "event"])
            for wall_s, text in self._report.events:
                yield f'<tr><td class="time">{self._time(wall_s)}</td><td class="text">{_text(text)}</td></tr>'
            yield _TABLE_END

    def _plots(self) -> Iterable[str]:
        if self._signals:
            yield "<h2>Plots</h2>"
            yield (
                '<p class="hint">Drag or pinch to zoom; the wheel zooms with Ctrl, or after a click on a plot. Keys: '
                "+ and - zoom, arrows move, 0 shows all. Markers lead to the alert, times of alerts to the plot.</p>"
            )
        for place, signal in enumerate(self._signals):
            yield (
                f'<section class="signal" id="signal-{place}"><h3>{_text(_plot_title(signal))}</h3>'
                f'<p>{_text(_rules(signal.config))}</p><div class="plot"></div></section>'
            )

    def _data(self) -> Mapping[str, Any]:
        report = self._report
        alerts: Dict[Tuple[str, str], List[Tuple[str, ReportedAlert]]] = {}
        for number, alert in enumerate(report.alerts):
            alerts.setdefault((alert.file, alert.transition.signal), []).append((f"alert-{number}", alert))
        signals: List[Dict[str, Any]] = []
        for key, place in self._places.items():
            data = _signal_data(self._signals[place], alerts.get(key, []))
            signals.append({"id": f"signal-{place}", **data, "until": report.end_s})
        return {"from": report.start_s, "to": report.end_s, "utcOffset": self._offset_s, "signals": signals}


def _table_begin(kind: str, heads: Sequence[str], kinds: Sequence[str] = ()) -> str:
    cells = (f'<th scope="col"{each}>{_text(head)}</th>' for each, head in zip(kinds or repeat(""), heads))
    return f'<div class="{kind}"><table><thead><tr>{"".join(cells)}</tr></thead><tbody>'


_TABLE_END = "</tbody></table></div>"


def _cell(head: str, text: str, is_number: bool) -> str:
    """Returns a cell with the head of its column, which a phone shows; a share that is not zero has a colour."""
    names = ["number" if is_number else f"file{_length(text)}"]
    if head in SHARES:
        names.append("zero" if text == "0 %" else f"share {head.lower()}")
    shown = with_degree_sign(text) if is_number else text
    return f'<td class="{" ".join(names)}" data-head="{_text(head)}">{_text(shown)}</td>'


def _length(name: str) -> str:
    """Returns the class of a cell with a name that may be broken into lines; empty: it stays on one."""
    return " long" if len(name) > _LONGEST_UNBROKEN else ""


def _line(transition: Union[Transition, StoredTransition]) -> str:
    return with_degree_sign(with_hint(transition.text, transition.hint))


def _plot_title(signal: PlottedSignal) -> str:
    config = signal.config
    statistic = "" if config.statistic == "last" else f", {config.statistic} over {duration_text(config.window_s)}"
    if config.forecast_s is not None:
        statistic = f", with its forecast for the next {duration_text(config.forecast_s)}"
    return f"{config.name}{statistic}" + (f" ({signal.file})" if signal.file else "")


def _rules(config: SignalConfig) -> str:
    """Returns the rules of a signal in words."""
    parts = [bounds_text(config)] if config.bounds else []
    if config.for_s:
        parts.append(f"for at least {duration_text(config.for_s)}")
    if config.hysteresis:
        parts.append(f"hysteresis {with_unit(bound_text(config.hysteresis), judged_unit(config))}")
    if config.keep_firing_for_s:
        parts.append(f"stays for {duration_text(config.keep_firing_for_s)} after it has cleared")
    if config.stale_after_s:
        parts.append(f"STALE after {duration_text(config.stale_after_s)} without a sample")
    return with_degree_sign("; ".join(parts))


def _signal_data(signal: PlottedSignal, alerts: Sequence[Tuple[str, ReportedAlert]]) -> Mapping[str, Any]:
    config = signal.config
    places, low, high = signal.columns
    warned = [(name, alert) for name, alert in alerts if alert.transition.to_level is not Level.OK]
    lines = [
        line_ahead(name, alert.wall_s, alert.transition.status)
        for name, alert in warned
        if isinstance(alert.transition, Transition)
    ]
    return {
        "name": _plot_title(signal),
        "unit": printable(with_degree_sign(judged_unit(config))),
        "start": signal.start_s,
        "width": signal.width_s,
        "steps": [after - before for before, after in zip([-1, *places], places)],
        "low": [float(f"{value:.7g}") for value in low],  # as many digits as a Float32 has
        "high": [float(f"{value:.7g}") for value in high],
        "bad": [round(time_s, 3) for time_s in islice(signal.bad_times_s, _MOST_BUCKETS)],
        "gap": config.stale_after_s,
        "bounds": plot_bounds(config),
        "levels": [[round(time_s, 3), level] for time_s, level in signal.shown_levels],
        "alerts": [
            {
                "id": name,
                "t": round(alert.wall_s, 3),
                "level": alert.transition.to_level.name,
                "text": printable(_line(alert.transition)),
            }
            for name, alert in alerts
        ],
        "ahead": [line for line in lines if line is not None],
    }


def _text(text: str) -> str:
    return escape(printable(text))


def _json(data: object) -> str:
    """Returns JSON for a script element: nothing in it can end the element or begin a comment."""
    text = json.dumps(data, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _source_hash(source: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(source.encode('utf-8')).digest()).decode('ascii')}'"
