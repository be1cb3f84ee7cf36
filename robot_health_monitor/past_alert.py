"""The unit test of a past alert: its recorded series, the thresholds in force then, and the alert that came.

`history_alert.py` reads the alert from a history, `black_box_alert.py` from a black box.
"""

from __future__ import annotations

import json
import textwrap
from itertools import groupby
from typing import Any, Dict, Iterator, Mapping, NamedTuple, Optional, Sequence

from robot_health_monitor.core.config import load_config
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import count_text, printable
from robot_health_monitor.core.kept_settings import settings_of
from robot_health_monitor.core.signal_config import LINK, SignalConfig, template_name

from .alert_attempts import RecordedAlert, Samples, depends_on
from .history_entries import time_text
from .reconstruction import Reconstruction, reconstruct
from .threshold_tests import compare, parse_tests, run_test

FROM_ALERT = "--from-alert"
"""The option that asks for it; what it reports begins with it."""
_WIDTH = 100
_INDENT = " " * 8


class PastAlert(NamedTuple):
    """An alert that came, with all that is known about it."""

    title: str
    """As in `alert 41 of r3`."""
    line: str
    """The alert line."""
    settings: Mapping[str, Mapping[str, Any]]
    """Of its signal and of those that it depends on, as in a thresholds.yaml."""
    recorded: RecordedAlert
    others: Mapping[str, Samples]
    """Samples of the signals that it depends on, by their names; times in s since 1970."""


class AlertTest(NamedTuple):
    """The file of tests for one alert."""

    text: str
    verdict: str
    """One line: what happened when the test was run."""
    passes: bool


def needed_settings(signals: Mapping[str, SignalConfig], signal: str, robot: str) -> Dict[str, Dict[str, Any]]:
    """Returns the settings of a signal, which may be an element, and of those that it depends on.

    Raises ConfigError: one is not configured, or it is a template, which has no samples itself.
    """
    wanted = [signal]
    if signal == LINK:  # a configuration has at least one signal
        wanted += [name for name in signals if name != LINK][:1]
    found: Dict[str, SignalConfig] = {}
    while wanted:
        name = template_name(wanted.pop())
        if name == LINK or name in found:
            continue
        if name not in signals:
            raise ConfigError(f"{FROM_ALERT}: {printable(name)} is not in the configuration of {robot}")
        found[name] = signals[name]
        wanted += depends_on(signals[name])
    if signal in found and found[signal].is_template:
        raise ConfigError(f"{FROM_ALERT}: {printable(signal)} has no samples itself, only its elements have")
    return {name: settings_of(each) for name, each in found.items()}


def alert_test(alert: PastAlert, thresholds: Optional[str] = None) -> AlertTest:
    """Returns the test of an alert, which has been run; `thresholds`: the path to write in place of the contents.

    Raises:
        ConfigError: the alert does not occur again with what is stored, or `thresholds` cannot be read.
    """
    found = reconstruct(load_config({"signals": alert.settings}), alert.recorded, alert.others)
    if found.missing:
        raise ConfigError(f"{FROM_ALERT}: {alert.title} does not occur again: {found.missing}")
    text = "".join(f"{line}\n" for line in _lines(alert, found, thresholds))
    config, (test,) = parse_tests(text, "the test")
    differences = [f"{mark} {each}" for mark, each in compare(test.expected, run_test(config, test)) if mark != " "]
    if not differences:
        return AlertTest(text, f"the test of {alert.title} passes", True)
    what = f"{count_text(len(differences), 'difference')}, first {differences[0]}"
    return AlertTest(text, f"the test of {alert.title} fails with {thresholds or 'these thresholds'}: {what}", False)


def _lines(alert: PastAlert, found: Reconstruction, thresholds: Optional[str]) -> Iterator[str]:
    recorded = alert.recorded
    yield printable(f"# {alert.title[:1].upper()}{alert.title[1:]}, {time_text(recorded.wall_s)}: {alert.line}")
    if found.remark:
        yield printable(f"# Assumed: {found.remark}")
    if thresholds is None:
        yield "thresholds:  # in force then"
        yield "  signals:"
        for signal, keys in alert.settings.items():
            yield f"    {_quoted(signal)}: {json.dumps(keys, ensure_ascii=False)}"
    else:
        yield f"thresholds: {_quoted(thresholds)}"
    yield "tests:"
    yield f"  - name: {_quoted(f'{alert.title}: {recorded.signal} {recorded.to_level.name}')}"
    yield f"    interval_s: {_number(found.interval_s)}"
    yield "    input:"
    for name, series in found.series.items():
        text = series_text(series)
        if len(text) <= _WIDTH:
            yield f'      {_quoted(name)}: "{text}"'
            continue
        yield f"      {_quoted(name)}: >-"
        yield from textwrap.wrap(
            text, _WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT, break_on_hyphens=False
        )
    yield "    alerts:"
    for each in found.alerts:
        at_s = _number(round(each.at_s, 6))
        yield f"      - {{at_s: {at_s}, signal: {_quoted(each.signal)}, level: {each.level.name}}}"


def series_text(series: Sequence[Optional[float]]) -> str:
    """Returns samples in the notation of a series."""
    items = []
    for text, run in groupby("_" if value is None else _number(value) for value in series):
        count = sum(1 for _ in run)
        repeats = count if text == "_" else count - 1
        items.append(f"{text}x{repeats}" if count > 1 else text)
    return " ".join(items)


def _number(value: float) -> str:
    text = repr(float(value))
    return text[:-2] if text.endswith(".0") else text


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
