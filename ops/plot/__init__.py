"""The plot of a signal, in plain JavaScript: used by the report of a replay and by the web page."""

from __future__ import annotations

import pkgutil


def plot_script() -> str:
    """Returns the script, which defines `HealthPlot`; plot.js describes it."""
    return _read("plot.js")


def plot_style() -> str:
    """Returns the style sheet, for light, dark and printed pages."""
    return _read("plot.css")


def _read(name: str) -> str:
    data = pkgutil.get_data(__name__, name)
    assert data is not None
    return data.decode("utf-8")
