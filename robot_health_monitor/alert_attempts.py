"""What may have been before an alert: attempts at a series of its signal, from what is recorded to what is assumed.

A history has the samples of the window of each alert, a black box all samples since its beginning. Neither has what
filled the window before that, and an alert may depend on it: through `for_s`, or through the level before it. Each
attempt adds a little more: the windows of earlier alerts, then a constant course before them.
"""

from __future__ import annotations

import math
from statistics import median
from typing import Any, Dict, Iterable, Iterator, List, Mapping, NamedTuple, Optional, Sequence, Tuple

from robot_health_monitor.core.continuity import MAX_EVIDENCE
from robot_health_monitor.core.formatting import duration_text, list_text
from robot_health_monitor.core.model import Level
from robot_health_monitor.core.signal_config import LINK, OF_ARRIVALS, Condition, SignalConfig

SAME_TIME_S = 0.002
"""Two times closer than this are the same: those of stored samples are rounded."""
_MOST_ASSUMED = 3_000
LONGEST_BEFORE_S = 3600.0
"""How far before an alert samples are looked for."""
_LONGEST_S = 50_000.0
_MARGINS = (0.003, 0.01, 0.03, 0.1, 0.2, 0.4, 0.8, 1.6, 4.0)
"""Distances of assumed values from a bound, relative to it."""
_MOST_STAGES = 3

Samples = Sequence[Tuple[float, float]]
"""Time in s and value, oldest first; NaN: bad."""
_Found = List[Tuple[float, float]]


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
    recorded_since_s: Optional[float] = None
    """Since when `samples` has all samples, bad ones and arrivals too; None: it has those of a history."""

    def is_invalid(self, signal: SignalConfig) -> bool:
        """Whether bad data gave it."""
        is_judged = signal.is_status or self.signal == LINK or self.bound is not None
        return self.to_level is Level.ERROR and not is_judged

    def known_s(self, signal: SignalConfig) -> Tuple[float, float]:
        """Returns the time of which all good samples are known."""
        if self.recorded_since_s is not None:
            return self.recorded_since_s, self.wall_s
        is_cut = len(self.samples) >= MAX_EVIDENCE
        return self.samples[0][0] if is_cut else self.wall_s - signal.window_s, self.wall_s


class Attempt(NamedTuple):
    """Samples with which the alert may occur again."""

    samples: Samples
    """Their times are relative to the alert, so not positive."""
    remark: str = ""
    """What is assumed."""
    is_free: bool = False
    """Whether the alert may come at another time, because the times are assumed."""


def depends_on(signal: SignalConfig) -> List[str]:
    """Returns the names of the signals that a signal's conditions refer to."""
    return [each.signal for each in (signal.only_if, signal.latch_release_if) if each is not None]


class Conditions(NamedTuple):
    """Samples of the signals that an alert's signal depends on: `only_if` and `latch_release_if`."""

    samples: Mapping[str, Samples]
    """By signal; times in s since 1970, values in its unit."""
    is_held: bool = False
    """Whether each value is repeated until the next one."""
    remark: str = ""
    """What is assumed."""


def conditions(signal: SignalConfig, recorded: RecordedAlert, stored: Mapping[str, Samples]) -> Iterator[Conditions]:
    """Yields the samples of other signals that are stored, then assumed values in their place."""
    assumed: Dict[str, Samples] = {}
    for condition, should_hold in ((signal.latch_release_if, recorded.to_level is Level.OK), (signal.only_if, True)):
        if condition is not None:
            value = _value_for(condition, holds=should_hold)
            begin_s = recorded.wall_s - _LONGEST_S
            assumed[condition.signal] = [(begin_s, value)]
            if condition is signal.latch_release_if and should_hold:
                assumed[condition.signal] = [(begin_s, _value_for(condition, holds=False)), (recorded.wall_s, value)]
    known = {name: samples for name, samples in stored.items() if samples and name in assumed}
    is_held = recorded.recorded_since_s is None
    if known.keys() == assumed.keys():
        yield Conditions(
            known, is_held, "the condition is judged by stored values, 10 s apart" if known and is_held else ""
        )
    elif known:
        yield Conditions({**assumed, **known}, True, _assumed_text(assumed.keys() - known.keys()))
    if assumed:
        yield Conditions(assumed, True, _assumed_text(assumed))


def _assumed_text(names: Iterable[str]) -> str:
    return f"samples of {list_text(sorted(names))} are not stored; values that meet the condition are assumed"


def _value_for(condition: Condition, *, holds: bool) -> float:
    """Returns a value with which a condition holds, or does not."""
    number, upper = condition.number, condition.upper
    nearby = [number, number + 1.0, number - 1.0, (number + min(upper, number + 2.0)) / 2.0, min(upper, 1e9) + 1.0]
    return next((value for value in nearby if condition.holds(value) is holds), number)


