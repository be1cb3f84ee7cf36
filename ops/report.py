"""The report of a replay: one HTML file with a plot per signal, which opens without a network.

Texts from recordings and configurations are escaped, and a content security policy allows only the file's two scripts
and its style sheet, by their hashes. The tables need no script.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import pkgutil
from datetime import timedelta, timezone
from html import escape
from itertools import islice
from typing import Any, Dict, Iterable, List, Mapping, NamedTuple, Sequence, Tuple

from robot_health_monitor.core.explanation import bounds_text, judged_unit
from robot_health_monitor.core.formatting import (
    bound_text,
    duration_text,
    printable,
    with_degree_sign,
    with_hint,
    with_unit,
)
from robot_health_monitor.core.model import Level, Transition
from robot_health_monitor.core.signal_config import SignalConfig
from robot_health_monitor.runtime.times import local_time

from .envelope import Envelope
from .plot import plot_bounds, plot_script, plot_style

MARK = '<meta name="generator" content="robot-health replay">'
"""In the head of every report."""
MOST_ALERTS = 1000
"""Most alerts in the table. All are counted."""
MOST_LEVELS = 5000
"""Most changes of level in a plot."""
_MOST_BUCKETS = 4096
_FEWEST_BUCKETS = 256
_SHARES = (*(level.name for level in Level), "unknown")
"""Heads of the columns with shares of time."""
_ALL_BUCKETS = 50_000
"""Buckets of all plots together: they make up most of the file."""


class PlottedSignal:
    """What the report keeps of one signal, in bounded memory."""

    def __init__(self, config: SignalConfig, file: str, start_s: float, span_s: float, buckets: int) -> None:
        """Starts empty.

        Args:
            config: configuration of the signal.
            file: name of the configuration, shown if there are several; empty: there is one.
            start_s: begin of the recordings, in s since 1970.
            span_s: their length in s.
            buckets: how many points to keep, see `buckets_of`.
        """
        self.config = config
        self.file = file
        self.envelope = Envelope(start_s, span_s, buckets)
        """The values that the bounds apply to."""
        self.levels: List[Tuple[float, str]] = []
        """Begin of each announced level, in s since 1970; an empty level: unknown."""
        self._first_s = math.inf

    def add_samples(self, times_s: Any, values: Any, bad_times_s: Any) -> None:
        """Adds samples: those with a value to `Envelope.add`, bad ones to `Envelope.add_bad`."""
        for times in (times_s, bad_times_s):
            if len(times):
                self._first_s = min(self._first_s, float(times[0]))
        self.envelope.add(times_s, values)
        self.envelope.add_bad(bad_times_s)

    def add_gap(self, begin_s: float, end_s: float) -> None:
        """Adds a time that is not recorded, in s since 1970; samples before it must have been added."""
        if self.levels or self._first_s < begin_s:
            level = self.levels[-1][1] if self.levels else Level.OK.name
            self.add_level(begin_s, "")
            self.add_level(end_s, level)

    def add_level(self, wall_s: float, level: str) -> None:
        """Adds a change of the announced level, at a time in s since 1970."""
        if len(self.levels) < MOST_LEVELS:
            self.levels.append((wall_s, level))
        elif self.levels[-1][1]:
            self.levels.append((wall_s, ""))

    @property
    def shown_levels(self) -> List[Tuple[float, str]]:
        """The levels, with OK from the first sample until the first of them."""
        first_s = self._first_s
        if first_s == math.inf or (self.levels and self.levels[0][0] <= first_s):
            return self.levels
        return [(first_s, Level.OK.name), *self.levels]


class ReportedAlert(NamedTuple):
    """A row in the table of alerts."""

    wall_s: float
    """When, in s since 1970."""
    file: str
    """Name of the configuration; empty if there is only one."""
    transition: Transition


class Report(NamedTuple):
    """Everything that the page shows."""

    title: str
    facts: Sequence[str]
    """Lines below the title."""
    summary: str
    """What was judged, for how long, and which signal was worst: one or two sentences."""
    verdict: str
    """The result in a few words."""
    problems: Sequence[str]
    """What could not be read."""
    start_s: float
    """Begin of the recordings, in s since 1970."""
    end_s: float
    """Their end."""
    utc_offset_s: float
    """Local time minus UTC, for the times that are shown."""
    header: Sequence[str]
    """Heads of the table of signals."""
    rows: Sequence[Sequence[str]]
    """The table of signals, the worst first: one row per signal, the first cell is its name, the second its
    configuration if there are several."""
    signals: Sequence[PlottedSignal]
    """Their plots, in the same order."""
    alerts: Sequence[ReportedAlert]
    """At most `MOST_ALERTS`."""
    all_alerts: int
    """How many there were."""


def buckets_of(signals: int) -> int:
    """Returns how many buckets each of so many signals gets."""
    return min(_MOST_BUCKETS, max(_FEWEST_BUCKETS, _ALL_BUCKETS // max(1, signals) // 2 * 2))


def render(report: Report) -> str:
    """Returns the page."""
    scripts = [plot_script(), _read("report.js")]
    style = _read("report.css") + plot_style()
    policy = "; ".join(
        [
            "default-src 'none'",
            f"script-src {' '.join(map(_source_hash, scripts))}",
            f"style-src {_source_hash(style)}",
            "base-uri 'none'",
            "form-action 'none'",
        ]
    )
    several = any(signal.file for signal in report.signals)
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
        *_problems(report.problems),
        "<h2>Signals</h2>",
        *_signal_table(report),
        "<h2>Alerts</h2>",
        *_alert_table(report, several),
        *_plots(report),
        "</main>",
        f'<script type="application/json" id="data">{_json(_data(report))}</script>',
        *(f"<script>{script}</script>" for script in scripts),
        "</body>",
        "</html>",
    ]
    return "\n".join(parts) + "\n"


def _problems(problems: Sequence[str]) -> Iterable[str]:
    if problems:
        yield '<ul class="problems">'
        yield from (f"<li>{_text(problem)}</li>" for problem in problems)
        yield "</ul>"


def _signal_table(report: Report) -> Iterable[str]:
    plotted = {(signal.config.name, signal.file): place for place, signal in enumerate(report.signals)}
    several = any(signal.file for signal in report.signals)
    numbers = 2 if several else 1  # the first columns are texts
    heads = (f'<th scope="col"{_class(at, numbers)}>{_text(head)}</th>' for at, head in enumerate(report.header))
    yield f'<div class="signals table"><table><thead><tr>{"".join(heads)}</tr></thead><tbody>'
    for row in report.rows:
        place = plotted.get((row[0], row[1] if several else ""))
        name = _text(row[0]) if place is None else f'<a href="#signal-{place}">{_text(row[0])}</a>'
        cells = (_cell(report.header[at], cell, at >= numbers) for at, cell in enumerate(row) if at)
        yield f'<tr><td class="name">{name}</td>{"".join(cells)}</tr>'
    yield "</tbody></table></div>"


def _cell(head: str, text: str, is_number: bool) -> str:
    """Returns a cell with the head of its column, which a phone shows; a share that is not zero has a colour."""
    names = ["number" if is_number else "file"]
    if head in _SHARES:
        names.append("zero" if text == "0 %" else f"share {head.lower()}")
    shown = with_degree_sign(text) if is_number else text
    return f'<td class="{" ".join(names)}" data-head="{_text(head)}">{_text(shown)}</td>'


def _class(at: int, numbers: int) -> str:
    """Returns the class of a cell: a name, the file of a configuration if it is not a number, a number."""
    if at >= numbers:
        return ' class="number"'
    return ' class="file"' if at else ""


def _alert_table(report: Report, several: bool) -> Iterable[str]:
    if not report.alerts:
        yield '<p class="hint" id="alerts">none</p>'
        return
    plotted = {(signal.config.name, signal.file): place for place, signal in enumerate(report.signals)}
    if report.all_alerts > len(report.alerts):
        yield f'<p class="hint">The first {len(report.alerts)} of {report.all_alerts}.</p>'
    file_head = '<th scope="col">file</th>' if several else ""
    yield (
        '<div class="alerts table" id="alerts"><table><thead><tr><th scope="col">time</th><th scope="col">level</th>'
        f'{file_head}<th scope="col">alert</th></tr></thead><tbody>'
    )
    for number, alert in enumerate(report.alerts):
        level = alert.transition.to_level.name
        place = plotted.get((alert.transition.signal, alert.file))
        time = _text(_time(alert.wall_s, report.utc_offset_s))
        if place is not None:
            time = f'<a href="#signal-{place}" data-alert="alert-{number}" data-at="{alert.wall_s!r}">{time}</a>'
        file = f'<td class="file">{_text(alert.file)}</td>' if several else ""
        yield (
            f'<tr id="alert-{number}"><td class="time">{time}</td><td class="level {level.lower()}">{level}</td>'
            f'{file}<td class="text">{_text(_line(alert.transition))}</td></tr>'
        )
    yield "</tbody></table></div>"


def _line(transition: Transition) -> str:
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
    alerts: Dict[Tuple[str, str], List[Mapping[str, Any]]] = {}
    for number, alert in enumerate(report.alerts):
        of_signal = alerts.setdefault((alert.transition.signal, alert.file), [])
        of_signal.append(
            {
                "id": f"alert-{number}",
                "t": round(alert.wall_s, 3),
                "level": alert.transition.to_level.name,
                "text": printable(_line(alert.transition)),
            }
        )
    return {
        "from": report.start_s,
        "to": report.end_s,
        "utcOffset": report.utc_offset_s,
        "signals": [
            {"id": f"signal-{place}", **_signal_data(signal, alerts.get((signal.config.name, signal.file), []))}
            for place, signal in enumerate(report.signals)
        ],
    }


def _signal_data(signal: PlottedSignal, alerts: Sequence[Mapping[str, Any]]) -> Mapping[str, Any]:
    config, envelope = signal.config, signal.envelope
    places, low, high = envelope.columns
    return {
        "name": _plot_title(signal),
        "unit": printable(with_degree_sign(judged_unit(config))),
        "start": envelope.start_s,
        "width": envelope.width_s,
        "steps": [after - before for before, after in zip([-1, *places], places)],
        "low": list(map(_short, low)),
        "high": list(map(_short, high)),
        "bad": [round(time_s, 3) for time_s in islice(envelope.bad_times_s, _MOST_BUCKETS)],
        "gap": config.stale_after_s,
        "bounds": plot_bounds(config),
        "levels": [[round(time_s, 3), level] for time_s, level in signal.shown_levels],
        "alerts": alerts,
    }


def _short(value: float) -> float:
    """Returns a value with 7 digits, as many as a Float32 has."""
    return float(f"{value:.7g}")


def _time(wall_s: float, utc_offset_s: float) -> str:
    return local_time(wall_s, zone=timezone(timedelta(seconds=round(utc_offset_s))))


def _text(text: str) -> str:
    return escape(printable(text))


def _json(data: object) -> str:
    """Returns JSON for a script element: nothing in it can end the element or begin a comment."""
    text = json.dumps(data, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _source_hash(source: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(source.encode('utf-8')).digest()).decode('ascii')}'"


def _read(name: str) -> str:
    data = pkgutil.get_data(__package__, name)
    assert data is not None
    return data.decode("utf-8")
