"""Thresholds that recordings of healthy robots suggest, each with its evidence. docs/statistics.md explains the rules.

`Measured` collects the samples of one signal over all recordings, in bounded memory: `Quantiles` estimates their
distribution, the same in every run. `suggest` derives the signal's settings. Whether they would have raised alerts is
not computed here: the recordings are replayed with them.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Dict, List, NamedTuple, Optional, Sequence, Set, Tuple

import numpy as np

from robot_health_monitor.core.formatting import bound_text, count_text, duration_text, number_text, with_unit
from robot_health_monitor.core.signal_config import SignalConfig

SIZE = 16_384  # numbers per buffer of `Quantiles`, even; n numbers need at most log2(n / SIZE) + 2 buffers
LEAST_SAMPLES = 100  # valid samples below which no bound is suggested
LEAST_DURATION_S = 30.0  # time of samples, in s, below which no bound is suggested
LEAST_RANGE_S = 600.0  # time of samples, in s, below which a range is no bound: it is shown as a comment
LEAST_MESSAGES = 20  # messages below which no rate is suggested
RATE_MARGIN, SHORT_RATE_MARGIN = 0.2, 0.3
"""Margin of a rate, as a fraction; the second one if it was seen for less than `SHORT_S`."""
SHORT_S = 300.0
LEAST_GAPS = 10  # gaps between samples below which no `stale_after_s` is suggested
MOST_CODES = 10  # A signal with at most this many different values, all whole numbers, is taken for a code
TAIL = 0.001  # fraction of the samples beyond the quantile from which a bound is derived
MARGIN = 0.1  # distance of a bound from its quantile, as a fraction of the spread between both quantiles
LEAST_MARGIN = 0.01
"""Smallest margin, as a fraction of the quantiles: other robots of the type differ by more than the noise of one."""
OUTLIERS = 0.005  # largest fraction of the samples that may be outliers; at least one sample may be
FENCE, WIDE_FENCE = 10.0, 1e6
"""Distance of an outlier from the quantiles of 1 % and 99 %, as a multiple of their distance; the second one if there
are long excursions."""
LONGEST_EXCURSION_S = 60.0
"""Values beyond a bound for longer than this, in s, are no short excursion: the bound is set from the extreme."""

_TINY, _HUGE = 1e-200, 1e200  # nothing is computed from margins and noise outside of this range: doubles would overflow

_LOWEST = {"%": 0.0, "K": 0.0, "Hz": 0.0, "degC": -273.15}
_HIGHEST = {"%": 100.0}


class Setting(NamedTuple):
    """One suggested key of a signal."""

    value: float
    evidence: str  # why, in one line


class Suggestion(NamedTuple):
    """The suggested keys of one signal."""

    settings: Dict[str, Setting]  # by key of thresholds.yaml
    seen: Dict[str, Setting]  # those that the recordings are too short for: what they would be
    left_out: List[str]  # one line for each key that the data cannot justify

    @property
    def has_bounds(self) -> bool:
        """Whether there is a bound."""
        return "warn_below" in self.settings or "warn_above" in self.settings


class Quantiles:
    """Counts numbers, and estimates their quantiles in bounded memory; docs/statistics.md has the sources.

    A buffer that is full is sorted, and every second number moves to the next buffer, where it counts twice as much.
    Odd and even positions take turns, so that the errors cancel. The rank of a result is off by at most
    `levels / (2 * SIZE)`: 0.02 % of a million numbers. Minimum and maximum are exact.
    """

    def __init__(self) -> None:
        """Starts without numbers."""
        self.count = 0
        self.min = math.inf
        self.max = -math.inf
        self._buffers: List[Any] = [np.empty(0)]  # per level, sorted except level 0; each counts `2 ** level` times
        self._odd: List[int] = [0]

    def add(self, numbers: Any) -> None:
        """Adds an array of finite doubles."""
        if not len(numbers):
            return
        self.count += len(numbers)
        self.min = min(self.min, float(numbers.min()))
        self.max = max(self.max, float(numbers.max()))
        buffer = np.concatenate([self._buffers[0], numbers])
        self._buffers[0] = buffer
        level = 0
        while len(self._buffers[level]) >= SIZE:
            full = np.sort(self._buffers[level])
            even = len(full) - len(full) % 2
            half = full[self._odd[level] : even : 2]
            self._odd[level] = 1 - self._odd[level]
            self._buffers[level] = full[even:]
            if level + 1 == len(self._buffers):
                self._buffers.append(np.empty(0))
                self._odd.append(0)
            level += 1
            self._buffers[level] = np.concatenate([self._buffers[level], half])

    def scale(self, factor: float) -> None:
        """Multiplies all numbers by a positive factor."""
        self._buffers = [each * factor for each in self._buffers]
        self.min *= factor
        self.max *= factor

    def within(self, low: float, high: float) -> Tuple[float, float, float]:
        """Returns the smallest and the largest number in a range, and the fraction of the numbers outside of it.

        Estimated, as quantiles are. Without a number in the range its ends are returned.
        """
        inside = [each[(each >= low) & (each <= high)] for each in self._buffers]
        kept = np.concatenate(inside)
        share = _weight(inside) / max(1.0, _weight(self._buffers))
        smallest, largest = (float(kept.min()), float(kept.max())) if len(kept) else (low, high)
        return smallest, largest, 1.0 - share

    def quantile(self, fraction: float) -> float:
        """Returns the smallest number such that at least `fraction` of all are at most that; NaN without numbers."""
        if not self.count:
            return math.nan
        if fraction <= 0.0 or fraction >= 1.0:
            return self.min if fraction <= 0.0 else self.max
        values = np.concatenate(self._buffers)
        weights = np.concatenate([np.full(len(each), 2.0**level) for level, each in enumerate(self._buffers)])
        order = np.argsort(values, kind="stable")
        ranks = np.cumsum(weights[order])
        place = int(np.searchsorted(ranks, fraction * ranks[-1] * (1.0 - 1e-12)))
        return float(values[order][min(place, len(values) - 1)])


def _weight(buffers: Sequence[Any]) -> float:
    return sum(2.0**level * len(each) for level, each in enumerate(buffers))


class Measured:
    """Statistics of one signal over all recordings, in bounded memory."""

    def __init__(self, config: SignalConfig) -> None:
        """Starts without samples."""
        self.config = config
        self.values = Quantiles()  # those to which bounds apply, in the signal's unit
        self.steps = Quantiles()  # absolute differences between neighbouring values
        self.gaps = Quantiles()  # times between neighbouring samples, in s
        self.duration_s = 0.0  # from the first to the last sample, summed over the recordings
        self.samples = 0
        self.bad_samples = 0
        self.only_rises = True  # no value is smaller than the one before
        self.rises = 0  # values that are larger than the one before
        self.codes: Optional[Set[float]] = set()
        """The different values; None if there are more than `MOST_CODES` or one is not a whole number."""
        self._last_s = math.nan
        self._last = math.nan

    def begin_recording(self) -> None:
        """Ends the previous recording: the time up to the next one is no gap."""
        self._last_s = self._last = math.nan

    def add(self, times_s: Any, values: Any) -> None:
        """Adds samples in the order of their times; NaN for those without a valid value."""
        if not len(times_s):
            return
        self.samples += len(times_s)
        gaps = np.diff(np.concatenate([[self._last_s], times_s]))
        gaps = gaps[np.isfinite(gaps)]
        self.gaps.add(np.maximum(gaps, 0.0))
        self.duration_s += float(gaps.sum())
        self._last_s = float(times_s[-1])
        good = values[np.isfinite(values)]
        if self.config.statistic == "last":  # others are also undefined at the start
            self.bad_samples += len(values) - len(good)
        if not len(good):
            return
        with np.errstate(over="ignore"):
            steps = np.diff(np.concatenate([[self._last], good]))
        steps = steps[np.isfinite(steps)]
        self._last = float(good[-1])
        self.values.add(good)
        self.steps.add(np.abs(steps))
        self.only_rises = self.only_rises and not bool((steps < 0.0).any())
        self.rises += int(np.count_nonzero(steps > 0.0))
        if self.codes is not None:
            self.codes.update(np.unique(good)[: MOST_CODES + 1].tolist())
            if len(self.codes) > MOST_CODES or not all(code.is_integer() for code in self.codes):
                self.codes = None

    def scale(self, factor: float, config: SignalConfig) -> None:
        """Converts everything to another unit, for which `config` is the configuration."""
        self.config = config
        self.values.scale(factor)
        self.steps.scale(factor)

    def unsuitable(self) -> str:
        """Returns why no bound can be derived; empty if one can."""
        values = self.values
        if values.count < LEAST_SAMPLES or self.duration_s < LEAST_DURATION_S * 0.999:
            return (
                f"{count_text(values.count, 'valid sample')} in {duration_text(self.duration_s)}; "
                f"expected at least {LEAST_SAMPLES} in {duration_text(LEAST_DURATION_S)}"
            )
        if values.min == values.max:
            return f"the value is always {self.text(values.min)}"
        if self.codes is not None:
            return f"only the values {', '.join(f'{code:.0f}' for code in sorted(self.codes))}: looks like a code"
        if self.only_rises and self.rises >= LEAST_SAMPLES // 2:
            return "the value only rises: looks like a counter"
        return ""

    def text(self, value: float) -> str:
        """Returns a value with the signal's unit."""
        return with_unit(number_text(value), self.config.unit)