def attempts(signal: SignalConfig, recorded: RecordedAlert) -> Iterator[Attempt]:
    """Yields samples before the alert: those that are recorded, then with what must have been before."""
    are_arrivals = signal.statistic in OF_ARRIVALS and recorded.recorded_since_s is None
    if are_arrivals and recorded.to_level is not Level.STALE:
        yield from _arrivals(signal, recorded)
        return
    longest_s = min(signal.window_s + signal.stale_after_s + LONGEST_BEFORE_S, _LONGEST_S)
    base = [
        (min(time_s - recorded.wall_s, 0.0), value)
        for time_s, value in recorded.samples
        if -longest_s < time_s - recorded.wall_s < LONGEST_BEFORE_S
    ]
    if base and base[-1][0] > -SAME_TIME_S:
        base[-1] = (0.0, base[-1][1])
    bad: _Found = []
    bad_remark = ""
    if recorded.recorded_since_s is None:
        bad, bad_remark = _bad_samples(signal, recorded, base)
    if bad:
        base = sorted({**dict(bad), **dict(base)}.items())
    yield Attempt(base, bad_remark)
    if not base:
        return
    step_s = _step_s(signal, base)
    pasts: List[Attempt] = []
    for number in range(1, len(recorded.before) + 1):
        for is_held in (True, False):
            joined, held_s = _joined(signal, recorded, number, base, step_s, is_held=is_held)
            what = "the sample before" if is_held else "the value of the alert before"
            held = f"where samples are not stored, {what} is repeated ({duration_text(held_s)} in all)"
            pasts.append(Attempt(joined, _remarks(bad_remark, held if held_s else "")))
    yield from sorted(pasts, key=lambda past: past.remark != bad_remark)  # what is recorded completely, first
    recorded_text = f"{duration_text(-base[0][0])} before the alert are recorded"
    for samples, text in filter(lambda found: found[0], _preceded(signal, recorded, base, step_s)):
        seconds = duration_text(base[0][0] - samples[0][0])
        yield Attempt([*samples, *base], _remarks(bad_remark, f"{recorded_text}; {text} for {seconds} before that"))


def window_begin_s(signal: SignalConfig, recorded: RecordedAlert) -> Optional[float]:
    """Returns the begin of the alert's window, relative to it, if all samples in it are stored: others are outside."""
    is_complete = recorded.recorded_since_s is None and len(recorded.samples) < MAX_EVIDENCE
    return -signal.window_s if is_complete and signal.statistic != "last" else None


def _joined(
    signal: SignalConfig, recorded: RecordedAlert, number: int, base: Samples, step_s: float, *, is_held: bool
) -> Tuple[_Found, float]:
    """Returns the samples with those of the last `number` alerts before, and for how long some are assumed, in s.

    A time of which all samples are known has none where it has none: that was silence. Elsewhere the sample before is
    repeated (`is_held`), or there is the value that the alert before had.
    """
    found: Dict[float, float] = {}
    known: List[Tuple[float, float]] = [_relative(recorded.known_s(signal), recorded.wall_s)]
    used = [each for each in recorded.before[-number:] if each.wall_s > recorded.wall_s - LONGEST_BEFORE_S]
    for each in used:
        known.append(_relative(each.known_s(signal), recorded.wall_s))
        found.update((time_s - recorded.wall_s, value) for time_s, value in each.samples)
        if each.is_invalid(signal):
            found[each.wall_s - recorded.wall_s] = math.nan
    earlier = sorted((time_s, value) for time_s, value in found.items() if time_s < base[0][0] - SAME_TIME_S)
    joined: _Found = []
    held_s = 0.0
    limit_s = max(3.0 * step_s, 0.9 * signal.stale_after_s) if signal.stale_after_s else math.inf
    for time_s, value in [*earlier, *base]:
        if joined and time_s - joined[-1][0] > limit_s and len(joined) < _MOST_ASSUMED:
            begin_s, held = joined[-1]
            until_s = min([time_s, *(begin for begin, end in known if end >= time_s and begin > begin_s)])
            from_s = max([begin_s, *(end for begin, end in known if begin <= begin_s and end < time_s)])
            if until_s - from_s > step_s and not any(begin <= begin_s and end >= time_s for begin, end in known):
                times = _times_s(from_s + step_s, until_s - step_s / 4.0, step_s)
                alert = next((each for each in used[::-1] if each.wall_s - recorded.wall_s <= begin_s + 0.1), None)
                if is_held or alert is None or not _is_value(alert.value):
                    joined += [(each, held) for each in times]
                else:
                    joined += _course(signal, alert.value, times, (until_s, value))
                held_s += until_s - from_s
        joined.append((time_s, value))
    return joined, held_s


