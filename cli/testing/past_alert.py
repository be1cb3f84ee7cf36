"""The unit test of a past alert: its recorded series, the thresholds in force then, and the alert that came.

`history_alert` reads the alert from a history, `black_box_alert.py` from a black box. What they have is written as
a person would write it: a period and digits that are easy to read. If the alert does not come again with them, its
exact times and values are tried; if it does not come with those either, something is missing, and is named.
"""

from __future__ import annotations

import json
import math
import sqlite3
import textwrap
from itertools import groupby
from statistics import median
from typing import Any, Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple, Union

from ...core.config.kept_settings import read_kept, settings_of
from ...core.config.monitor_config import MonitorConfig, load_config
from ...core.config.signal_config import LINK, LINK_CONFIG, OF_ARRIVALS, SignalConfig, template_name
from ...core.judge.continuity import MAX_EVIDENCE
from ...core.nodes.alert_system import TICK_PERIOD_S
from ...core.values.errors import ConfigError
from ...core.values.formatting import count_text, duration_text, list_text, number_text, printable
from ...core.values.model import Level, Transition
from ...ops.store import queries
from ...ops.store.rows import StoredTransition
from ..history.history_entries import time_text
from .threshold_cases import TIME_TOLERANCE_S, Alert, ThresholdTest, compare, parse_tests, run_test

FROM_ALERT = "--from-alert"
"""The option that asks for it; what it reports begins with it."""
LONGEST_BEFORE_S = 3600.0
"""Samples that are longer before the alert are left out."""
_SAME_TIME_S = 0.002
"""Two times closer than this are the same: those of stored samples are rounded."""
_INTERVALS_S = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.001)
_MOST_STEPS = 120_000
_WIDTH = 100
_INDENT = " " * 8

Samples = Sequence[Tuple[float, float]]
"""Time in s and value in the signal's unit, oldest first; NaN: bad."""


class PastAlert(NamedTuple):
    """An alert that came, with all that is known about it. Times are in s on one clock, unless noted."""

    title: str
    """As in `alert 41 of r3`."""
    transition: Union[Transition, StoredTransition]
    wall_s: float
    """When it came, in s since 1970."""
    settings: Mapping[str, Mapping[str, Any]]
    """Of its signal and of those that it depends on, as in a thresholds.yaml."""
    time_s: float
    samples: Mapping[str, Samples]
    """Those until the alert, of its signal and of those that it depends on, by their names."""
    missing: str
    """What else may have led to it, and how that would have been recorded."""
    black_box: str = ""
    """Name of the file that has recorded it; empty if none has."""

    @property
    def signal(self) -> str:
        """Its name."""
        return self.transition.signal


class AlertTest(NamedTuple):
    """The file of tests for one alert."""

    text: str
    verdict: str
    """One line: what happened when the test was run."""
    passes: bool


class _Series(NamedTuple):
    """The input of a test, and what it gives."""

    interval_s: float
    values: Mapping[str, List[Optional[float]]]
    """By signal; in the unit of the messages, before `scale`."""
    at_s: float
    """When the alert should come, in s since the begin."""
    alerts: Sequence[Alert] = ()
    """All that occur, until the alert."""
    remark: str = ""


def depends_on(signal: SignalConfig) -> List[str]:
    """Returns the names of the signals that a signal's conditions refer to."""
    return [each.signal for each in (signal.only_if, signal.latch_release_if) if each is not None]


