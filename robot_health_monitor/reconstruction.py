"""The series of a unit test in which a recorded alert occurs again, from what is stored of its samples.

An alert depends on its samples, their times, the ticks between them, and what was before. The alert comes at a whole
second of the test, so that a tick coincides with it, as in the monitor. Each attempt is run: what is returned is what
happens. Attempts go from what is recorded to what has to be assumed, which a remark says.
"""

from __future__ import annotations

import math
from typing import Dict, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.config import MonitorConfig
from robot_health_monitor.core.continuity import MAX_EVIDENCE
from robot_health_monitor.core.formatting import duration_text, list_text, number_text
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.signal_config import LINK, LINK_CONFIG, SignalConfig, template_name

from .alert_attempts import (
    SAME_TIME_S,
    Attempt,
    Conditions,
    RecordedAlert,
    Samples,
    attempts,
    conditions,
    depends_on,
    window_begin_s,
)
from .threshold_tests import TIME_TOLERANCE_S, Alert, ThresholdTest, run_test

_INTERVALS_S = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.001)
_MOST_STEPS = 120_000

_CONDITION_STEP_S = 1.0


class Reconstruction(NamedTuple):
    """Series and what they give."""

    interval_s: float
    series: Mapping[str, Sequence[Optional[float]]]
    """By signal, that of the alert last; in the unit of the messages, before `scale`."""
    at_s: float
    """When the alert occurs, from the beginning of the series on."""
    alerts: Sequence[Alert]
    """All that occur."""
    remark: str
    """What is assumed beyond the recorded samples; empty: nothing."""
    missing: str
    """Why the alert does not occur; empty: it does."""


class _Grid(NamedTuple):
    interval_s: float
    seconds: float
    """When the alert comes."""


class _Search:
    """The search for the attempt in which one alert occurs."""

    def __init__(self, config: MonitorConfig, recorded: RecordedAlert, stored: Mapping[str, Samples]) -> None:
        self._config = config
        self._recorded = recorded
        is_link = recorded.signal == LINK
        self._signal = LINK_CONFIG if is_link else config.signals[template_name(recorded.signal)]
        with_series = {name: each for name, each in stored.items() if self._has_series(name)}
        self._conditions = [
            each._replace(samples={name: samples for name, samples in each.samples.items() if self._has_series(name)})
            for each in conditions(self._signal, recorded, with_series)
        ] or [Conditions({})]
        self._window_begin_s = window_begin_s(self._signal, recorded)

    def _has_series(self, name: str) -> bool:
        """Whether a signal can have a series: a template has none, only its elements have."""
        signal = self._config.signals.get(template_name(name))
        return signal is not None and not (signal.is_template and name == signal.name)

    def found(self) -> Reconstruction:
        first: Optional[Reconstruction] = None
        nearly: Optional[Reconstruction] = None
        for attempt in attempts(self._signal, self._recorded):
            for grid in _grids(attempt.samples, self._signal, self._phases_s()):
                for others in self._conditions:
                    found, is_same = self._run(attempt, grid, others)
                    if is_same:
                        return found
                    nearly = nearly or (None if found.missing else found)
                    first = first or found
        assert first is not None
        return nearly or first

    def _phases_s(self) -> Sequence[float]:
        """Returns how long after a tick the alert may have come: a tick has given it, or the transition before."""
        recorded = self._recorded
        before_s = (recorded.wall_s - recorded.before[-1].wall_s) % 1.0 if recorded.before else 0.0
        return (0.0,) if min(before_s, 1.0 - before_s) < SAME_TIME_S else (0.0, round(before_s, 3))

    def _run(self, attempt: Attempt, grid: _Grid, others: Conditions) -> Tuple[Reconstruction, bool]:
        """Runs an attempt; returns also whether the level before is as recorded."""
        recorded = self._recorded
        series: Dict[str, List[Optional[float]]] = {}  # conditions first: they hold when a sample comes
        for name, samples in others.samples.items():
            relative = [(time_s - recorded.wall_s, value) for time_s, value in samples]
            signal = self._config.signals[template_name(name)]
            series[name] = self._series(signal, _held(signal, relative, grid) if others.is_held else relative, grid)
        series[recorded.signal] = self._series(self._signal, attempt.samples, grid)
        occurred = run_test(self._config, ThresholdTest("", grid.interval_s, series, ()))
        own = [place for place, alert in enumerate(occurred) if alert.signal == recorded.signal]
        levels = [Level.OK, *(occurred[place].level for place in own)]
        wanted = (recorded.from_level, recorded.to_level)
        same = [number for number, pair in enumerate(zip(levels, levels[1:])) if pair == wanted]
        last = len(own) - 1
        if attempt.is_free and same:
            last = same[-1]
        is_found = bool(own) and levels[last + 1] is recorded.to_level
        at_s = occurred[own[last]].at_s if own else grid.seconds
        is_found = is_found and (attempt.is_free or abs(at_s - grid.seconds) < TIME_TOLERANCE_S)
        remark = "; ".join(text for text in (attempt.remark, others.remark) if text)
        is_same = is_found and levels[last] is recorded.from_level
        if is_found and not is_same:
            text = f"the level before it was {recorded.from_level.name}, which needs earlier samples"
            remark = f"{remark}; {text}" if remark else text
        if is_found and attempt.is_free:  # what comes after it is no part of it
            length = math.ceil(at_s / grid.interval_s - TIME_TOLERANCE_S) + 1
            series = {name: values[:length] for name, values in series.items()}
            occurred = [alert for alert in occurred if alert.at_s <= at_s]
        missing = "" if is_found else self._missing([occurred[place] for place in own])
        return Reconstruction(grid.interval_s, series, at_s, occurred, remark, missing), is_same

    def _series(self, signal: SignalConfig, samples: Samples, grid: _Grid) -> List[Optional[float]]:
        series: List[Optional[float]] = [None] * (round(grid.seconds / grid.interval_s) + 1)
        has_scale = signal.scale != 1.0 and not signal.reduce
        begin_s = self._window_begin_s if signal is self._signal else None
        for time_s, value in samples:
            place = round((grid.seconds + time_s) / grid.interval_s)
            if begin_s is not None and time_s < begin_s - 1e-6:  # rounded it might be in the window
                place = min(place, math.ceil((grid.seconds + begin_s) / grid.interval_s - 1e-6) - 1)
            if 0 <= place < len(series):
                series[place] = value / signal.scale if has_scale else value
        return series

    def _missing(self, alerts: Sequence[Alert]) -> str:
        recorded, signal = self._recorded, self._signal
        others = depends_on(signal)
        if not recorded.samples:
            reason = "no samples are stored with it"
        elif others:
            reason = f"it depends on the samples of {list_text(others)}, too"
        elif len(recorded.samples) >= MAX_EVIDENCE and recorded.recorded_since_s is None:
            reason = f"only {MAX_EVIDENCE} of the samples in its window are stored"
        else:
            recorded_s = duration_text(recorded.wall_s - recorded.samples[0][0])
            reason = f"what came more than {recorded_s} before it is not stored"
        happens = ", ".join(f"{alert.level.name} at {number_text(alert.at_s)} s" for alert in alerts[:5])
        return f"{reason}; these samples give {happens or 'no alert'}"


