"""Step 1 of docs/rules.md: is a datum a valid number of its signal, and what is it in the signal's unit."""

from __future__ import annotations

import math
import numbers
import sys

from .plausibility import Suspicion
from .signal_config import SignalConfig

_LARGEST = sys.float_info.max


class Quality:
    """Judges and counts the samples of one signal."""

    __slots__ = (
        "_config",
        "_converts",
        "_valid_max",
        "_valid_min",
        "bad_samples",
        "good_samples",
        "latest",
        "suspicion",
    )

    suspicion: Suspicion
    """Whether the data looks wrong."""

    def __init__(self, config: SignalConfig) -> None:
        """Starts before the first sample."""
        self.good_samples = 0
        self.bad_samples = 0
        self.latest: object = None
        """The latest datum as received."""
        self.configure(config)

    def configure(self, config: SignalConfig) -> None:
        """Applies a new configuration; the counts stay."""
        self._config = config
        self._converts = config.scale != 1.0 or bool(config.placeholders)
        self._valid_min = -_LARGEST if config.valid_min is None else config.valid_min
        self._valid_max = _LARGEST if config.valid_max is None else config.valid_max
        self.suspicion = Suspicion(config)

    @property
    def seen(self) -> bool:
        """Whether there has been a sample, good or bad."""
        return self.good_samples + self.bad_samples > 0

    def judge(self, value: object) -> float:
        """Processes a datum; returns the number in the signal's unit, NaN if it is bad."""
        self.latest = value
        raw = value if type(value) is float else as_float(value)
        number = converted(self._config, raw) if self._converts else raw
        suspicion = self.suspicion
        if self._valid_min <= number <= self._valid_max:  # False for NaN; infinities lie outside
            self.good_samples += 1
            if suspicion.watching or not suspicion.ordinary_min < number <= suspicion.ordinary_max:
                suspicion.see_good(raw, number)
            return number
        self.bad_samples += 1
        suspicion.see_bad(raw, number)
        return math.nan


def as_float(value: object) -> float:
    """Returns the number that `value` is; NaN if it is not a number or too large for a double."""
    try:
        return float(value) if isinstance(value, numbers.Real) else math.nan
    except Exception:  # a foreign object's own conversion
        return math.nan


def converted(config: SignalConfig, raw: float) -> float:
    """Returns a number in the signal's unit; NaN for a placeholder."""
    for number in config.placeholders:
        if math.isclose(raw, number, rel_tol=1e-6):  # Float32 brings -0.01 as -0.009999999776
            return math.nan
    return raw * config.scale
