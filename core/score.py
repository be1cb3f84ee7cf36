"""Scores: how healthy a value is by its own thresholds, so that values of different units can be averaged."""

from __future__ import annotations

from typing import List, Optional, Tuple

from .signal_config import SignalConfig


def health_score(value: float, signal: SignalConfig) -> float:
    """Returns how healthy `value` is, from 0 to 100.

    100 is the healthy end of the valid range, 50 the WARN bound, 0 the ERROR bound or, without one, the unhealthy end
    of the valid range; linear between them. A signal with bounds on both sides gets the worse of its two scores. A
    side without a WARN bound gives 100.

    Args:
        value: in the signal's unit.
        signal: its thresholds.
    """
    below = _side_score(value, signal.warn_below, signal.error_below, signal.valid_min, signal.valid_max)
    above = _side_score(
        -value, _negated(signal.warn_above), _negated(signal.error_above), _negated(signal.valid_max),
        _negated(signal.valid_min),
    )  # fmt: skip
    return min(below, above)


def _negated(number: Optional[float]) -> Optional[float]:
    return None if number is None else -number


def _side_score(
    value: float, warn: Optional[float], error: Optional[float], worst: Optional[float], best: Optional[float]
) -> float:
    if warn is None:
        return 100.0
    zero = worst if error is None else error
    if zero is not None and value < warn <= zero:
        return 0.0
    points: List[Tuple[float, float]] = [(warn, 50.0)]
    if zero is not None and zero < warn:
        points.insert(0, (zero, 0.0))
    if best is not None and best > warn:
        points.append((best, 100.0))
    elif value >= warn:
        return 100.0
    if value <= points[0][0]:
        return points[0][1]
    for (left, left_score), (right, right_score) in zip(points, points[1:]):
        if value <= right:
            return left_score + (right_score - left_score) * (value - left) / (right - left)
    return points[-1][1]
