"""A report, of a replay or of a history: one HTML file with a plot per signal, which opens without a network.

Texts from recordings and configurations are escaped, and a content security policy allows only the file's two scripts
and its style sheet, by their hashes. The tables need no script.
"""

from __future__ import annotations

import base64
import hashlib
import json
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

MARK = '<meta name="generator" content="robot-health report">'  # in the head of every report
MOST_ALERTS = 1000  # most alerts in the table. All are counted.
_MOST_BUCKETS = 4096
_FEWEST_BUCKETS = 256
_SHARES = (*(level.name for level in Level), "unknown")  # heads of the columns with shares of time
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
    facts: Sequence[str]  # lines below the title
    summary: str  # what was judged, for how long, and which signal was worst: one or two sentences
    verdict: str  # the result in a few words
    problems: Sequence[str]  # what could not be read
    start_s: float  # begin of the recordings
    end_s: float
    utc_offset_s: float  # local time minus UTC, for the times that are shown
    header: Sequence[str]  # heads of the table of signals
    rows: Sequence[Sequence[str]]
    """The table of signals, the worst first; it begins with the name and, if there are several, the configuration."""
    signals: Sequence[PlottedSignal]  # their plots, in the same order
    alerts: Sequence[ReportedAlert]  # at most `MOST_ALERTS`
    all_alerts: int  # how many there were
    group: str = "file"  # head of the column with `file`: `file` for configurations, or `robot`
    events: Sequence[Tuple[float, str]] = ()  # what else happened: time and text
    effects: Sequence[int] = ()
    """How many of the next rows are effects of each row, which are folded below it; -1: it is one."""


def facts_of(start_s: float, end_s: float, judged_by: str = "") -> List[str]:
    """Returns the lines below the title: the period, in s since 1970, and what made the report."""
    offset = local_time(start_s, "%z")
    period = f"{local_time(start_s)} to {local_time(end_s)} ({duration_text(end_s - start_s)})"
    return [f"{period}, times in UTC{offset[:3]}:{offset[3:]}", f"{judged_by}robot-health {package_version()}"]