def _relative(times_s: Tuple[float, float], wall_s: float) -> Tuple[float, float]:
    return times_s[0] - wall_s - SAME_TIME_S, times_s[1] - wall_s + SAME_TIME_S


def _course(signal: SignalConfig, judged: float, times_s: Sequence[float], end: Tuple[float, float]) -> _Found:
    """Returns samples whose statistic is `judged`, up to a sample that follows them."""
    end_s, value = end
    if signal.statistic == "rate":
        return [(time_s, value + judged * (time_s - end_s)) for time_s in times_s]
    if signal.statistic == "stddev":
        return [(time_s, value + (judged if number % 2 else -judged)) for number, time_s in enumerate(times_s)]
    if signal.statistic == "forecast" and signal.forecast_s:
        now = value - judged
        slope = now / -signal.forecast_s
        return [(time_s, value + slope * (time_s - end_s)) for time_s in times_s]
    return [(time_s, judged) for time_s in times_s]


def _preceded(
    signal: SignalConfig, recorded: RecordedAlert, base: Samples, step_s: float
) -> Iterator[Tuple[_Found, str]]:
    """Yields what may have been before the samples, and what that is in words."""
    begin_s, first = base[0]
    window_min_s = 0.0 if signal.statistic == "last" else signal.window_min_s
    slope = _slope([each for each in base if each[0] <= begin_s / 2.0])
    judged = recorded.value if isinstance(recorded.value, float) else first
    for for_s in sorted({signal.for_s, signal.error_for_s}):
        # A condition that begins exactly so long before the alert.
        from_s = -for_s - window_min_s
        if from_s < begin_s - SAME_TIME_S:
            times = _times_s(from_s, min(begin_s, -for_s) - step_s / 4.0, step_s)
            if for_s and -for_s < begin_s - step_s / 4.0:
                times += _times_s(-for_s, begin_s, step_s)
            for value, text in ((first, "the first value is repeated"), (judged, "the value of the alert is repeated")):
                if not math.isnan(value):
                    yield [(time_s, value) for time_s in times], text
            if slope:
                trend = [(time_s, first + slope * (time_s - begin_s)) for time_s in times]
                yield trend, "the trend is continued"
    if recorded.before and recorded.before[-1].is_invalid(signal):
        needed_s = signal.invalid_for_s + 2.0
        yield (
            [(time_s, math.nan) for time_s in _times_s(begin_s - needed_s, begin_s, step_s)],
            "bad samples are assumed",
        )
    # A course that gives the level before, until the samples, or until it must have left the window.
    longest_s = max(signal.for_s, signal.error_for_s) + window_min_s + signal.window_s + 2.0 * step_s + 2.0
    ends_s = {begin_s: None}
    for lasted_s in (0.0, signal.keep_firing_for_s, signal.for_s, signal.error_for_s):
        window_s = 0.0 if signal.statistic == "last" else signal.window_s
        for more_s in (0.0, step_s):
            ends_s[min(begin_s, more_s - window_s - lasted_s - SAME_TIME_S)] = None
    held = _number_before(recorded)
    values = [] if held is None else [held]
    values += [value for value in _values(signal) if not math.isnan(first)]
    for value in values:
        for until_s in ends_s:
            times = _times_s(until_s - step_s / 2.0 - longest_s, until_s - step_s / 4.0, step_s)
            before = "the value of the alert before" if value is held else f"{_what(signal)} {value:.6g}"
            course = _course(signal, value, times, (until_s, first))
            course += [(time_s, first) for time_s in _times_s(until_s + step_s / 2.0, begin_s, step_s)]
            yield course, f"{before} is assumed"


def _what(signal: SignalConfig) -> str:
    return "a value of" if signal.statistic == "last" else f"a {signal.statistic} of"


def _values(signal: SignalConfig) -> List[float]:
    """Returns values of the statistic around the bounds, and between them; those of a driver are its levels."""
    if signal.is_status:
        return [0.0, 1.0, 2.0, 3.0]
    bounds = [signal.warn_below, signal.error_below, signal.warn_above, signal.error_above]
    given = sorted({bound for bound in bounds if bound is not None})
    found = [sum(given) / len(given)] if len(given) > 1 else []
    scale = max([abs(bound) for bound in given] + [given[-1] - given[0]] if given else [0.0]) or 1.0
    for margin in _MARGINS:
        for bound in given:
            found += [bound - margin * scale, bound + margin * scale]
    least = -math.inf if signal.valid_min is None else signal.valid_min
    most = math.inf if signal.valid_max is None else signal.valid_max
    is_raw = signal.statistic in ("last", "mean", "min", "max")
    return [value for value in found if not is_raw or least <= value <= most]


def _times_s(from_s: float, until_s: float, step_s: float) -> List[float]:
    count = min(math.ceil((until_s - from_s) / step_s - 0.5), _MOST_ASSUMED)
    return [from_s + number * step_s for number in range(count)]


