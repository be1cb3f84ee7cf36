"""The series of a unit test in which a recorded alert occurs again, from the samples that are stored with it.

An alert depends on its samples, their times, the ticks between them, and what was before. The alert comes at a whole
second of the test, so that a tick coincides with it, as in the monitor. Each attempt is run: what is returned is what
happens. Attempts go from what is recorded to what has to be assumed, which a remark says.
"""

from __future__ import annotations

import math
from statistics import median
from typing import Any, Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.config import MonitorConfig
from robot_health_monitor.core.continuity import MAX_EVIDENCE
from robot_health_monitor.core.formatting import duration_text, number_text
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.signal_config import LINK, LINK_CONFIG, OF_ARRIVALS, SignalConfig, template_name

from .threshold_tests import Alert, ThresholdTest, run_test

_INTERVALS_S = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.001)
_MOST_STEPS = 120_000
_SAME_TIME_S = 0.002
"""Two times closer than this are the same: those of stored samples are rounded."""
_MOST_ASSUMED = 3_000
_LONGEST_BEFORE_S = 3600.0
_LONGEST_S = 50_000.0

Samples = Sequence[Tuple[float, float]]
"""Time in s and value, oldest first; NaN: bad."""


class RecordedAlert(NamedTuple):
    """A transition of a signal and what is known about its samples. Times are in s since 1970."""

    signal: str
    from_level: Level
    to_level: Level
    wall_s: float
    value: Any
    bound: Optional[float]
    samples: Samples
    """Of its window, at most `MAX_EVIDENCE`; without bad ones. Of an arrival statistic, its values."""
    before: Sequence[RecordedAlert] = ()
    """Earlier transitions of the signal, oldest first."""

    def is_invalid(self, signal: SignalConfig) -> bool:
        """Whether bad data gave it."""
        is_judged = signal.is_status or self.signal == LINK or self.bound is not None
        return self.to_level is Level.ERROR and not is_judged


class Reconstruction(NamedTuple):
    """A series and what it gives."""

    interval_s: float
    series: Sequence[Optional[float]]
    """In the unit of the messages, before `scale`."""
    at_s: float
    """When the alert occurs, from the beginning of the series on."""
    alerts: Sequence[Alert]
    """All that occur."""
    remark: str
    """What is assumed beyond the recorded samples; empty: nothing."""
    missing: str
    """Why the alert does not occur; empty: it does."""


class _Attempt(NamedTuple):
    samples: Samples
    """Their times are relative to the alert, so not positive."""
    remark: str = ""
    is_free: bool = False
    """Whether the alert may come at another time, because the times are assumed."""


def reconstruct(config: MonitorConfig, recorded: RecordedAlert) -> Reconstruction:
    """Returns the series of the first attempt in which the alert occurs; else that of the recorded samples."""
    signal = LINK_CONFIG if recorded.signal == LINK else config.signals[template_name(recorded.signal)]
    first: Optional[Reconstruction] = None
    nearly: Optional[Reconstruction] = None
    for attempt in _attempts(signal, recorded):
        for interval_s, seconds in _grids(attempt.samples, signal, _phases_s(recorded)):
            found, is_same = _run(config, signal, recorded, attempt, interval_s, seconds)
            if is_same:
                return found
            nearly = nearly or (None if found.missing else found)
            first = first or found
    assert first is not None
    return nearly or first


def _phases_s(recorded: RecordedAlert) -> Sequence[float]:
    """Returns how long after a tick the alert may have come: a tick has given it, or the transition before."""
    before_s = (recorded.wall_s - recorded.before[-1].wall_s) % 1.0 if recorded.before else 0.0
    return (0.0,) if min(before_s, 1.0 - before_s) < _SAME_TIME_S else (0.0, round(before_s, 3))


