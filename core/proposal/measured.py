"""What is measured of one signal: its values, its steps and the times between its samples, in bounded memory.

It is measured on any middleware, live or recorded. Values are those that the monitor would judge, by its own code.
"""

from __future__ import annotations

import math
from dataclasses import replace
from statistics import fmean, pvariance

from ..config import BOUNDS, SignalConfig, read_signal
from ..judge import SignalMonitor
from ..port import Middleware
from ..values import ABSENT, DriverStatus, Elements, count_text, duration_text, number_text, with_ages, with_unit
from .quantiles import Quantiles

MOST_ELEMENTS = 64
"""Elements of one field that are measured."""
MOST_CODES = 10
"""A signal with at most this many different values, all whole numbers, is taken for a code."""
_LEAST_SAMPLES = 100
"""Valid samples below which no bound is suggested."""
_LEAST_DURATION_S = 30.0
"""Time of samples, in s, below which no bound is suggested."""
_UNKNOWN = read_signal("unknown", {})
_BINS = 16
"""Equal times in which messages are counted; once they are full, each is twice as long, so that at least half are."""
_FIRST_BIN_S = 0.001
_ROUNDING = 0.35
"""Variance of a number of messages of a regular topic with some jitter: it is one more or one less."""
_RATE_S = 30.0


class Measured:
    """Statistics of one signal over everything that was heard of it."""

    def __init__(self, config: SignalConfig = _UNKNOWN) -> None:
        """Starts without samples."""
        self.config = config
        self.values = Quantiles()
        """Values to which bounds apply, in the signal's unit."""
        self.steps = Quantiles()
        """Absolute differences between neighbouring values."""
        self.gaps = Quantiles()
        """Times between neighbouring samples, in s."""
        self.duration_s = 0.0
        """From the first to the last sample, summed over the recordings."""
        self.samples = 0
        self.bad_samples = 0
        self.rises = self.falls = 0
        """Values that are larger, and smaller, than the one before."""
        self.elements: dict[str, Measured] = {}
        """Each element, by its name, of a signal that selects several."""
        self.is_cut = False
        """Whether there are more than `MOST_ELEMENTS`."""
        self._monitor: SignalMonitor | None = None
        self._last_s = math.nan
        self._last = math.nan
        self._bins = [0] * _BINS
        self._bin_s = _FIRST_BIN_S

    def begin_recording(self) -> None:
        """Ends the previous recording: the time up to the next one is no gap."""
        self._monitor = None
        self._last_s = self._last = math.nan
        for element in self.elements.values():
            element.begin_recording()

    def listen(self, node: Middleware) -> None:
        """Subscribes to the topic; raises ConfigError if its type is unknown, or has no such field."""

        def receive(value: object, now_s: float) -> None:
            if value is not ABSENT:
                self.take(with_ages(value, node.stamp_s), now_s)

        node.subscribe(self.config.topic, self.config.type, receive, field=self.config.selection)

    def take(self, value: object, now_s: float) -> None:
        """Adds the value of a message, as the monitor judges it without bounds; elements are measured one by one."""
        if isinstance(value, Elements) and not self.config.reduce:
            self._arrive(now_s)
            for name, element in value:
                if name not in self.elements and len(self.elements) < MOST_ELEMENTS:
                    self.elements[name] = Measured(self.config)
                if name in self.elements:
                    level = element.level if isinstance(element, DriverStatus) else element
                    self.elements[name].take(level, now_s)
                else:
                    self.is_cut = True
            return
        if self._monitor is None:
            none = dict.fromkeys(BOUNDS)
            config = replace(self.config, **none, stale_after_s=0.0, only_if=None, latch_release_if=None)  # type: ignore[arg-type]
            self._monitor = SignalMonitor(config, "", now_s)
        self._monitor.observe(value, now_s)
        self.add(now_s, self._monitor.latest_good if self.config.statistic == "last" else self._monitor.judged)

    def add(self, now_s: float, value: float | None) -> None:
        """Adds a sample; None if it is not valid or its statistic not yet defined. Times must not decrease."""
        self._arrive(now_s)
        if value is None or not math.isfinite(value):
            self.bad_samples += self.config.statistic == "last"  # others are also undefined at the start
            return
        step = value - self._last
        self._last = value
        self.values.add(value)
        if math.isfinite(step):
            self.steps.add(abs(step))
            self.rises += step > 0.0
            self.falls += step < 0.0

    def scale(self, factor: float, config: SignalConfig) -> None:
        """Converts everything to another unit, for which `config` is the configuration."""
        self.config = config
        self.values.scale(factor)
        self.steps.scale(factor)

    @property
    def irregularity(self) -> float:
        """Standard deviation of the rate over 30 s, relative to the rate: 0 for a regular topic.

        Estimated from the numbers of messages in at least 8 equal times, less the variance of a number that is rounded;
        messages that come in bunches are regular if the bunches are. Infinite without a message for that.
        """
        counts = self._bins[: int(self.duration_s / self._bin_s)]  # without the last one, which is not complete
        if len(counts) < _BINS // 2 or sum(counts) < len(counts):
            return math.inf
        variance = pvariance(counts) - _ROUNDING
        return math.sqrt(max(0.0, variance)) / fmean(counts) * math.sqrt(min(1.0, self._bin_s / _RATE_S))

    @property
    def mean_rate_hz(self) -> float:
        """Messages per second from the first to the last; NaN if no time has passed."""
        return self.gaps.count / self.duration_s if self.duration_s > 0.0 else math.nan

    def unsuitable(self) -> str:
        """Returns why no bound can be derived from the values; empty if one can."""
        values = self.values
        if not values.count:
            return "no valid value"
        if values.count < _LEAST_SAMPLES:
            seen = f"only {count_text(values.count, 'valid sample')} in {duration_text(self.duration_s)}"
            needed_s = max(_LEAST_DURATION_S, self.duration_s * _LEAST_SAMPLES / values.count)
            return f"{seen}; a range needs {_LEAST_SAMPLES}: listen for {60 * math.ceil(1.05 * needed_s / 60.0)} s"
        if self.duration_s < _LEAST_DURATION_S * 0.999:
            return f"seen for {duration_text(self.duration_s)} only; a range needs {duration_text(_LEAST_DURATION_S)}"
        if values.min == values.max:
            return f"the value is always {self.text(values.min)}"
        different = values.different()
        if len(different) <= MOST_CODES and all(each.is_integer() for each in different):
            return f"only the values {', '.join(f'{code:.0f}' for code in sorted(different))}: looks like a code"
        if not self.falls and self.rises >= _LEAST_SAMPLES // 2:
            return "the value only rises: looks like a counter"
        return ""

    def text(self, value: float) -> str:
        """Returns a value with the unit of what is judged."""
        unit = "Hz" if self.config.statistic == "frequency_hz" else self.config.unit
        return with_unit(number_text(value), unit)

    def _arrive(self, now_s: float) -> None:
        gap_s = now_s - self._last_s
        self.samples += 1
        if gap_s >= 0.0:  # False for the first sample
            self.gaps.add(gap_s)
            self.duration_s += gap_s
        self._last_s = now_s
        while self.duration_s >= _BINS * self._bin_s:
            half = [self._bins[each] + self._bins[each + 1] for each in range(0, _BINS, 2)]
            self._bins = half + [0] * (_BINS // 2)
            self._bin_s *= 2.0
        self._bins[int(self.duration_s / self._bin_s)] += 1
