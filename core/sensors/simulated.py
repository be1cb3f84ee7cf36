"""Simulated sources: a battery, a temperature and a CPU load with realistic courses.

Each value is a pure function of the seed and of the seconds since the first read: the same seed gives the same values,
however often a source is read. If time goes back, the source continues from its last value.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

from ..config import declared

_SPELL_S = 30.0
"""Duration of a hot spell: visible, and slow enough to cross a threshold only once while it rises."""


@dataclass
class _Simulated:
    """Measures the seconds since the first read; they never go back."""

    seed: object = 0
    """Selects the series of values, if they vary."""

    _start_s = _last_s = math.nan

    def _elapsed_s(self, now_s: float) -> float:
        if math.isnan(self._start_s):
            self._start_s = now_s
        elif now_s < self._last_s:
            self._start_s -= self._last_s - now_s
        self._last_s = now_s
        return now_s - self._start_s


@dataclass
class SimulatedBattery(_Simulated):
    """A battery that discharges at a constant rate from 100 % and is charged when it is nearly empty."""

    discharge_rate: float = declared(1.0, "simulated: discharge in % per second", 0.0)
    """0 keeps it full."""
    charge_rate: float = declared(4.0, "simulated: charge in % per second", 0.0)
    """0 leaves it empty."""
    charge_at: float = declared(5.0, "simulated: level in % at which charging starts", 0.0, 99.0)
    """It ends at 100 %."""

    def read(self, now_s: float) -> float:
        """Returns the charge in %."""
        swing = 100.0 - self.charge_at
        discharge_s = swing / self.discharge_rate if self.discharge_rate else math.inf
        charge_s = swing / self.charge_rate if self.charge_rate else math.inf
        elapsed_s = self._elapsed_s(now_s) % (discharge_s + charge_s)
        if elapsed_s <= discharge_s:
            return 100.0 - self.discharge_rate * elapsed_s
        return min(self.charge_at + self.charge_rate * (elapsed_s - discharge_s), 100.0)


@dataclass
class SimulatedTemperature(_Simulated):
    """A temperature that varies slowly around its mean, with occasional hot spells."""

    mean: float = declared(60.0, "simulated: mean in degrees C")
    spread: float = declared(4.0, "simulated: largest deviation from the mean in degrees C", 0.0)
    spike: float = declared(30.0, "simulated: height in degrees C of a hot spell of 30 s; 0: none", 0.0)
    spike_every_s: float = declared(120.0, "simulated: period in s with one hot spell each", 1.0)

    def read(self, now_s: float) -> float:
        """Returns the temperature in degrees C."""
        elapsed_s = self._elapsed_s(now_s)
        wander = self.spread * _wave(self.seed, "wander", elapsed_s, 40.0)
        return self.mean + wander + self.spike * self._spell(elapsed_s)

    def _spell(self, elapsed_s: float) -> float:
        """Returns the intensity of a hot spell, 0 to 1: a raised cosine over time."""
        slot, into_slot_s = divmod(elapsed_s, self.spike_every_s)
        lasts_s = min(_SPELL_S, self.spike_every_s)
        begins_s = (self.spike_every_s - lasts_s) * random.Random(f"{self.seed}/spell/{int(slot)}").random()
        into_spell = (into_slot_s - begins_s) / lasts_s
        return (1.0 - math.cos(2.0 * math.pi * into_spell)) / 2.0 if 0.0 < into_spell < 1.0 else 0.0


@dataclass
class SimulatedCpuUsage(_Simulated):
    """A CPU load from 0 to 100 %: a slow and a fast variation around its mean."""

    mean: float = declared(35.0, "simulated: mean in %", 0.0, 100.0)
    spread: float = declared(30.0, "simulated: largest deviation from the mean in %", 0.0)
    """The result is limited to 0 to 100."""

    def read(self, now_s: float) -> float:
        """Returns the CPU load in %."""
        elapsed_s = self._elapsed_s(now_s)
        slow = _wave(self.seed, "tide", elapsed_s, 80.0)
        fast = _wave(self.seed, "ripple", elapsed_s, 6.0)
        return min(max(self.mean + self.spread * (0.7 * slow + 0.3 * fast), 0.0), 100.0)


def _wave(seed: object, stream: str, elapsed_s: float, period_s: float) -> float:
    """Returns a sine between -1 and 1, whose phase is that of the seed and the stream.

    The first number of a `random.Random` seeded with a text is the same on every Python since 3.2.
    """
    phase = random.Random(f"{seed}/{stream}").random()
    return math.sin(2.0 * math.pi * (elapsed_s / period_s + phase))