def needed_settings(signals: Mapping[str, SignalConfig], signal: str, robot: str) -> Dict[str, Dict[str, Any]]:
    """Returns the settings of a signal, which may be an element, and of those that it depends on.

    Raises ConfigError if one is not configured, or if it is a template, which has no samples itself.
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


def needed_before_s(signal: SignalConfig) -> int:
    """Returns how long before an alert of a signal a black box has to begin, in s, to have all that it depends on."""
    window_s = 0.0 if signal.statistic == "last" else signal.window_s
    rule_s = max(signal.for_s, signal.error_for_s, signal.keep_firing_for_s, signal.invalid_for_s)
    return math.ceil((window_s + rule_s + signal.stale_after_s) / 10.0 + 1.0) * 10


def alert_test(alert: PastAlert, thresholds: Optional[str] = None, *, exact: bool = False) -> AlertTest:
    """Returns the test of an alert, which has been run.

    Args:
        alert: what is known.
        thresholds: the path to write in place of the thresholds in force then.
        exact: whether to write the exact times and values.

    Raises:
        ConfigError: the alert does not occur again with what is stored, or `thresholds` cannot be read.
    """
    config = load_config({"signals": alert.settings})
    known = {
        name: [each for each in samples if alert.time_s - LONGEST_BEFORE_S < each[0] <= alert.time_s + _SAME_TIME_S]
        for name, samples in alert.samples.items()
    }
    alert = alert._replace(samples={name: samples for name, samples in known.items() if samples})
    tried = [_series(config, alert, True)] if exact else [_series(config, alert, each) for each in (False, True)]
    found = next((each for each in (_run(config, alert, series) for series in tried) if each is not None), None)
    if found is None:
        raise ConfigError(f"{FROM_ALERT}: {alert.title} does not occur again: {_reason(config, alert, tried[-1])}")
    text = "".join(f"{line}\n" for line in _lines(alert, found, thresholds))
    config, (test,) = parse_tests(text, "the test")
    differences = [f"{mark} {each}" for mark, each in compare(test.expected, run_test(config, test)) if mark != " "]
    if not differences:
        return AlertTest(text, f"the test of {alert.title} passes", True)
    what = f"{count_text(len(differences), 'difference')}, first {differences[0]}"
    return AlertTest(text, f"the test of {alert.title} fails with {thresholds or 'these thresholds'}: {what}", False)


def _series(config: MonitorConfig, alert: PastAlert, exact: bool) -> _Series:
    """Returns the samples in steps of one interval: a readable one that is close to theirs, or one with exact times.

    The series begins with the first sample; if times are exact, so that the alert comes at a whole second: then a tick
    coincides with it, as it did. Values that are not exact are rounded to a hundredth of their range.
    """
    own = alert.samples.get(alert.signal, ())
    times_s = [at for samples in alert.samples.values() for at, _ in samples]
    begin_s = min(times_s) if own else alert.time_s - _config_of(config, alert.signal).startup_grace_s - exact
    if exact:
        begin_s = alert.time_s - max(1.0, math.ceil(alert.time_s - begin_s - _SAME_TIME_S))
    span_s = alert.time_s - begin_s

    def fits(interval_s: float) -> bool:
        steps = [(at - begin_s) / interval_s for at in times_s]
        return all(abs(each - round(each)) * interval_s <= _SAME_TIME_S / 10.0 for each in steps)

    gaps_s = [after[0] - before[0] for before, after in zip(own, own[1:])]
    interval_s = max(_readable_number(median(gaps_s) if gaps_s else 1.0), span_s / _MOST_STEPS)
    if exact:
        possible = [each for each in _INTERVALS_S if span_s / each <= _MOST_STEPS]
        interval_s = next(filter(fits, possible), possible[-1])
    values = {}
    for name, samples in alert.samples.items():
        signal = _config_of(config, name)
        scale = 1.0 if signal.reduce else signal.scale  # values of a reduction are in its unit
        places = {max(0, round((at - begin_s) / interval_s)): value / scale for at, value in samples}
        values[name] = places if exact else _rounded(places)
    steps = range(math.ceil((span_s + TICK_PERIOD_S) / interval_s) + 1)
    listed = {name: list(map(places.get, steps)) for name, places in (values or {alert.signal: {}}).items()}
    return _Series(interval_s, listed, span_s)


def _run(config: MonitorConfig, alert: PastAlert, series: _Series) -> Optional[_Series]:
    """Returns the series until the alert, with all that occurs; None if the alert does not."""
    occurred = run_test(config, ThresholdTest("", series.interval_s, series.values, ()))
    before, found = Level.OK, []
    for each in occurred:
        if each.signal == alert.signal:
            is_near = abs(each.at_s - series.at_s) <= TICK_PERIOD_S + series.interval_s + TIME_TOLERANCE_S
            if each.level is alert.transition.to_level and is_near:
                found.append((before is alert.transition.from_level, each))
            before = each.level
    if not found:
        return None
    is_same, again = max(found, key=lambda pair: (pair[0], pair[1].at_s))
    steps = math.ceil(again.at_s / series.interval_s - TIME_TOLERANCE_S) + 1
    missing = f"the level before was {alert.transition.from_level.name}, for which earlier samples are missing"
    return series._replace(
        values={name: values[:steps] for name, values in series.values.items()},
        alerts=[each for each in occurred if each.at_s <= again.at_s],
        remark="" if is_same else missing,
    )


def _reason(config: MonitorConfig, alert: PastAlert, series: _Series) -> str:
    occurred = run_test(config, ThresholdTest("", series.interval_s, series.values, ()))
    own = [f"{each.level.name} at {number_text(each.at_s)} s" for each in occurred if each.signal == alert.signal]
    return f"{alert.missing}; these samples give {', '.join(own[:5]) or 'no alert'}"


def _config_of(config: MonitorConfig, signal: str) -> SignalConfig:
    return LINK_CONFIG if signal == LINK else config.signals[template_name(signal)]


def _rounded(places: Mapping[int, float]) -> Dict[int, float]:
    numbers = [value for value in places.values() if math.isfinite(value)]
    size = max(map(abs, numbers), default=0.0)
    spread = max(numbers, default=0.0) - min(numbers, default=0.0)
    if not 0.0 < size < math.inf:
        return dict(places)
    decimals = -math.floor(math.log10(spread if 0.0 < spread < math.inf else size / 10.0)) + 2
    return {place: round(value, decimals) if math.isfinite(value) else value for place, value in places.items()}


def _readable_number(value: float) -> float:
    """Returns a number with one digit if that is within 4 % of it, else with two."""
    decimals = -math.floor(math.log10(max(value, 0.001)))
    short = round(value, decimals)
    return short if abs(short - value) <= 0.04 * value else max(round(value, decimals + 1), 0.001)


def _lines(alert: PastAlert, found: _Series, thresholds: Optional[str]) -> Iterator[str]:
    yield printable(f"# {alert.title[:1].upper()}{alert.title[1:]}, {time_text(alert.wall_s)}: {alert.transition.text}")
    if found.remark:
        yield printable(f"# Not as it was: {found.remark}")
    if thresholds is None:
        yield "thresholds:  # in force then"
        yield "  signals:"
        for signal, keys in alert.settings.items():
            yield f"    {_quoted(signal)}: {json.dumps(keys, ensure_ascii=False)}"
    else:
        yield f"thresholds: {_quoted(thresholds)}"
    yield "tests:"
    yield f"  - name: {_quoted(f'{alert.title}: {alert.signal} {alert.transition.to_level.name}')}"
    yield f"    interval_s: {_number(found.interval_s)}"
    yield "    input:"
    for name, series in found.values.items():
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


def history_alert(connection: sqlite3.Connection, number: int) -> PastAlert:
    """Returns the alert with this id; raises ConfigError if there is none, or if no test can have its input."""
    transition = queries.transition(connection, number)
    if transition is None:
        raise ConfigError(f"there is no alert {number} in this history")
    if transition.repeat:
        raise ConfigError(f"{FROM_ALERT}: {number} repeats an earlier alert; expected the id of that one")
    robot = printable(transition.robot)
    kept = queries.configuration(connection, transition.robot, transition.wall_s)
    if kept is None:
        raise ConfigError(f"{FROM_ALERT}: this history has no configuration of {robot}")
    try:
        signals = read_kept(kept)
    except ConfigError as error:
        raise ConfigError(f"{FROM_ALERT}: the configuration of {robot} cannot be read: {error}") from None
    settings = needed_settings(signals, transition.signal, robot)
    signal = signals[template_name(transition.signal)]
    stored = [each for each in queries.evidence(connection, transition.id) if math.isfinite(each[0])]
    is_of_arrivals = signal.statistic in OF_ARRIVALS
    samples: Samples = [] if is_of_arrivals else stored  # else those are values of the statistic
    if not is_of_arrivals and _is_invalid(transition, signal):
        number_ = float(transition.value) if isinstance(transition.value, (int, float)) else math.nan
        samples = [*samples, (transition.wall_s, number_)]
    recorder = f"a black box (ops.yaml: black_box, before_s: {needed_before_s(signal)}) would have recorded it"
    if transition.black_box:
        recorder = f"its black box {transition.black_box} has it: name its folder by --ops, or the file itself"
    return PastAlert(
        title=f"alert {transition.id} of {transition.robot}",
        transition=transition,
        wall_s=transition.wall_s,
        settings=settings,
        time_s=transition.wall_s,
        samples={transition.signal: samples},
        missing=f"{_missing(transition, signal, samples)}; {recorder}",
        black_box=transition.black_box,
    )


def _is_invalid(transition: StoredTransition, signal: SignalConfig) -> bool:
    """Returns whether bad data gave the alert."""
    is_judged = signal.is_status or transition.signal == LINK or transition.bound is not None
    return transition.to_level is Level.ERROR and not is_judged


def _missing(transition: StoredTransition, signal: SignalConfig, samples: Samples) -> str:
    others = depends_on(signal)
    if signal.statistic in OF_ARRIVALS:
        return "a history has no times of arrivals"
    if not samples:
        return "no samples are stored with it"
    if others:
        return f"the samples of {list_text(others)}, which it depends on, are not stored with it"
    if len(samples) >= MAX_EVIDENCE:
        return f"only {MAX_EVIDENCE} of the samples in its window are stored"
    if _is_invalid(transition, signal):
        return "bad samples before it are not stored"
    return f"what came more than {duration_text(transition.wall_s - samples[0][0])} before it is not stored"
