"""A report, of a replay or of a history: one HTML file with a plot per signal, which opens without a network.

`report.html` is its frame. Texts from recordings and configurations are escaped, and a content security policy allows
only the file's two scripts and its style sheet, by their hashes. The tables need no script.
"""

from __future__ import annotations

import base64
import hashlib
import json
import time
from datetime import timedelta, timezone
from html import escape
from string import Template
from typing import Iterable, Mapping, NamedTuple, Sequence

from ...core.judge import bounds_text, judged_unit
from ...core.values import (
    JsonObject,
    Level,
    Transition,
    duration_text,
    package_version,
    printable,
    with_degree_sign,
    with_hint,
)
from ...runtime.times import local_time
from ..plot import plot_bounds, plot_script, plot_style, read_text
from ..store.rows import StoredTransition
from .plotted_signal import PlottedSignal, line_ahead
from .summaries import SHARES, SummaryRow, folded

MARK = '<meta name="generator" content="robot-health report">'  # in the head of every report
MOST_ALERTS = 1000  # most alerts in the table. All are counted.
_MOST_BUCKETS = 4096
_FEWEST_BUCKETS = 256
_MANY_COLUMNS = 13
_LONGEST_UNBROKEN = 28  # characters of a name that stays on one line
_ALL_BUCKETS = 50_000  # buckets of all plots together: they make up most of the file
_PLOTS_HEAD = """<h2>Plots</h2>
<p class="hint">Drag or pinch to zoom; the wheel zooms with Ctrl, or after a click on a plot. Keys: + and - zoom, \
arrows move, 0 shows all. Markers lead to the alert, times of alerts to the plot.</p>
"""
_SECTION = """<section class="signal" id="{}"><h3>{}</h3>
<p>{}</p><div class="plot"></div></section>
"""


class ReportedAlert(NamedTuple):
    """A row in the table of alerts."""

    wall_s: float  # since 1970
    file: str  # name of the configuration or the robot; empty if there is only one
    transition: Transition | StoredTransition
    notes: Sequence[str] = ()  # lines that people wrote on it
    effects: Sequence[str] = ()  # names of the signals that it kept from being announced


class Report(NamedTuple):
    """Everything that the page shows. Times are in s since 1970."""

    title: str
    verdict: str  # the result in a few words
    problems: Sequence[str]  # what could not be read
    start_s: float  # begin of the recordings
    end_s: float
    columns: Sequence[str]  # heads of the table of signals after the name and the group
    rows: Sequence[SummaryRow]  # the table of signals, the worst first
    plots: Mapping[tuple[str, str], PlottedSignal]  # by group and name of the signal
    alerts: Sequence[ReportedAlert]  # at most `MOST_ALERTS`
    all_alerts: int  # how many there were
    group: str = "file"  # head of the column with groups: `file` for configurations, or `robot`
    judged_by: str = ""  # names of the configurations


