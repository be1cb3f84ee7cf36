"""Data that is valid by its numbers and yet looks wrong: another unit, a fraction for a percentage, a placeholder.

Nothing is rescaled and no level changes: the status says `suspicious data`, what was seen and what to configure.
"""

from __future__ import annotations

import math

from .config import SignalConfig
from .wording import number_text

RUN = 20
"""Good samples in a row that it takes to suspect a run of values."""

_THOUSANDS = {"degC": "millidegrees", "°C": "millidegrees", "C": "millidegrees", "V": "millivolts", "A": "milliamperes"}


class Suspicion:
    """Follows the samples of one signal."""

    __slots__ = ("_between", "_config", "_only_zeros", "_run", "_samples", "text", "watching")

    def __init__(self, config: SignalConfig) -> None:
        """Suspects nothing yet."""
        self._config = config
        self._run = 0
        self._between = False
        self._samples = 0
        self._only_zeros = any(name.endswith("below") for name in config.bounds)
        self.text = ""
        """`suspicious data: ...`, empty while nothing is suspected."""
        self.watching = self._only_zeros
        """Whether a good sample above 1 matters: while it does not, such a sample need not be shown."""

    def see_good(self, number: float) -> None:
        """Takes a good sample, in the signal's unit."""
        self._judge_good(number)
        self.watching = self._only_zeros or self._run > 0 or self.text != ""

    def _judge_good(self, number: float) -> None:
        self._samples += 1
        if self._only_zeros:
            self._only_zeros = number == 0.0
            if self._only_zeros and self._samples >= RUN:
                self.text = _suspect("0 ever since the start", "if it means 'not measured', set placeholders: [0.0]")
                return
        if self._config.unit != "%" or not 0.0 <= number <= 1.0:
            self._run = 0
            self._between = False
            self.text = ""
            return
        self._run += 1
        self._between = self._between or 0.0 < number < 1.0
        if self._run >= RUN and self._between:
            self.text = _suspect(
                f"{self._run} values in a row from 0 to 1, the last {number_text(number)},"
                " look like a fraction, not like %",
                "if so, set scale: 100.0",
            )
        else:
            self.text = ""

    def see_bad(self, came: float, number: float) -> None:
        """Takes a sample that is not valid.

        Args:
            came: the number as it came, NaN if it was none.
            number: the same in the signal's unit.
        """
        self._run = 0
        self._between = False
        self.text = self._explain_bad(came, number)
        self.watching = self._only_zeros or self.text != ""

    def _explain_bad(self, came: float, number: float) -> str:
        config = self._config
        if math.isnan(number) and not math.isnan(came):  # a placeholder that is known to be one
            return ""
        if abs(came + 0.01) < 1e-6:
            return _suspect("-0.01 is what some drivers send for 'not measured'", "if so, set placeholders: [-0.01]")
        if config.valid_max is None or not number > config.valid_max:
            return ""
        shown = number_text(came)
        if config.unit == "%" and config.scale == 100.0 and 1.0 < came <= 100.0:
            return _suspect(f"{shown} looks like a percentage already, not like a fraction", "if so, set scale: 1.0")
        if config.unit == "" and config.valid_max == 1.0 and number <= 100.0:
            return _suspect(f"{shown} looks like a percentage, not like a fraction", "if so, set scale: 0.01")
        thousands = _THOUSANDS.get(config.unit)
        if thousands and config.scale == 1.0 and number >= 1000.0 and number / 1000.0 <= config.valid_max:
            return _suspect(f"{shown} looks like {thousands}", "if so, set scale: 0.001")
        if config.unit in ("degC", "°C", "C") and 200.0 <= number <= 500.0:
            return _suspect(f"{shown} looks like kelvin", "if so, set unit: K and bounds in K")
        return ""


def _suspect(seen: str, remedy: str) -> str:
    return f"suspicious data: {seen}; {remedy}"