def suggest(measured: Measured, longest_excursion_s: Optional[float] = None) -> Suggestion:
    """Derives the settings of a signal.

    `longest_excursion_s` is the longest time for which a healthy value was beyond a bound that this function suggested
    before; None: not known yet.
    """
    settings: Dict[str, Setting] = {}
    left_out: List[str] = []
    if measured.config.statistic == "frequency_hz":
        _add_rate_bounds(measured, settings, left_out)
        _add_staleness(measured, settings)
        return Suggestion(settings, {}, left_out)
    reason = measured.unsuitable()
    if reason and not measured.config.field and measured.config.statistic == "last":
        reason = "only the arrival of its messages is watched"
    if reason:
        left_out.append(f"no bounds: {reason}")
    else:
        from_extreme = longest_excursion_s is not None and longest_excursion_s > LONGEST_EXCURSION_S
        _add_bounds(measured, from_extreme, settings, left_out)
        if settings:
            _add_hysteresis(measured, settings)
            if longest_excursion_s and not from_extreme:
                for_s = _rounded(1.5 * max(longest_excursion_s, 0.001), math.ceil)
                evidence = f"longest healthy excursion beyond a bound {duration_text(longest_excursion_s)}"
                settings["for_s"] = Setting(for_s, evidence)
    seen: Dict[str, Setting] = {}
    if settings and measured.duration_s < LEAST_RANGE_S * 0.999:
        settings, seen = {}, settings
        expected = f"expected at least {duration_text(LEAST_RANGE_S)}"
        left_out.append(f"the range was seen for {duration_text(measured.duration_s)} only, {expected}")
    _add_staleness(measured, settings)
    return Suggestion(settings, seen, left_out)