def buckets_of(signals: int) -> int:
    """Returns how many buckets each of so many signals gets."""
    return min(_MOST_BUCKETS, max(_FEWEST_BUCKETS, _ALL_BUCKETS // max(1, signals) // 2 * 2))


def render(report: Report) -> str:
    """Returns the page. Its times have the offset from UTC that local time has at the begin."""
    rows = folded(report.rows)
    keys = [(row.group, row.signal) for row, _ in rows if (row.group, row.signal) in report.plots]
    places = {key: f"signal-{number}" for number, key in enumerate(keys)}
    offset_s, offset = time.localtime(report.start_s).tm_gmtoff, local_time(report.start_s, "%z")
    zone = timezone(timedelta(seconds=offset_s))
    alerts = [(f"alert-{number}", alert) for number, alert in enumerate(report.alerts)]
    groups = [report.group] if any(row.group for row in report.rows) else []
    heads = ["signal", *groups, *report.columns]
    texts = len(heads) - len(report.columns)

    def time_text(wall_s: float) -> str:
        return local_time(wall_s, zone=zone)

    def signal_rows() -> Iterable[str]:
        for row, effects in rows:
            kind = ' class="effect"' if effects < 0 else f' data-effects="{effects}"' if effects else ""
            name = _link(row.signal, places.get((row.group, row.signal)))
            cells = [_cell(f"name{_length(row.signal)}", name)]
            cells += [_shown_cell(heads[at], text, at >= texts) for at, text in enumerate(row.cells(heads)) if at]
            yield f"<tr{kind}>{''.join(cells)}</tr>"

    def alert_rows() -> Iterable[str]:
        for name, alert in alerts:
            level, data = alert.transition.to_level.name, f' data-alert="{name}" data-at="{alert.wall_s!r}"'
            when = _link(time_text(alert.wall_s), places.get((alert.file, alert.transition.signal)), data)
            text = _text(_line(alert.transition))
            if alert.effects:
                effects = _text(", ".join(alert.effects))
                text += f"<details><summary>{len(alert.effects)} affected</summary>{effects}</details>"
            text += "".join(f'<p class="note">{_text(note)}</p>' for note in alert.notes)
            cells = [_cell("time", when), _cell(f"level {level.lower()}", level)]
            cells += [_shown_cell(group, alert.file, False) for group in groups]
            yield f'<tr id="{name}">{"".join(cells)}{_cell("text", text)}</tr>'

    shown = '<p class="hint" id="alerts">none</p>'
    if alerts:
        cut = f'<p class="hint">The first {len(alerts)} of {report.all_alerts}.</p>'
        shown = cut * (report.all_alerts > len(alerts))
        shown += _table('alerts table" id="alerts', ["time", "level", *groups, "alert"], alert_rows())
    signals: list[JsonObject] = []
    plots = _PLOTS_HEAD if keys else ""
    for key, place in places.items():
        signal = report.plots[key]
        own = [(name, alert) for name, alert in alerts if (alert.file, alert.transition.signal) == key]
        signals.append({"id": place, **_signal_data(signal, own), "until": report.end_s})
        rules = with_degree_sign(bounds_text(signal.config)) if signal.config.bounds else ""
        plots += _SECTION.format(place, _text(_plot_title(signal)), _text(rules))
    scripts = [plot_script(), read_text(__package__, "report.js")]
    style = read_text(__package__, "report.css") + plot_style()
    kind = "signals table many" if len(heads) > _MANY_COLUMNS else "signals table"
    problems = "".join(f"<li>{_text(problem)}</li>" for problem in report.problems)
    return Template(read_text(__package__, "report.html")).substitute(
        mark=MARK,
        script_hashes=" ".join(map(_source_hash, scripts)),
        style_hash=_source_hash(style),
        title=_text(report.title),
        style=style,
        verdict=_text(report.verdict),
        begin=time_text(report.start_s),
        end=time_text(report.end_s),
        lasted=duration_text(report.end_s - report.start_s),
        offset=f"{offset[:3]}:{offset[3:]}",
        judged_by=_text(f"judged by {report.judged_by}; ") if report.judged_by else "",
        version=package_version(),
        problems=f'<ul class="problems">{problems}</ul>' if problems else "",
        signals=_table(kind, heads, signal_rows(), len(report.columns)),
        alerts=shown,
        plots=plots,
        data=_json({"from": report.start_s, "to": report.end_s, "utcOffset": offset_s, "signals": signals}),
        scripts="\n".join(f"<script>{script}</script>" for script in scripts),
    )


def _table(kind: str, heads: Sequence[str], rows: Iterable[str], numbers: int = 0) -> str:
    """Returns a table, of which the last columns are `numbers`."""
    texts = len(heads) - numbers
    cells = (
        f'<th scope="col"{" class=number" if at >= texts else ""}>{_text(head)}</th>' for at, head in enumerate(heads)
    )
    lines = "\n".join(rows)
    return (
        f'<div class="{kind}"><table><thead><tr>{"".join(cells)}</tr></thead><tbody>\n{lines}\n</tbody></table></div>'
    )


def _cell(kind: str, content: str) -> str:
    return f'<td class="{kind}">{content}</td>'


def _shown_cell(head: str, text: str, is_number: bool) -> str:
    """Returns a cell with the head of its column, which a phone shows; a share that is not zero has a colour."""
    kind = "number" if is_number else f"file{_length(text)}"
    if head in SHARES:
        kind += " zero" if text == "0 %" else f" share {head.lower()}"
    shown = with_degree_sign(text) if is_number else text
    return _cell(f'{kind}" data-head="{_text(head)}', _text(shown))


def _link(text: str, place: str | None, data: str = "") -> str:
    """Returns a text that leads to a plot, if there is one."""
    return _text(text) if place is None else f'<a href="#{place}"{data}>{_text(text)}</a>'


def _length(name: str) -> str:
    """Returns the class of a cell with a name that may be broken into lines; empty if it stays on one."""
    return " long" if len(name) > _LONGEST_UNBROKEN else ""


def _line(transition: Transition | StoredTransition) -> str:
    return with_degree_sign(with_hint(transition.text, transition.hint))


def _plot_title(signal: PlottedSignal) -> str:
    config = signal.config
    statistic = "" if config.statistic == "last" else f", {config.statistic} over {duration_text(config.window_s)}"
    if config.forecast_s is not None:
        statistic = f", with its forecast for the next {duration_text(config.forecast_s)}"
    return f"{config.name}{statistic}" + (f" ({signal.file})" if signal.file else "")


def _signal_data(signal: PlottedSignal, alerts: Sequence[tuple[str, ReportedAlert]]) -> JsonObject:
    config = signal.config
    places, low, high = signal.columns
    lines = [
        line_ahead(name, alert.wall_s, alert.transition.status)
        for name, alert in alerts
        if isinstance(alert.transition, Transition) and alert.transition.to_level is not Level.OK
    ]
    return {
        "name": _plot_title(signal),
        "unit": printable(with_degree_sign(judged_unit(config))),
        "start": signal.start_s,
        "width": signal.width_s,
        "steps": [after - before for before, after in zip([-1, *places], places)],
        "low": [float(f"{value:.7g}") for value in low],  # as many digits as a Float32 has
        "high": [float(f"{value:.7g}") for value in high],
        "bad": [round(time_s, 3) for time_s in signal.bad_times_s],
        "gap": config.stale_after_s,
        "bounds": plot_bounds(config),
        "levels": [[round(time_s, 3), level] for time_s, level in signal.levels],
        "alerts": [
            {
                "id": name,
                "t": round(alert.wall_s, 3),
                "level": alert.transition.to_level.name,
                "text": printable(_line(alert.transition)),
            }
            for name, alert in alerts
        ],
        "ahead": list(filter(None, lines)),
    }


def _text(text: str) -> str:
    return escape(printable(text))


def _json(data: object) -> str:
    """Returns JSON for a script element: nothing in it can end the element or begin a comment."""
    text = json.dumps(data, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _source_hash(source: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(source.encode('utf-8')).digest()).decode('ascii')}'"
