"""The unit test of a past alert: its recorded series, the thresholds in force then, and the alert that came.

`history_alert` reads the alert from a history, `black_box_alerts` those of a black box: what a replay announces. What
they have is written as a person would write it: a period and digits that are easy to read. If the alert does not come
again with them, its exact times and values are tried; if it does not come with those either, something is missing, and
is named.
"""

from __future__ import annotations

import math
import os
import sqlite3
from dataclasses import replace
from itertools import groupby
from statistics import median
from typing import Any, Mapping, NamedTuple, Sequence, Tuple

from ...core.config import (
    LINK,
    LINK_CONFIG,
    OF_ARRIVALS,
    MonitorConfig,
    Section,
    SignalConfig,
    YamlFile,
    load_config,
    parse_yaml,
    read_kept,
    read_monitor,
    settings_of,
    template_name,
)
from ...core.judge import MAX_EVIDENCE, STATE, THRESHOLDS, SavedMonitor, read_saved_monitor
from ...core.nodes.alert_system import TICK_PERIOD_S
from ...core.values import ConfigError, JsonObject, Level, MessageError, Transition, count_text, printable
from ...ops.store import queries
from ...ops.store.rows import StoredTransition
from ...recordings.judging import Judge, JudgedEvent, JudgedSample
from ...recordings.middleware import Player
from ...recordings.reading import Recordings
from ..embedded import sections_of_nodes
from ..history.history_entries import time_text
from .threshold_cases import TIME_TOLERANCE_S, ThresholdTest, compare, parse_tests, run_test

FROM_ALERT = "--from-alert"
"""The option that asks for it; what it reports begins with it."""
LONGEST_BEFORE_S = 3600.0
"""Samples that are longer before the alert are left out."""
_SAME_TIME_S = 0.002
"""Two times closer than this are the same: those of stored samples are rounded."""
_INTERVALS_S = (0.001, 0.01, 0.1, 1.0)
"""Of exact times: the first that needs no more steps than `_MOST_STEPS`."""
_MOST_STEPS = 120_000
_WIDTH = 100

Samples = Sequence[Tuple[float, float]]
"""Time in s and value in the signal's unit, oldest first; NaN if the sample was bad."""


class PastAlert(NamedTuple):
    """An alert that came, with all that is known about it. Times are in s on one clock, unless noted."""

    title: str
    """As in `alert 41 of r3`."""
    transition: Transition | StoredTransition
    wall_s: float
    """When it came, in s since 1970."""
    settings: Mapping[str, JsonObject]
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


def depends_on(signal: SignalConfig) -> list[str]:
    """Returns the names of the signals that a signal's conditions refer to."""
    return [each.signal for each in (signal.only_if, signal.latch_release_if) if each is not None]


def needed_settings(signals: Mapping[str, SignalConfig], signal: str, robot: str) -> dict[str, dict[str, Any]]:
    """Returns the settings of a signal, which may be an element, and of those that it depends on.

    Raises ConfigError if one is not configured, or if it is a template, which has no samples itself.
    """
    wanted = [signal]
    if signal == LINK:  # a configuration has at least one signal
        wanted += [name for name in signals if name != LINK][:1]
    needed: dict[str, SignalConfig] = {}
    while wanted:
        name = template_name(wanted.pop())
        if name == LINK or name in needed:
            continue
        if name not in signals:
            raise ConfigError(f"{FROM_ALERT}: {printable(name)} is not in the configuration of {robot}")
        needed[name] = signals[name]
        wanted += depends_on(signals[name])
    if signal in needed and needed[signal].is_template:
        raise ConfigError(f"{FROM_ALERT}: {printable(signal)} has no samples itself, only its elements have")
    return {name: settings_of(each) for name, each in needed.items()}


def alert_test(alert: PastAlert, thresholds: str | None = None, *, exact: bool = False) -> AlertTest:
    """Returns the test of an alert, which has been run.

    Args:
        alert: what is known.
        thresholds: the path to write in place of the thresholds in force then.
        exact: whether to write the exact times and values.

    Raises:
        ConfigError: the alert does not occur again with what is stored, or `thresholds` cannot be read.
    """
    config = load_config({"signals": alert.settings})
    test = None if exact else _occurring(config, alert, exact=False)
    test = test or _occurring(config, alert, exact=True)
    if test is None:
        raise ConfigError(f"{FROM_ALERT}: {alert.title} does not occur again: {alert.missing}")
    text = _text_of(alert, test, thresholds)
    config, (written,) = parse_tests(text, "the test")
    differences = [f"{mark} {each}" for mark, each in compare(written.alerts, run_test(config, written)) if mark != " "]
    if not differences:
        return AlertTest(text, f"the test of {alert.title} passes", True)
    what = f"{count_text(len(differences), 'difference')}, first {differences[0]}"
    return AlertTest(text, f"the test of {alert.title} fails with {thresholds or 'these thresholds'}: {what}", False)