def _add_rate_bounds(measured: Measured, settings: Dict[str, Setting], left_out: List[str]) -> None:
    values = measured.values
    if measured.samples < LEAST_MESSAGES or not values.count or values.min <= 0.0:
        left_out.append(
            f"no bounds: {count_text(measured.samples, 'message')} in {duration_text(measured.duration_s)}; "
            f"expected at least {LEAST_MESSAGES}"
        )
        return
    is_short = measured.duration_s < SHORT_S * 0.999
    margin = SHORT_RATE_MARGIN if is_short else RATE_MARGIN
    seen = f", seen for {duration_text(measured.duration_s)} only" if is_short else ""
    why = f"margin {margin * 100.0:.0f} %{seen}"
    low = _rounded(values.min * (1.0 - margin), math.floor)
    high = _rounded(values.max * (1.0 + margin), math.ceil)
    settings["warn_below"] = Setting(low, f"lowest {measured.text(values.min)}; {why}")
    settings["warn_above"] = Setting(high, f"highest {measured.text(values.max)}; {why}")


def _without_outliers(values: Quantiles, fence: float, low: float, high: float) -> Tuple[float, float]:
    """Returns the two ends of a range, without the few values that are far from all others.

    One error of a sensor must not widen a bound: in 600 samples it is beyond the quantile of 99.9 %.
    """
    inner_low, inner_high = values.quantile(0.01), values.quantile(0.99)
    distance = fence * max(inner_high - inner_low, LEAST_MARGIN * max(abs(inner_low), abs(inner_high)))
    smallest, largest, outside = values.within(inner_low - distance, inner_high + distance)
    if outside > max(OUTLIERS, 1.5 / values.count):
        return low, high  # too many to be errors
    return max(low, smallest), min(high, largest)


