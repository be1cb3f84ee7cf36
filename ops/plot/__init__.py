"""The plot of a signal, in plain JavaScript: used by the report of a replay and by the web page."""

from __future__ import annotations

import pkgutil
import sys
from functools import lru_cache
from typing import Any

from ...core.config import SignalConfig

__all__ = ["plot_bounds", "plot_script", "plot_style", "read_text"]


def plot_script() -> str:
    """Returns the script, which defines `HealthPlot`; plot.js describes it."""
    return "".join(read_text(__name__, name) for name in ("view.js", "ahead.js", "values.js", "plot.js"))


def plot_style() -> str:
    """Returns the style sheet, for light, dark and printed pages."""
    return read_text(__name__, "plot.css")


@lru_cache(maxsize=1000)
def plot_bounds(config: SignalConfig) -> list[dict[str, Any]]:
    """Returns the bounds of a signal as the plot takes them, each with the value at which its alert clears.

    The robots of a fleet share the list, which must not be changed.
    """
    bounds = []
    for name, bound in config.bounds.items():
        level, _, side = name.partition("_")
        clears = bound + config.hysteresis if side == "below" else bound - config.hysteresis
        clears = min(max(clears, -sys.float_info.max), sys.float_info.max)  # JSON has no infinity
        bounds.append({"level": level.upper(), "side": side, "value": bound, "clears": clears})
    return bounds


def read_text(package: str, name: str) -> str:
    """Returns a file of a package."""
    data = pkgutil.get_data(package, name)
    assert data is not None
    return data.decode("utf-8")
