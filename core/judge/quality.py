"""Step 1 of docs/rules.md: is a datum a valid number of its signal, what is it in the unit, and does it look wrong?

Valid data can look wrong: another unit, a fraction for a percentage, a placeholder. Nothing is rescaled and no level
changes: the status says `suspicious data` with the value seen and a hint.
"""

from __future__ import annotations

import math
import numbers
import sys
from typing import Mapping, NamedTuple

from ..config.signal_config import SignalConfig
from ..values.elements import DriverStatus, Elements
from ..values.formatting import bound_text, number_text
from ..values.reduction import reduced
from ..values.where import is_equal

RUN = 20
"""Consecutive samples after which a run of values is suspicious."""

_LARGEST = sys.float_info.max


class _Unit(NamedTuple):
    ordinary_max: float
    """Largest plausible value in this unit where `valid_max` is not set."""
    thousandths: str
    """Name of the unit whose numbers are a thousand times as large."""


_CELSIUS = _Unit(200.0, "millidegrees")
_UNITS: Mapping[str, _Unit] = {
    "%": _Unit(100.0, ""),
    "degC": _CELSIUS,
    "°C": _CELSIUS,
    "C": _CELSIUS,
    "V": _Unit(1000.0, "millivolts"),
    "A": _Unit(1000.0, "milliamperes"),
}
_KELVIN = (200.0, 500.0)


class Quality:
    """Judges and counts the samples of one signal."""

    __slots__ = (
        "_config", "_converts", "_number_of_element", "_valid_max", "_valid_min", "bad_samples", "good_samples",
        "latest", "suspicion",
    )  # fmt: skip

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
        converts = config.scale != 1.0 or bool(config.placeholders)
        self._converts = converts and not config.reduce
        self._number_of_element = self._converted_element if converts else as_float
        self._valid_min = -_LARGEST if config.valid_min is None else config.valid_min
        self._valid_max = _LARGEST if config.valid_max is None else config.valid_max
        self.suspicion = Suspicion(config)

    def judge(self, value: object) -> float:
        """Processes a datum; returns the number in the signal's unit, NaN if it is bad."""
        if type(value) is Elements and self._config.reduce:
            value = reduced(value, self._config.reduce, self._number_of_element)
        self.latest = value
        raw = value if type(value) is float else as_float(value)
        number = converted(self._config, raw) if self._converts else raw
        suspicion = self.suspicion
        if self._valid_min <= number <= self._valid_max:  # False for NaN; infinities lie outside
            self.good_samples += 1
            if suspicion.watching or not suspicion.ordinary_min < number <= suspicion.ordinary_max:
                suspicion.see(raw, number, good=True)
            return number
        self.bad_samples += 1
        suspicion.see(raw, number, good=False)
        return math.nan

    def _converted_element(self, value: object) -> float:
        return _in_unit(self._config, as_float(value))


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


def converted(config: SignalConfig, raw: float) -> float:
    """Returns a number in the signal's unit; NaN for a placeholder. A reduction is in the unit already."""
    return raw if config.reduce else _in_unit(config, raw)


def _in_unit(config: SignalConfig, raw: float) -> float:
    for number in config.placeholders:
        if is_equal(raw, number):
            return math.nan
    return raw * config.scale


