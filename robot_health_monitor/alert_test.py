"""The unit test of a past alert: its recorded series, the thresholds in force then, and the alert that came."""

from __future__ import annotations

import json
import math
import sqlite3
import textwrap
from itertools import groupby
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence

from robot_health_monitor.core.config import load_config
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.kept_settings import read_kept, settings_of
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.signal_config import LINK, SignalConfig, template_name
from robot_health_monitor.ops.history import queries
from robot_health_monitor.ops.history.rows import StoredTransition

from .history_entries import time_text
from .reconstruction import Reconstruction, RecordedAlert, reconstruct
from .threshold_tests import Alert

_MOST_BEFORE = 5
_MOST_READ = 500
_WIDTH = 100
_INDENT = " " * 8
_FROM_ID = "--from-alert"


def alert_test(connection: sqlite3.Connection, number: int, thresholds: Optional[str] = None) -> str:
    """Returns the file of tests for the alert with this id; `thresholds`: the path to write in place of the contents.

    Raises:
        ConfigError: there is no such alert, or no test can have its input.
    """
    transition = queries.transition(connection, number)
    if transition is None:
        raise ConfigError(f"there is no alert {number} in this history")
    if transition.repeat:
        raise ConfigError(f"{_FROM_ID}: {number} repeats an earlier alert; expected the id of that one")
    settings = _settings(connection, transition)
    config = load_config({"signals": settings})
    name = transition.signal
    if name != LINK and config.signals[template_name(name)].is_template and name == template_name(name):
        raise ConfigError(f"{_FROM_ID}: {printable(name)} has no samples itself, only its elements have")
    recorded = _recorded(connection, transition)
    before = [_recorded(connection, each) for each in _before(connection, transition)]
    found = reconstruct(config, recorded._replace(before=before))
    return "".join(f"{line}\n" for line in _lines(transition, found, settings, thresholds))


def _settings(connection: sqlite3.Connection, transition: StoredTransition) -> Dict[str, Dict[str, Any]]:
    """Returns the settings in force then, of the signal and of those that it depends on."""
    robot = printable(transition.robot)
    kept = queries.configuration(connection, transition.robot, transition.wall_s)
    if kept is None:
        raise ConfigError(f"{_FROM_ID}: this history has no configuration of {robot}")
    try:
        signals = read_kept(kept)
    except ConfigError as error:
        raise ConfigError(f"{_FROM_ID}: the configuration of {robot} cannot be read: {error}") from None
    wanted = [transition.signal]
    if transition.signal == LINK:  # a configuration has at least one signal
        wanted += [name for name in signals if name != LINK][:1]
    found: Dict[str, SignalConfig] = {}
    while wanted:
        name = template_name(wanted.pop())
        if name == LINK or name in found:
            continue
        if name not in signals:
            raise ConfigError(f"{_FROM_ID}: {printable(name)} is not in the configuration of {robot}")
        found[name] = signals[name]
        conditions = (signals[name].only_if, signals[name].latch_release_if)
        wanted += [condition.signal for condition in conditions if condition is not None]
    return {name: settings_of(signal) for name, signal in found.items()}


def _recorded(connection: sqlite3.Connection, transition: StoredTransition) -> RecordedAlert:
    samples = queries.evidence(connection, transition.id)
    return RecordedAlert(
        transition.signal, transition.from_level, transition.to_level, transition.wall_s, transition.value,
        transition.bound, [each for each in samples if math.isfinite(each[0])],
    )  # fmt: skip


def _before(connection: sqlite3.Connection, transition: StoredTransition) -> Sequence[StoredTransition]:
    """Returns some transitions of the signal before this one, oldest first."""
    found: List[StoredTransition] = []
    read = queries.transitions(
        connection,
        robot=transition.robot,  # with a `*` in the names they match others, too
        signal=transition.signal,
        before_id=transition.id,
        newest_first=True,
        limit=_MOST_READ,
    )
    for each in read:
        if (each.robot, each.signal) == (transition.robot, transition.signal) and not each.repeat:
            found.append(each)
        if len(found) == _MOST_BEFORE:
            break
    return found[::-1]


def _lines(
    transition: StoredTransition,
    found: Reconstruction,
    settings: Mapping[str, Mapping[str, Any]],
    thresholds: Optional[str],
) -> Iterator[str]:
    name, when = _quoted(transition.signal), time_text(transition.wall_s)
    yield printable(f"# Alert {transition.id} of {transition.robot}, {when}: {transition.text}")
    if found.missing:
        yield printable(f"# It does not occur in this test: {found.missing}")
    elif found.remark:
        yield printable(f"# Assumed: {found.remark}")
    if thresholds is None:
        yield "thresholds:  # in force then"
        yield "  signals:"
        for signal, keys in settings.items():
            yield f"    {_quoted(signal)}: {json.dumps(keys, ensure_ascii=False)}"
    else:
        yield f"thresholds: {_quoted(thresholds)}"
    level = transition.to_level.name
    yield "tests:"
    yield f"  - name: {_quoted(f'alert {transition.id} of {transition.robot}: {transition.signal} {level}')}"
    yield f"    interval_s: {_number(found.interval_s)}"
    yield "    input:"
    text = series_text(found.series)
    if len(text) <= _WIDTH:
        yield f'      {name}: "{text}"'
    else:
        yield f"      {name}: >-"
        yield from textwrap.wrap(
            text, _WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT, break_on_hyphens=False
        )
    yield "    alerts:"
    alerts = [Alert(found.at_s, transition.signal, Level[level])] if found.missing else found.alerts
    for alert in alerts:
        at_s = _number(round(alert.at_s, 6))
        yield f"      - {{at_s: {at_s}, signal: {_quoted(alert.signal)}, level: {alert.level.name}}}"


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