def _remarks(*texts: str) -> str:
    return "; ".join(text for text in texts if text)


def _step_s(signal: SignalConfig, samples: Samples) -> float:
    """Returns the usual time between samples, in s."""
    gaps_s = [after[0] - before[0] for before, after in zip(samples, samples[1:])]
    step_s = max(median(gaps_s), 0.01) if gaps_s else 1.0
    return min(step_s, signal.stale_after_s / 2.0) if signal.stale_after_s else step_s


def _bad_samples(signal: SignalConfig, recorded: RecordedAlert, base: Samples) -> Tuple[_Found, str]:
    """Returns the bad samples before the alert, which are not stored, and the remark about them."""
    remark = "bad samples are not stored; those that must have come are assumed"
    begin_s = base[0][0] if base else -math.inf
    found = {
        each.wall_s - recorded.wall_s: math.nan
        for each in recorded.before
        if each.is_invalid(signal) and begin_s < each.wall_s - recorded.wall_s < -SAME_TIME_S
    }
    if recorded.is_invalid(signal) and not (base and base[-1][0] == 0.0):
        number = float(recorded.value) if isinstance(recorded.value, (int, float)) else math.nan
        since_s = -signal.invalid_for_s
        if base:
            since_s = max(since_s, base[-1][0] + min(0.01, -base[-1][0] / 2.0))
        step_s = min(_step_s(signal, base), 1.0)
        times_s = [since_s + step * step_s for step in range(min(int(-since_s / step_s), _MOST_ASSUMED) + 1)]
        found.update((time_s, number) for time_s in [*(each for each in times_s if each < -SAME_TIME_S), 0.0])
    return list(found.items()), remark if found else ""


def _slope(samples: Samples) -> float:
    """Returns the slope of the least-squares line per s; 0 if there is none."""
    if len(samples) < 2:
        return 0.0
    mean_s = sum(time_s for time_s, _ in samples) / len(samples)
    squares = sum((time_s - mean_s) ** 2 for time_s, _ in samples)
    slope = sum((time_s - mean_s) * value for time_s, value in samples) / squares if squares else 0.0
    return slope if math.isfinite(slope) else 0.0


def _arrivals(signal: SignalConfig, recorded: RecordedAlert) -> Iterator[Attempt]:
    """Yields arrivals at assumed times, in stages that have the recorded rates or gaps."""
    remark = "arrival times are not stored; evenly spaced ones are assumed"
    sample = min(max(1.0, signal.valid_min or 1.0), signal.valid_max or math.inf)
    is_gap = signal.statistic == "largest_gap_s"
    stored = [value for _, value in recorded.samples if _is_positive(value)]
    values = [each.value for each in recorded.before if _is_positive(each.value)][-_MOST_STAGES:]
    bounds = [signal.warn_below, signal.error_below, signal.warn_above, signal.error_above]
    given = [bound for bound in bounds if bound]
    usual = ([min(given) / 4.0, max(given) * 2.0] if is_gap else [max(given) * 2.0, min(given) / 2.0]) if given else []
    stages = [[recorded.value]] if _is_positive(recorded.value) else []
    stages = [[*values[len(values) - number :], *stage] for stage in stages for number in range(len(values) + 1)]
    firsts = [*stored[:1], *usual]
    for stage in [*([first, *stage] for stage in stages for first in firsts), *stages]:
        yield Attempt(_stages(signal, stage, sample), remark, True)
    yield Attempt([], remark)


def _stages(signal: SignalConfig, values: Sequence[float], sample: float) -> _Found:
    """Returns arrivals that have one rate after the other, or one largest gap after the other, each long enough."""
    needed_s = max(signal.for_s, signal.error_for_s) + signal.keep_firing_for_s + signal.window_s + 3.0
    times_s = [0.0]
    is_gap = signal.statistic == "largest_gap_s"
    step_s = min([*values, *(bound / 4.0 for bound in (signal.warn_above, signal.error_above) if bound)])
    for value in values:
        begin_s = times_s[-1]
        if is_gap and value > step_s:
            times_s.append(begin_s + value)
        each_s = step_s if is_gap else 1.0 / value
        count = min(math.ceil(needed_s / each_s), _MOST_ASSUMED)
        times_s += [times_s[-1] + number * each_s for number in range(1, count + 1)]
    return [(time_s - times_s[-1], sample) for time_s in times_s]


def _is_positive(value: Any) -> bool:
    return _is_value(value) and 1e-3 < value < 1e4


def _is_value(value: Any) -> bool:
    return isinstance(value, float) and math.isfinite(value)


def _number_before(recorded: RecordedAlert) -> Optional[float]:
    value = recorded.before[-1].value if recorded.before else None
    return value if _is_value(value) else None