def _occurring(config: MonitorConfig, alert: PastAlert, *, exact: bool) -> ThresholdTest | None:
    """Returns the samples until the alert in steps of one interval, with what occurs; None if the alert does not.

    The interval and the values are readable ones that are close to those that were, unless they are `exact`. The series
    begins with the first sample; if times are exact, so that the alert comes at a whole second: then a tick coincides
    with it, as it did.
    """
    samples = {
        name: [each for each in series if alert.time_s - LONGEST_BEFORE_S < each[0] <= alert.time_s + _SAME_TIME_S]
        for name, series in alert.samples.items()
    }
    own_s = [at_s for at_s, _ in samples.get(alert.signal, ())]
    begin_s = alert.time_s - _config_of(config, alert.signal).startup_grace_s - exact
    if own_s:
        begin_s = min(at_s for series in samples.values() for at_s, _ in series)
    if exact:
        begin_s = alert.time_s - max(1.0, math.ceil(alert.time_s - begin_s - _SAME_TIME_S))
    span_s = alert.time_s - begin_s
    gaps_s = [after_s - before_s for before_s, after_s in zip(own_s, own_s[1:])]
    interval_s = max(_readable_number(median(gaps_s or [1.0])), span_s / _MOST_STEPS)
    if exact:
        interval_s = next(each for each in _INTERVALS_S if span_s / each <= _MOST_STEPS)
    series = {}
    for name, timed in samples.items():
        signal = _config_of(config, name)
        scale = 1.0 if signal.reduce else signal.scale  # values of a reduction are in its unit
        places = {max(0, round((at_s - begin_s) / interval_s)): value / scale for at_s, value in timed}
        steps = range(math.ceil((span_s + TICK_PERIOD_S) / interval_s) + 1)
        if timed or name == alert.signal:
            series[name] = list(map((places if exact else _rounded(places)).get, steps))
    test = ThresholdTest(f"{alert.title}: {alert.signal} {alert.transition.to_level.name}", series, [], interval_s)
    occurred = run_test(config, test)
    wanted = alert.signal, alert.transition.to_level
    tolerance_s = TICK_PERIOD_S + interval_s + TIME_TOLERANCE_S
    times_s = [each.at_s for each in occurred if (each.signal, each.level) == wanted]
    end_s = max((each for each in times_s if abs(each - span_s) <= tolerance_s), default=None)
    if end_s is None:
        return None
    count = math.ceil(end_s / interval_s - TIME_TOLERANCE_S) + 1
    return replace(
        test,
        input={name: values[:count] for name, values in series.items()},
        alerts=[each for each in occurred if each.at_s <= end_s],
    )


def _config_of(config: MonitorConfig, signal: str) -> SignalConfig:
    return LINK_CONFIG if signal == LINK else config.signals[template_name(signal)]


def _rounded(places: Mapping[int, float]) -> Mapping[int, float]:
    """Returns values that are rounded to a hundredth of their range."""
    numbers = list(filter(math.isfinite, places.values())) or [0.0]
    spread = max(numbers) - min(numbers) or abs(numbers[0]) / 10.0
    if not 0.0 < spread < math.inf:
        return places
    decimals = 2 - math.floor(math.log10(spread))
    return {place: round(value, decimals) for place, value in places.items()}


def _readable_number(value: float) -> float:
    """Returns a number with one digit if that is within 4 % of it, else with two."""
    short = float(f"{value:.1g}")
    return max(short if abs(short - value) <= 0.04 * value else float(f"{value:.2g}"), 0.001)


def _text_of(alert: PastAlert, test: ThresholdTest, thresholds: str | None) -> str:
    import yaml  # --help needs no library

    tree = {
        "thresholds": thresholds or {"signals": alert.settings},
        "tests": [
            {
                "name": test.name,
                "interval_s": test.interval_s,
                "input": {name: series_text(series) for name, series in test.input.items()},
                "alerts": [
                    {"at_s": each.at_s, "signal": each.signal, "level": each.level.name} for each in test.alerts
                ],
            }
        ],
    }
    title = f"{alert.title[:1].upper()}{alert.title[1:]}, {time_text(alert.wall_s)}: {alert.transition.text}"
    text = yaml.safe_dump(tree, default_flow_style=None, sort_keys=False, allow_unicode=True, width=_WIDTH)
    return printable(f"# {title}") + f"\n{text}"


