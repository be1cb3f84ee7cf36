"""Scores: how healthy a value is by its own thresholds, so that values of different units can be averaged."""

from __future__ import annotations

from typing import Optional

from .signal_config import SignalConfig


def health_score(value: float, signal: SignalConfig) -> float:
    """Returns how healthy `value`, in the signal's unit, is by its thresholds, from 0 to 100.

    100 is the healthy end of the valid range, 50 the WARN bound, 0 the ERROR bound or, without one, the unhealthy end
    of the valid range; linear between them. A signal with bounds on both sides gets the worse of its two scores. A
    side without a WARN bound gives 100.
    """
    below = (signal.warn_below, signal.error_below, signal.valid_min, signal.valid_max)
    above = (signal.warn_above, signal.error_above, signal.valid_max, signal.valid_min)
    return min(_side_score(value, *below), _side_score(-value, *(None if end is None else -end for end in above)))


def _side_score(
    value: float, warn: Optional[float], error: Optional[float], worst: Optional[float], best: Optional[float]
) -> float:
    if warn is None:
        return 100.0
    zero = worst if error is None else error
    if value >= warn:
        return 100.0 if best is None or value >= best else 50.0 + 50.0 * (value - warn) / (best - warn)
    if zero is None:
        return 50.0
    return 0.0 if value <= zero or zero >= warn else 50.0 * (value - zero) / (warn - zero)