def _add_bounds(measured: Measured, from_extreme: bool, settings: Dict[str, Setting], left_out: List[str]) -> None:
    values, config = measured.values, measured.config
    low, high = _without_outliers(values, FENCE, values.quantile(TAIL), values.quantile(1.0 - TAIL))
    noise = measured.steps.quantile(0.95) if measured.steps.count else 0.0
    margin = max(MARGIN * (high - low), noise, LEAST_MARGIN * max(abs(low), abs(high)))
    if from_extreme:
        low, high = _without_outliers(values, WIDE_FENCE, values.min, values.max)
    if not _TINY < margin < _HUGE:
        spread = f"from {measured.text(values.min)} to {measured.text(values.max)}"
        left_out.append(f"no bounds: the values are {spread}, nearly all of them about {measured.text(low)}")
        return
    digits = math.floor(math.log10(margin))
    step = 10.0**digits
    for key, quantile, extreme, bound in (
        ("warn_below", low, values.min, math.floor((low - margin) / step) * step),
        ("warn_above", high, values.max, math.ceil((high + margin) / step) * step),
    ):
        bound = round(bound, max(0, -digits) + 1)
        side, outermost = ("below", "lowest") if key == "warn_below" else ("above", "highest")
        beyond = _beyond_limit(key, bound, config, values.min)
        if beyond:
            left_out.append(f"no {key}: {measured.text(bound)} {beyond}")
            continue
        evidence = f"{outermost} {measured.text(extreme)}"
        if quantile != extreme:
            evidence = f"{TAIL * 100.0:g} % of the samples are {side} {measured.text(quantile)}, {evidence}"
        settings[key] = Setting(bound, f"{evidence}; margin {measured.text(margin)}")


def _beyond_limit(key: str, bound: float, config: SignalConfig, lowest_value: float) -> str:
    """Returns why no value can be beyond a bound; empty if one can."""
    is_low = key == "warn_below"
    side = "above" if is_low else "below"
    if not math.isfinite(bound):
        return "is no finite number"
    valid = config.valid_min if is_low else config.valid_max
    if valid is not None and (bound <= valid if is_low else bound >= valid):
        return f"is not {side} {'valid_min' if is_low else 'valid_max'} {bound_text(valid)}"
    possible = (_LOWEST if is_low else _HIGHEST).get(config.unit)
    if possible is not None and (bound <= possible if is_low else bound >= possible):
        return f"is not {side} {with_unit(bound_text(possible), config.unit)}, the {'minimum' if is_low else 'maximum'}"
    if is_low and bound <= 0.0 <= lowest_value:
        return "is not positive, and no recorded value is negative"
    return ""


def _add_hysteresis(measured: Measured, settings: Dict[str, Setting]) -> None:
    """Adds the hysteresis, if the signal has noise; an alert must be able to clear at a healthy value."""
    noise = measured.steps.quantile(0.95)
    median = measured.values.quantile(0.5)
    bounds = [settings[key].value for key in ("warn_below", "warn_above") if key in settings]
    room = min(abs(bound - median) for bound in bounds)
    evidence = f"95 % of the steps between samples are at most {measured.text(noise)}"
    hysteresis = _rounded(noise, math.ceil)
    if hysteresis > room / 2.0:
        hysteresis = _rounded(room / 2.0, math.floor)
        evidence += "; at most half of the distance from a bound to the median"
    if hysteresis > 0.0:
        settings["hysteresis"] = Setting(hysteresis, evidence)


def _add_staleness(measured: Measured, settings: Dict[str, Setting]) -> None:
    gaps = measured.gaps
    if gaps.count < LEAST_GAPS:
        evidence = f"0: never; {count_text(gaps.count, 'gap')} between samples, expected at least {LEAST_GAPS}"
        settings["stale_after_s"] = Setting(0.0, evidence)
        return
    median = gaps.quantile(0.5)
    stale_s = max(1.0, _rounded(max(2.0 * gaps.max, 5.0 * median), math.ceil))
    evidence = f"longest gap {duration_text(gaps.max)}, median {duration_text(median)}"
    settings["stale_after_s"] = Setting(stale_s, evidence)


def _rounded(value: float, rounding: Callable[[float], int]) -> float:
    """Rounds to two digits, by `math.ceil` 0.123 to 0.13."""
    if not _TINY < value < _HUGE:
        return 0.0
    digits = 1 - math.floor(math.log10(value))
    scaled = value * 10.0**digits
    nearest = round(scaled)
    whole = nearest if abs(scaled - nearest) < 1e-3 else rounding(scaled)
    return float(round(whole / 10.0**digits, max(0, digits)))
