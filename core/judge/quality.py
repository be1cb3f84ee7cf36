"""Step 1 of docs/rules.md: is a datum a valid number of its signal, what is it in the unit, and does it look wrong?

Valid data can look wrong: another unit, a fraction for a percentage, a placeholder. Nothing is rescaled and no level
changes: the status says `suspicious data` with the value seen and a hint.
"""

from __future__ import annotations

import math
import numbers
from typing import Mapping

from ..config import SignalConfig
from ..values import DriverStatus, Elements, bound_text, is_equal, number_text, reduced
from .window import Window

RUN = 20
"""Samples after which values that are all alike, or no numbers, are suspicious."""


_ORDINARY_MAX: Mapping[str, float] = {"%": 100.0, "degC": 200.0, "°C": 200.0, "C": 200.0, "V": 1000.0, "A": 1000.0}
"""Largest plausible value per unit where `valid_max` is not set."""


def received(config: SignalConfig, datum: object) -> object:
    """Returns what is judged of a datum of a signal with `reduce`: the one value of its elements."""
    if type(datum) is Elements:
        return reduced(datum, config.reduce, lambda each: _in_unit(config, each))
    return datum


def number_of(config: SignalConfig, datum: object) -> float:
    """Returns the number of a datum in the signal's unit; NaN if it is none, or is a placeholder."""
    return as_float(datum) if config.reduce else _in_unit(config, datum)


def as_float(value: object) -> float:
    """Returns the number that `value` is; NaN if it is not a number or too large for a double."""
    if type(value) is float:
        return value
    try:
        if isinstance(value, numbers.Real):
            return float(value)
        return value.number if isinstance(value, DriverStatus) else math.nan
    except Exception:  # a foreign object's own conversion
        return math.nan


def _in_unit(config: SignalConfig, datum: object) -> float:
    number = datum if type(datum) is float else as_float(datum)
    for placeholder in config.placeholders:
        if is_equal(number, placeholder):
            return math.nan
    return number * config.scale


def suspicion_of(config: SignalConfig, latest: object, good_samples: int, bad_samples: int, window: Window) -> str:
    """Returns what looks wrong with the latest datum, and how to mend it; empty if nothing does."""
    raw, number = as_float(latest), number_of(config, latest)
    if math.isnan(raw) and bad_samples >= RUN:
        return f"{bad_samples} values are not numbers; if the source does not measure this, use another field"
    if not math.isfinite(number):
        return ""
    if config.unit == "%" and is_equal(raw, -0.01):  # BatteryState.percentage as some drivers send it
        return "-0.01 is what some drivers send for 'not measured'; if so, set placeholders: [-0.01]"
    low, high = window.min() or 0.0, window.max() or 0.0
    if good_samples >= RUN:
        # A flag has no unit, and may be 0 for hours.
        has_lower_bound = any(name.endswith("below") for name in config.bounds)
        if number == low == high == 0.0 and config.unit and has_lower_bound:
            return "nothing but 0; if it means 'not measured', set placeholders: [0.0]"
        if config.unit == "%" and 0.0 < number < 1.0 and low >= 0.0 < high <= 1.0:
            seen = f"values from 0 to 1, the last {number_text(number)}, look like a fraction, not like %"
            return f"{seen}; if so, set scale: {bound_text(100.0 * config.scale)}"
    shown, ordinary_max = number_text(raw), _ORDINARY_MAX.get(config.unit, math.inf)
    if number <= (ordinary_max if config.valid_max is None else config.valid_max):
        return ""
    if config.unit == "%" and config.scale == 100.0 and 1.0 < raw <= 100.0:
        return f"{shown} looks like a percentage already, not like a fraction; if so, set scale: 1"
    if config.unit == "" and config.valid_max == 1.0 and number <= 100.0:
        return f"{shown} looks like a percentage, not like a fraction; if so, set scale: 0.01"
    if config.valid_max is not None:
        return ""
    return f"{shown} is implausibly high for {config.unit}; check unit and scale, or set valid_max"