class Suspicion:
    """Checks whether the samples of one signal look wrong.

    `raw` is a number as received, NaN if it was none; `number` is the same in the signal's unit, NaN for a placeholder.
    """

    __slots__ = (
        "_between", "_config", "_fractions", "_only_zeros", "_unreadable", "_zeros", "ordinary_max", "ordinary_min",
        "text", "watching",
    )  # fmt: skip

    def __init__(self, config: SignalConfig) -> None:
        """Suspects nothing yet."""
        self._config = config
        self._fractions = 0
        self._between = False
        self._zeros = 0
        # A flag has no unit, and may be 0 for hours.
        self._only_zeros = config.unit != "" and any(name.endswith("below") for name in config.bounds)
        self._unreadable = 0
        unit = _UNITS.get(config.unit)
        self.ordinary_min = 1.0 if config.unit == "%" else -math.inf
        """A good sample not above this may look wrong, in the signal's unit."""
        self.ordinary_max = math.inf if unit is None or config.valid_max is not None else unit.ordinary_max
        """A good sample above this looks wrong, in the signal's unit."""
        self.text = ""
        """`suspicious data: ...`, empty while nothing is suspected."""
        self.watching = self._only_zeros
        """Whether every good sample matters; otherwise only those outside the ordinary limits."""

    def see(self, raw: float, number: float, *, good: bool) -> None:
        """Processes a sample, which is valid or not."""
        if good:
            self._unreadable = 0
        else:
            self._fractions, self._between = 0, False
            self._unreadable = self._unreadable + 1 if math.isnan(raw) else 0
        self.text = self._explain_good(raw, number) if good else self._explain_bad(raw, number)
        self.watching = self._only_zeros or bool(self._fractions or self._unreadable or self.text)

    def _explain_good(self, raw: float, number: float) -> str:
        if self._only_zeros:
            self._zeros += 1
            self._only_zeros = number == 0.0
            if self._only_zeros and self._zeros >= RUN:
                return _suspect("always 0 since the start", "if it means 'not measured', set placeholders: [0.0]")
        if self._config.unit == "%" and 0.0 <= number <= 1.0:
            self._fractions += 1
            self._between = self._between or 0.0 < number < 1.0
            if self._fractions < RUN or not self._between:
                return ""
            seen = f"{self._fractions} values in a row from 0 to 1, the last {number_text(number)}"
            remedy = f"if so, set scale: {bound_text(100.0 * self._config.scale)}"
            return _suspect(f"{seen}, look like a fraction, not like %", remedy)
        self._fractions = 0
        self._between = False
        if number > self.ordinary_max:
            return self._explain_large(raw, number, math.inf)
        return _explain_not_measured(raw) if self._config.unit == "%" else ""

    def _explain_bad(self, raw: float, number: float) -> str:
        if math.isnan(raw):
            if self._unreadable < RUN:
                return ""
            seen = f"{self._unreadable} values in a row are not numbers"
            return _suspect(seen, "if the source does not measure this, use another field")
        if math.isnan(number):  # a placeholder that is known to be one
            return ""
        largest = self._config.valid_max
        if largest is not None and number > largest:
            return self._explain_large(raw, number, largest)
        return _explain_not_measured(raw)

    def _explain_large(self, raw: float, number: float, largest: float) -> str:
        config, shown = self._config, number_text(raw)
        if config.unit == "%" and config.scale == 100.0 and 1.0 < raw <= 100.0:
            return _suspect(f"{shown} looks like a percentage already, not like a fraction", "if so, set scale: 1")
        if config.unit == "" and config.valid_max == 1.0 and number <= 100.0:
            return _suspect(f"{shown} looks like a percentage, not like a fraction", "if so, set scale: 0.01")
        unit = _UNITS.get(config.unit)
        if unit is _CELSIUS and _KELVIN[0] <= number <= _KELVIN[1]:
            return _suspect(f"{shown} looks like kelvin", "if so, set unit: K and bounds in K")
        if unit is not None and unit.thousandths and number >= 1000.0 and number / 1000.0 <= largest:
            remedy = f"if so, set scale: {bound_text(config.scale / 1000.0)}"
            return _suspect(f"{shown} looks like {unit.thousandths}", remedy)
        if math.isfinite(largest):
            return ""
        return _suspect(f"{shown} is implausibly high for {config.unit}", "check unit and scale, or set valid_max")


def _explain_not_measured(raw: float) -> str:
    if not is_equal(raw, -0.01):  # BatteryState.percentage as some drivers send it
        return ""
    return _suspect("-0.01 is what some drivers send for 'not measured'", "if so, set placeholders: [-0.01]")


def _suspect(seen: str, remedy: str) -> str:
    return f"suspicious data: {seen}; {remedy}"
