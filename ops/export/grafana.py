"""A dashboard of Grafana for robots and their signals, over the metrics that a monitor serves.

What does not depend on the signals is in `files/dashboard.json`, and what all signals share in `signal_panels.json`.
"""

from __future__ import annotations

import json
from typing import Any

from ...core.config import LINK, MonitorConfig, SignalConfig
from ...core.judge import judged_unit
from ...core.values import JsonObject, duration_text
from .prometheus import FILES

_SIGNALS_Y, _ROW_HEIGHT = 20, 8
"""Where the rows of the signals begin, in Grafana's units."""
_ELEMENT = r"\[.+\]"
_UNITS = {"%": "percent", "degC": "celsius", "°C": "celsius", "V": "volt", "A": "amp", "Hz": "hertz", "s": "s"}
"""Grafana's names of units; others are shown as they are."""


def export_dashboard(config: MonitorConfig) -> str:
    """Returns a dashboard in JSON, with the variables `datasource` and `robot`, for the signals and their bounds."""
    board = _read("dashboard.json")
    rows = [_signal_row(signal) for signal in config.signals.values() if signal.name != LINK]
    for panel in board["panels"]:
        if panel["gridPos"]["y"] >= _SIGNALS_Y:
            panel["gridPos"]["y"] += _ROW_HEIGHT * len(rows)
    for number, panels in enumerate(rows):
        for panel in panels:
            panel["gridPos"]["y"] = _SIGNALS_Y + _ROW_HEIGHT * number
            panel["id"] = len(board["panels"]) + 1
            board["panels"].append(panel)
    return json.dumps(board, indent=1) + "\n"


def _read(name: str) -> Any:
    return json.loads((FILES / name).read_text(encoding="utf-8"))


def _signal_row(signal: SignalConfig) -> list[dict[str, Any]]:
    """Returns the plot of a signal's value, with its bounds as lines, and the timeline of its levels.

    The plot of a forecast has the latest value beside it.
    """
    element = f"=~{json.dumps(signal.name + _ELEMENT)}" if signal.is_template else f'="{signal.name}"'
    selected = f'{{robot=~"$robot", signal{element}}}'
    legend = "{{robot}} {{signal}}" if signal.is_template else "{{robot}}"
    unit = judged_unit(signal)
    plot, levels = _read("signal_panels.json")
    plot["title"], levels["title"] = signal.name, f"{signal.name}: level"
    (value,), (level,) = plot["targets"], levels["targets"]
    value.update(expr=f"robot_health_value{selected}", legendFormat=legend)
    level.update(expr=f"max by (robot, signal) (robot_health_level{selected})", legendFormat=legend)
    if signal.statistic == "forecast" and signal.forecast_s is not None:
        latest = {**value, "refId": "B", "expr": f"robot_health_latest{selected}"}
        plot["targets"] = [latest, {**value, "legendFormat": f"{legend} in {duration_text(signal.forecast_s)}"}]
    plot["fieldConfig"]["defaults"] = {
        "unit": _UNITS.get(unit, f"suffix:{unit}" if unit else "none"),
        "thresholds": {"mode": "absolute", "steps": _steps(signal)},
        **({"custom": {"thresholdsStyle": {"mode": "line+area"}}} if signal.bounds else {}),
    }
    return [plot, levels]


def _steps(signal: SignalConfig) -> list[JsonObject]:
    """Returns the colours by value: Grafana's thresholds apply from their value upwards."""
    steps: list[JsonObject] = []
    start = None
    for bound, color in ((signal.error_below, "red"), (signal.warn_below, "orange")):
        if bound is not None:
            steps.append({"color": color, "value": start})
            start = bound
    steps.append({"color": "transparent", "value": start})
    above = ((signal.warn_above, "orange"), (signal.error_above, "red"))
    return steps + [{"color": color, "value": bound} for bound, color in above if bound is not None]
