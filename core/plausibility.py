"""Valid data that looks wrong: another unit, a fraction for a percentage, a placeholder.

Nothing is rescaled and no level changes: the status says `suspicious data` with the value seen and a hint.
"""

from __future__ import annotations

import math
from typing import Mapping, NamedTuple

from .formatting import bound_text, number_text
from .signal_config import SignalConfig

RUN = 20
"""Consecutive samples after which a run of values is suspicious."""


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
_NOT_MEASURED = -0.01


class Suspicion:
    """Checks the samples of one signal."""

    __slots__ = (
        "_between",
        "_config",
        "_fractions",
        "_only_zeros",
        "_unreadable",
        "_zeros",
        "ordinary_max",
        "ordinary_min",
        "text",
        "watching",
    )

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

    def see_good(self, raw: float, number: float) -> None:
        """Processes a good sample.

        Args:
            raw: the number as received.
            number: the same in the signal's unit.
        """
        self._unreadable = 0
        self.text = self._explain_good(raw, number)
        self.watching = self._only_zeros or self._fractions > 0 or self.text != ""

    def see_bad(self, raw: float, number: float) -> None:
        """Processes a sample that is not valid.

        Args:
            raw: the number as received, NaN if it was none.
            number: the same in the signal's unit, NaN for a placeholder.
        """
        self._fractions = 0
        self._between = False
        self._unreadable = self._unreadable + 1 if math.isnan(raw) else 0
        self.text = self._explain_bad(raw, number)
        self.watching = self._only_zeros or self._unreadable > 0 or self.text != ""

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
            return _suspect(
                f"{self._fractions} values in a row from 0 to 1, the last {number_text(number)},"
                " look like a fraction, not like %",
                f"if so, set scale: {bound_text(100.0 * self._config.scale)}",
            )
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
        config = self._config
        shown = number_text(raw)
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
    # BatteryState.percentage as some drivers send it; Float32 brings it as -0.009999999776
    if not math.isclose(raw, _NOT_MEASURED, rel_tol=1e-6):
        return ""
    return _suspect("-0.01 is what some drivers send for 'not measured'", "if so, set placeholders: [-0.01]")


def _suspect(seen: str, remedy: str) -> str:
    return f"suspicious data: {seen}; {remedy}"
