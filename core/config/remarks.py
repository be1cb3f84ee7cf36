"""Remarks about a configuration that is valid but questionable. They change no level."""

from __future__ import annotations

from typing import Iterator

from ..values import bound_text
from .signal_config import SignalConfig

_VOLTS = ("V", "mV", "volt", "volts")


def doubt_of(config: SignalConfig) -> str:
    """Returns why the statistic of a signal is questionable, as a hint beside its value; empty if it is not.

    In simulated discharges, the time to 20 % charge was exact where the time to 3.4 V was off by -25 to +173 %
    (quartiles; docs/reference/benchmarks.md).
    """
    if config.statistic == "forecast" and config.unit in _VOLTS:
        return "a forecast of a voltage is questionable; prefer the charge in %"
    return ""


def remarks_of(config: SignalConfig) -> Iterator[tuple[str, str]]:
    """Yields key and remark for each setting of a signal that is questionable."""
    doubt = doubt_of(config)
    if doubt:
        yield "unit", doubt
    if config.lifecycle:
        yield "lifecycle", "on ROS 1, which has no lifecycle nodes, this is an error"
    forecast_s, window_s = config.forecast_s, config.window_s
    if forecast_s is None or forecast_s <= window_s:
        return
    for level, key, for_s in (("warn", "for_s", config.for_s), ("error", "error_for_s", config.error_for_s)):
        if for_s < window_s / 2.0 and any(name.startswith(level) for name in config.bounds):
            above = f"with forecast_s ({bound_text(forecast_s)}) above window_s ({bound_text(window_s)})"
            yield key, f"{above}, noise alerts falsely; set it to at least {bound_text(window_s / 2.0)}"