def series_text(series: Sequence[float | None]) -> str:
    """Returns samples in the notation of a series."""
    items = []
    for text, run in groupby("_" if value is None else _number_text(value) for value in series):
        count = len(list(run))
        items.append(f"{text}x{count - (text != '_')}" if count > 1 else text)
    return " ".join(items)


def _number_text(value: float) -> str:
    text = repr(float(value))
    return text[:-2] if text.endswith(".0") else text


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
    samples: list[tuple[float, float]] = []
    missing = "a history has no times of arrivals"
    if signal.statistic not in OF_ARRIVALS:  # else stored samples are values of the statistic
        samples = [each for each in queries.evidence(connection, transition.id) if math.isfinite(each[0])]
        missing = f"a history has the good samples in the window of an alert, at most {MAX_EVIDENCE}, and no others"
        is_judged = signal.is_status or transition.signal == LINK or transition.bound is not None
        if transition.to_level is Level.ERROR and not is_judged:  # a bad sample was the reason
            value = transition.value
            samples.append((transition.wall_s, float(value) if isinstance(value, (int, float)) else math.nan))
    recorder = "a black box (ops.yaml: black_box) would have recorded them"
    if transition.black_box:
        recorder = f"its black box {transition.black_box} has them: name its folder by --ops, or the file itself"
    return PastAlert(
        title=f"alert {transition.id} of {transition.robot}",
        transition=transition,
        wall_s=transition.wall_s,
        settings=settings,
        time_s=transition.wall_s,
        samples={transition.signal: samples},
        missing=f"{missing}; {recorder}",
        black_box=transition.black_box,
    )


def black_box_alerts(path: str) -> list[PastAlert]:
    """Returns the alerts that a black box has recorded, in the order in which they came.

    It is judged by its own thresholds, from its own states on.

    Raises:
        ConfigError: it cannot be read, is no black box, or has no alert that a test can have.
    """
    events: list[JudgedEvent] = []
    samples: dict[str, list[tuple[float, float]]] = {}

    def collect(_: str, signal: SignalConfig, sample: JudgedSample) -> None:
        value = math.nan if sample.value is None else sample.value
        samples.setdefault(signal.name, []).append((sample.now_s, value))

    with Recordings([path]) as recordings:
        file, saved = attached(recordings)
        if file is None:
            raise ConfigError(f"{FROM_ALERT}: has no thresholds.yaml; expected a black box", file=path)
        section = sections_of_nodes(file)["alert_system"]
        with file.located(section.path):
            config = read_monitor(Section((), section.tree))
            player = Player(
                recordings,
                use_sim_time=section.tree.get("use_sim_time") is True,
                begin_ns=None if saved is None else round(saved.time_s * 1e9),
            )
            begin_s = player.wall_s
            judge = Judge(player, events.append, collect)
            judge.add("", section.tree, saved)
            judge.run()
    alerts: list[PastAlert] = []
    for judged in events:
        transition = judged.event
        if not isinstance(transition, Transition) or transition.repeat or transition.to_level is Level.OK:
            continue
        signal = config.signals.get(template_name(transition.signal))
        if signal is None or (signal.is_template and signal.name == transition.signal):
            continue  # a source, the link or a template: they have no samples
        names = [transition.signal, *depends_on(signal)]
        alerts.append(
            PastAlert(
                title=f"alert {len(alerts) + 1} of {printable(os.path.basename(path))}",
                transition=transition,
                wall_s=judged.wall_s,
                settings=needed_settings(config.signals, transition.signal, config.robot_name),
                time_s=transition.now_s,
                samples={each: samples[each] for each in names if each in samples},
                missing=f"what came before the recording, which begins {judged.wall_s - begin_s:.0f} s before it, is "
                "missing; a longer before_s of black_box in ops.yaml would have recorded it",
            )
        )
    if not alerts:
        raise ConfigError(f"{FROM_ALERT}: gives no alert when it is replayed", file=path)
    return alerts


def attached(recordings: Recordings) -> tuple[YamlFile | None, SavedMonitor | None]:
    """Returns the thresholds and the states at the beginning that a black box has attached, as far as there are any.

    Raises ConfigError if they cannot be read.
    """
    path, texts = recordings.paths[0], recordings.attachments
    file = parse_yaml(texts[THRESHOLDS], os.path.join(path, THRESHOLDS)) if THRESHOLDS in texts else None
    try:
        return file, read_saved_monitor(texts[STATE]) if STATE in texts else None
    except MessageError as error:
        raise ConfigError(str(error), file=path) from None