def _run(
    config: MonitorConfig,
    signal: SignalConfig,
    recorded: RecordedAlert,
    attempt: _Attempt,
    interval_s: float,
    seconds: float,
) -> Tuple[Reconstruction, bool]:
    """Runs an attempt whose alert comes after some seconds; returns also whether the level before is as recorded."""
    series: List[Optional[float]] = [None] * (round(seconds / interval_s) + 1)
    has_scale = signal.scale != 1.0 and not signal.reduce
    for time_s, value in attempt.samples:
        series[round((seconds + time_s) / interval_s)] = value / signal.scale if has_scale else value
    test = ThresholdTest("", interval_s, {recorded.signal: series}, ())
    alerts = [alert for alert in run_test(config, test) if alert.signal == recorded.signal]
    is_found = bool(alerts) and alerts[-1].level is recorded.to_level
    is_found = is_found and (attempt.is_free or abs(alerts[-1].at_s - seconds) < 1e-6)
    before = alerts[-2].level if len(alerts) > 1 else Level.OK
    remark = attempt.remark
    if before is not recorded.from_level:
        remark = _remarks(remark, f"the level before it was {recorded.from_level.name}, which needs earlier samples")
    at_s = alerts[-1].at_s if is_found else seconds
    missing = "" if is_found else _missing(signal, recorded, alerts)
    found = Reconstruction(interval_s, series, at_s, alerts, remark, missing)
    return found, is_found and before is recorded.from_level


def _missing(signal: SignalConfig, recorded: RecordedAlert, alerts: Sequence[Alert]) -> str:
    others = [each.signal for each in (signal.only_if, signal.latch_release_if) if each is not None]
    if not recorded.samples:
        reason = "no samples are stored with it"
    elif others:
        reason = f"it depends on the samples of {' and '.join(others)}, too"
    elif len(recorded.samples) >= MAX_EVIDENCE:
        reason = f"only {MAX_EVIDENCE} of the samples in its window are stored"
    else:
        recorded_s = duration_text(recorded.wall_s - recorded.samples[0][0])
        reason = f"what came more than {recorded_s} before it is not stored"
    happens = ", ".join(f"{alert.level.name} at {number_text(alert.at_s)} s" for alert in alerts[:5])
    return f"{reason}; these samples give {happens or 'no alert'}"


def _grids(samples: Samples, signal: SignalConfig, phases_s: Sequence[float]) -> Iterator[Tuple[float, float]]:
    """Yields intervals on which the samples lie, or nearly so, and when the alert comes, in s."""
    span_s = -samples[0][0] if samples else signal.startup_grace_s + 1.0
    for phase_s in phases_s:
        seconds = max(1.0, math.ceil(span_s - phase_s - _SAME_TIME_S)) + phase_s
        near: List[float] = []
        for interval_s in _INTERVALS_S:
            if seconds / interval_s > _MOST_STEPS:
                break
            places = [(seconds + time_s) / interval_s for time_s, _ in samples] + [seconds / interval_s]
            if len({round(place) for place in places[:-1]}) < len(samples):
                continue
            if all(abs(place - round(place)) * interval_s <= _SAME_TIME_S / 10.0 for place in places):
                yield interval_s, seconds
                break
            near.append(interval_s)
        for interval_s in near[-1:]:
            yield interval_s, round(seconds / interval_s) * interval_s
        if not near and samples and phase_s == phases_s[0]:
            yield next((each for each in _INTERVALS_S[::-1] if seconds / each <= _MOST_STEPS), 1.0), seconds


def _attempts(signal: SignalConfig, recorded: RecordedAlert) -> Iterator[_Attempt]:
    """Yields samples before the alert: those that are recorded, then with what must have been before."""
    if signal.statistic in OF_ARRIVALS and recorded.to_level is not Level.STALE:
        yield from _arrivals(signal, recorded)
        return
    longest_s = min(signal.window_s + signal.stale_after_s + _LONGEST_BEFORE_S, _LONGEST_S)
    base = [
        (min(time_s - recorded.wall_s, 0.0), value)
        for time_s, value in recorded.samples
        if -longest_s < time_s - recorded.wall_s < _LONGEST_BEFORE_S
    ]
    if base and base[-1][0] > -_SAME_TIME_S:
        base[-1] = (0.0, base[-1][1])
    bad, bad_remark = _bad_samples(signal, recorded, base)
    if bad:
        base = sorted({**dict(bad), **dict(base)}.items())
    yield _Attempt(base, bad_remark)
    if not base:
        return
    step_s = _step_s(signal, base)
    earlier = _earlier(signal, recorded, base)
    if earlier:
        joined, held_s = _joined(earlier, base, signal, step_s)
        held = f"where samples are not stored, the one before is repeated ({duration_text(held_s)} in all)"
        yield _Attempt(joined, _remarks(bad_remark, held if held_s else ""))
    recorded_text = f"recorded are the {duration_text(-base[0][0])} before it"
    for samples, text in filter(lambda found: found[0], _preceded(signal, recorded, base, step_s)):
        seconds = duration_text(base[0][0] - samples[0][0])
        yield _Attempt([*samples, *base], _remarks(bad_remark, f"{recorded_text}; {text} for {seconds} before them"))