def buckets_of(signals: int) -> int:
    """Returns how many buckets each of so many signals gets."""
    return min(_MOST_BUCKETS, max(_FEWEST_BUCKETS, _ALL_BUCKETS // max(1, signals) // 2 * 2))


def render(report: Report) -> str:
    """Returns the page."""
    scripts = [plot_script(), read_text(__package__, "report.js")]
    style = read_text(__package__, "report.css") + plot_style()
    policy = (
        f"default-src 'none'; script-src {' '.join(map(_source_hash, scripts))}; style-src {_source_hash(style)}; "
        "base-uri 'none'; form-action 'none'"
    )
    plotted = {(signal.config.name, signal.file): place for place, signal in enumerate(report.signals)}
    several = any(signal.file for signal in report.signals)
    problems = [f"<li>{_text(problem)}</li>" for problem in report.problems]
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
        f'<p class="summary">{_text(report.summary)}</p>',
        f'<p class="verdict">{_text(report.verdict)}</p>',
        *(f'<p class="facts">{_text(fact)}</p>' for fact in report.facts),
        *(['<ul class="problems">', *problems, "</ul>"] if problems else []),
        "<h2>Signals</h2>",
        *_signal_table(report, plotted, several),
        "<h2>Alerts</h2>",
        *_alert_table(report, plotted, several),
        *_event_table(report),
        *_plots(report),
        "</main>",
        f'<script type="application/json" id="data">{_json(_data(report))}</script>',
        *(f"<script>{script}</script>" for script in scripts),
        "</body>",
        "</html>",
    ]
    return "\n".join(parts) + "\n"


_Places = Mapping[Tuple[str, str], int]
"""Number of each plot, by signal and file."""


def _signal_table(report: Report, plotted: _Places, several: bool) -> Iterable[str]:
    kinds = ["", ' class="file"'] if several else [""]
    numbers = len(kinds)  # the columns before are texts
    kinds += [' class="number"'] * (len(report.header) - numbers)
    heads = (f'<th scope="col"{kind}>{_text(head)}</th>' for kind, head in zip(kinds, report.header))
    many = " many" if len(report.header) > _MANY_COLUMNS else ""
    yield f'<div class="signals table{many}"><table><thead><tr>{"".join(heads)}</tr></thead><tbody>'
    for row, effects in zip(report.rows, report.effects or repeat(0)):
        place = plotted.get((row[0], row[1] if several else ""))
        name = _text(row[0]) if place is None else f'<a href="#signal-{place}">{_text(row[0])}</a>'
        cells = (_cell(report.header[at], cell, at >= numbers) for at, cell in enumerate(row) if at)
        kind = ' class="effect"' if effects < 0 else f' data-effects="{effects}"' if effects else ""
        yield f'<tr{kind}><td class="name{_length(row[0])}">{name}</td>{"".join(cells)}</tr>'
    yield "</tbody></table></div>"


def _cell(head: str, text: str, is_number: bool) -> str:
    """Returns a cell with the head of its column, which a phone shows; a share that is not zero has a colour."""
    names = ["number" if is_number else f"file{_length(text)}"]
    if head in _SHARES:
        names.append("zero" if text == "0 %" else f"share {head.lower()}")
    shown = with_degree_sign(text) if is_number else text
    return f'<td class="{" ".join(names)}" data-head="{_text(head)}">{_text(shown)}</td>'


def _length(name: str) -> str:
    """Returns the class of a cell with a name that may be broken into lines; empty: it stays on one."""
    return " long" if len(name) > _LONGEST_UNBROKEN else ""


def _alert_table(report: Report, plotted: _Places, several: bool) -> Iterable[str]:
    if not report.alerts:
        yield '<p class="hint" id="alerts">none</p>'
        return
    if report.all_alerts > len(report.alerts):
        yield f'<p class="hint">The first {len(report.alerts)} of {report.all_alerts}.</p>'
    zone = _zone(report)
    file_head = f'<th scope="col">{_text(report.group)}</th>' if several else ""
    yield (
        '<div class="alerts table" id="alerts"><table><thead><tr><th scope="col">time</th><th scope="col">level</th>'
        f'{file_head}<th scope="col">alert</th></tr></thead><tbody>'
    )
    for number, alert in enumerate(report.alerts):
        level = alert.transition.to_level.name
        place = plotted.get((alert.transition.signal, alert.file))
        time = _text(local_time(alert.wall_s, zone=zone))
        if place is not None:
            time = f'<a href="#signal-{place}" data-alert="alert-{number}" data-at="{alert.wall_s!r}">{time}</a>'
        file = f'<td class="file{_length(alert.file)}">{_text(alert.file)}</td>' if several else ""
        notes = "".join(f'<p class="note">{_text(note)}</p>' for note in alert.notes)
        if alert.effects:
            names = _text(", ".join(alert.effects))
            notes = f"<details><summary>{len(alert.effects)} affected</summary>{names}</details>{notes}"
        yield (
            f'<tr id="alert-{number}"><td class="time">{time}</td><td class="level {level.lower()}">{level}</td>'
            f'{file}<td class="text">{_text(_line(alert.transition))}{notes}</td></tr>'
        )
    yield "</tbody></table></div>"


def _event_table(report: Report) -> Iterable[str]:
    if not report.events:
        return
    yield "<h2>Monitor and silences</h2>"
    yield (
        '<div class="events table"><table><thead><tr><th scope="col">time</th><th scope="col">event</th></tr></thead>'
        "<tbody>"
    )
    for wall_s, text in report.events:
        time = _text(local_time(wall_s, zone=_zone(report)))
        yield f'<tr><td class="time">{time}</td><td class="text">{_text(text)}</td></tr>'
    yield "</tbody></table></div>"


def _zone(report: Report) -> timezone:
    return timezone(timedelta(seconds=round(report.utc_offset_s)))


def _line(transition: Union[Transition, StoredTransition]) -> str:
    return with_degree_sign(with_hint(transition.text, transition.hint))


def _plots(report: Report) -> Iterable[str]:
    if not report.signals:
        return
    yield "<h2>Plots</h2>"
    yield (
        '<p class="hint">Drag or pinch to zoom; the wheel zooms with Ctrl, or after a click on a plot. Keys: '
        "+ and - zoom, arrows move, 0 shows all. Markers lead to the alert, times of alerts to the plot.</p>"
    )
    for place, signal in enumerate(report.signals):
        yield (
            f'<section class="signal" id="signal-{place}"><h3>{_text(_plot_title(signal))}</h3>'
            f'<p>{_text(_rules(signal.config))}</p><div class="plot"></div></section>'
        )


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


def _data(report: Report) -> Mapping[str, Any]:
    alerts: Dict[Tuple[str, str], List[Tuple[str, ReportedAlert]]] = {}
    for number, alert in enumerate(report.alerts):
        alerts.setdefault((alert.transition.signal, alert.file), []).append((f"alert-{number}", alert))
    signals: List[Dict[str, Any]] = []
    for place, signal in enumerate(report.signals):
        of_signal = alerts.get((signal.config.name, signal.file), [])
        signals.append({"id": f"signal-{place}", **_signal_data(signal, of_signal), "until": report.end_s})
    return {
        "from": report.start_s,
        "to": report.end_s,
        "utcOffset": report.utc_offset_s,
        "signals": signals,
    }


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