def reconstruct(config: MonitorConfig, recorded: RecordedAlert, stored: Mapping[str, Samples]) -> Reconstruction:
    """Returns the series of the first attempt in which the alert occurs; else that of the recorded samples.

    `stored` has samples of the signals that its signal depends on, by their names: times in s since 1970.
    """
    return _Search(config, recorded, stored).found()


def _held(signal: SignalConfig, samples: Samples, grid: _Grid) -> Samples:
    """Returns the latest of some samples at each step until the alert."""
    step_s = min(_CONDITION_STEP_S, signal.stale_after_s / 2.0 or _CONDITION_STEP_S)
    count = int(grid.seconds / step_s)
    held: List[Tuple[float, float]] = []
    place = 0
    for number in range(count, -1, -1):
        time_s = -number * step_s
        while place + 1 < len(samples) and samples[place + 1][0] <= time_s + SAME_TIME_S:
            place += 1
        held.append((time_s, samples[place][1]))
    return held


def _grids(samples: Samples, signal: SignalConfig, phases_s: Sequence[float]) -> Iterator[_Grid]:
    """Yields intervals on which the samples lie, or nearly so."""
    span_s = -samples[0][0] if samples else signal.startup_grace_s + 1.0
    for phase_s in phases_s:
        seconds = max(1.0, math.ceil(span_s - phase_s - SAME_TIME_S)) + phase_s
        near: List[float] = []
        for interval_s in _INTERVALS_S:
            if seconds / interval_s > _MOST_STEPS:
                break
            places = [(seconds + time_s) / interval_s for time_s, _ in samples] + [seconds / interval_s]
            if len({round(place) for place in places[:-1]}) < len(samples):
                continue
            if all(abs(place - round(place)) * interval_s <= SAME_TIME_S / 10.0 for place in places):
                yield _Grid(interval_s, seconds)
                break
            near.append(interval_s)
        for interval_s in near[-1:]:
            yield _Grid(interval_s, round(seconds / interval_s) * interval_s)
        if not near and samples and phase_s == phases_s[0]:
            yield _Grid(next((each for each in _INTERVALS_S[::-1] if seconds / each <= _MOST_STEPS), 1.0), seconds)