def _earlier(signal: SignalConfig, recorded: RecordedAlert, base: Samples) -> List[Tuple[float, float]]:
    """Returns the samples of the transitions before that are older than those of the alert."""
    found: Dict[float, float] = {}
    for each in recorded.before:
        if each.wall_s > recorded.wall_s - _LONGEST_BEFORE_S and signal.statistic not in OF_ARRIVALS:
            found.update((time_s - recorded.wall_s, value) for time_s, value in each.samples)
            if each.is_invalid(signal):
                found[each.wall_s - recorded.wall_s] = math.nan
    return sorted((time_s, value) for time_s, value in found.items() if time_s < base[0][0] - _SAME_TIME_S)


def _preceded(
    signal: SignalConfig, recorded: RecordedAlert, base: Samples, step_s: float
) -> Iterator[Tuple[List[Tuple[float, float]], str]]:
    """Yields what may have been before the samples, and what that is in words."""
    begin_s, first = base[0]
    window_min_s = 0.0 if signal.statistic == "last" else signal.window_min_s

    def times_s(from_s: float, until_s: float) -> List[float]:
        count = min(math.ceil((until_s - from_s) / step_s - 0.5), _MOST_ASSUMED)
        return [from_s + number * step_s for number in range(count)]

    slope = _slope([each for each in base if each[0] <= begin_s / 2.0])
    judged = recorded.value if isinstance(recorded.value, float) else first
    for for_s in sorted({signal.for_s, signal.error_for_s}):
        # A condition that begins exactly so long before the alert.
        from_s = -for_s - window_min_s
        if from_s < begin_s - _SAME_TIME_S:
            times = times_s(from_s, min(begin_s, -for_s) - step_s / 4.0)
            if for_s and -for_s < begin_s - step_s / 4.0:
                times += times_s(-for_s, begin_s)
            for value, text in ((first, "the first value is repeated"), (judged, "its own value is repeated")):
                if not math.isnan(value):
                    yield [(time_s, value) for time_s in times], text
            if slope:
                trend = [(time_s, first + slope * (time_s - begin_s)) for time_s in times]
                yield trend, "their trend is continued"
    held = _number_before(recorded)
    if held is not None:
        # The alert before, out of the window when this one comes.
        until_s = begin_s if signal.statistic == "last" else min(begin_s, -signal.window_s - _SAME_TIME_S)
        needed_s = max(signal.for_s, signal.error_for_s) + window_min_s + 2.0 * step_s + 2.0
        from_s = until_s - step_s / 2.0 - needed_s
        times = times_s(from_s, until_s - step_s / 4.0)
        yield [(time_s, held) for time_s in times], "the value of the alert before is repeated"
    if recorded.before and recorded.before[-1].is_invalid(signal):
        needed_s = signal.invalid_for_s + 2.0
        times = times_s(begin_s - needed_s, begin_s - step_s / 4.0)
        yield [(time_s, math.nan) for time_s in times], "bad samples stand"


def _remarks(*texts: str) -> str:
    return "; ".join(text for text in texts if text)


def _step_s(signal: SignalConfig, samples: Samples) -> float:
    """Returns the usual time between samples, in s."""
    gaps_s = [after[0] - before[0] for before, after in zip(samples, samples[1:])]
    step_s = max(median(gaps_s), 0.01) if gaps_s else 1.0
    return min(step_s, signal.stale_after_s / 2.0) if signal.stale_after_s else step_s


def _bad_samples(signal: SignalConfig, recorded: RecordedAlert, base: Samples) -> Tuple[List[Tuple[float, float]], str]:
    """Returns the bad samples before the alert, which are not stored, and the remark about them."""
    remark = "bad samples are not stored; those that must have come are assumed"
    begin_s = base[0][0] if base else -math.inf
    found = {
        each.wall_s - recorded.wall_s: math.nan
        for each in recorded.before
        if each.is_invalid(signal) and begin_s < each.wall_s - recorded.wall_s < -_SAME_TIME_S
    }
    if recorded.is_invalid(signal) and not (base and base[-1][0] == 0.0):
        number = float(recorded.value) if isinstance(recorded.value, (int, float)) else math.nan
        since_s = -signal.invalid_for_s
        if base:
            since_s = max(since_s, base[-1][0] + min(0.01, -base[-1][0] / 2.0))
        step_s = min(_step_s(signal, base), 1.0)
        times_s = [since_s + step * step_s for step in range(min(int(-since_s / step_s), _MOST_ASSUMED) + 1)]
        found.update((time_s, number) for time_s in [*(each for each in times_s if each < -_SAME_TIME_S), 0.0])
    return list(found.items()), remark if found else ""


def _joined(
    earlier: Samples, base: Samples, signal: SignalConfig, step_s: float
) -> Tuple[List[Tuple[float, float]], float]:
    """Returns both, with the value before a gap repeated, and for how long that is, in s."""
    joined: List[Tuple[float, float]] = []
    held_s = 0.0
    limit_s = max(3.0 * step_s, 0.9 * signal.stale_after_s) if signal.stale_after_s else math.inf
    for time_s, value in [*earlier, *base]:
        if joined and time_s - joined[-1][0] > limit_s and len(joined) < _MOST_ASSUMED:
            begin_s, held = joined[-1]
            held_s += time_s - begin_s
            count = min(int((time_s - begin_s - step_s / 2.0) / step_s), _MOST_ASSUMED)
            joined += [(begin_s + number * step_s, held) for number in range(1, count + 1)]
        joined.append((time_s, value))
    return joined, held_s


def _slope(samples: Samples) -> float:
    """Returns the slope of the least-squares line per s; 0 if there is none."""
    if len(samples) < 2:
        return 0.0
    mean_s = sum(time_s for time_s, _ in samples) / len(samples)
    squares = sum((time_s - mean_s) ** 2 for time_s, _ in samples)
    slope = sum((time_s - mean_s) * value for time_s, value in samples) / squares if squares else 0.0
    return slope if math.isfinite(slope) else 0.0


def _arrivals(signal: SignalConfig, recorded: RecordedAlert) -> Iterator[_Attempt]:
    """Yields arrivals at assumed times, which have the recorded rate or gap."""
    remark = "the times of arrivals are not stored: even ones stand for them"
    value = recorded.value if isinstance(recorded.value, (int, float)) else 0.0
    if not 0.0 < value < 1e4:
        yield _Attempt([], remark)
        return
    sample = min(max(1.0, signal.valid_min or 1.0), signal.valid_max or math.inf) / signal.scale
    if signal.scale != 1.0 and not signal.reduce:
        sample *= signal.scale
    needed_s = max(signal.for_s, signal.error_for_s) + signal.window_min_s + 2.0
    before = (
        recorded.samples[0][1] if recorded.samples and recorded.from_level is Level.OK else _number_before(recorded)
    )
    if signal.statistic == "largest_gap_s":
        step_s = min(0.5, (recorded.bound or 1.0) / 4.0)
        count = min(math.ceil(needed_s / step_s), _MOST_ASSUMED)
        after = [(-number * step_s, sample) for number in range(math.ceil(signal.for_s / step_s) + 2)]
        begin_s = after[-1][0] - value
        yield _Attempt(
            [*((begin_s - number * step_s, sample) for number in range(count, -1, -1)), *after[::-1]], remark, True
        )
        return
    count = min(math.ceil((needed_s + signal.window_s) * value) + 2, _MOST_ASSUMED)
    at_rate = [(-number / value, sample) for number in range(count, -1, -1)]
    yield _Attempt(at_rate, remark, True)
    if before is not None and 0.0 < before < 1e4:
        begin_s = at_rate[0][0]
        count = min(math.ceil((needed_s + signal.window_s) * before) + 2, _MOST_ASSUMED)
        first = [(begin_s - number / before, sample) for number in range(count, 0, -1)]
        yield _Attempt([*first, *at_rate], remark, True)


def _number_before(recorded: RecordedAlert) -> Optional[float]:
    value = recorded.before[-1].value if recorded.before else None
    return value if isinstance(value, float) else None
