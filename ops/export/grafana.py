"""A dashboard of Grafana for robots and their signals, over the metrics that a monitor serves."""

from __future__ import annotations

import json
from typing import Any, Dict, List, Mapping, Sequence, Tuple

from robot_health_monitor.core.config import MonitorConfig
from robot_health_monitor.core.explanation import judged_unit
from robot_health_monitor.core.formatting import duration_text
from robot_health_monitor.core.signal_config import LINK, SignalConfig

from ..notifications.alertmanager import ALERT
from .prometheus import signal_matcher

_DATASOURCE = {"type": "prometheus", "uid": "${datasource}"}
_ROBOT = 'robot=~"$robot"'
_COLUMNS = 24
_AUTO = "__auto"  # a legend of Grafana's choice
_UNITS = {"%": "percent", "degC": "celsius", "°C": "celsius", "V": "volt", "A": "amp", "Hz": "hertz", "s": "s"}
"""Grafana's names of units; others are shown as they are."""
_LEVELS = (("0", "OK", "green"), ("1", "WARN", "orange"), ("2", "ERROR", "red"), ("3", "STALE", "purple"))
_LINK_STATES = (("0", "up", "green"), ("1", "down", "red"))

_FIRING = f'ALERTS{{alertname="{ALERT}", alertstate="firing", {_ROBOT}}}'
_LINK_DOWN = f"1 - max by (robot) (robot_health_link_up{{{_ROBOT}}})"
_TRANSITIONS = f'sum by (robot, signal, to) (increase(robot_health_transitions_total{{{_ROBOT}, to!="OK"}}[1h]))'
_SAMPLES = f"sum by (robot, quality) (rate(robot_health_samples_total{{{_ROBOT}}}[$__rate_interval]))"
_SINCE_TICK = "time() - robot_health_last_tick_timestamp_seconds"


def export_dashboard(config: MonitorConfig) -> str:
    """Returns a dashboard in JSON, with the variables `datasource` and `robot`, for the signals and their bounds."""
    rows: List[List[Dict[str, Any]]] = [
        [
            _panel("stat", "Robots", "count(count by (robot) (robot_health_level))", _AUTO, 4, 4),
            _robots_not_ok(),
            _panel("table", "Firing alerts", _FIRING, _AUTO, 16, 8, instant=True),
        ],
        [_timeline("Worst level per robot", _worst_level(_ROBOT), 24, 8)],
        [_timeline("Link", _LINK_DOWN, 24, 4, _LINK_STATES)],
        *(_signal_row(signal) for signal in config.signals.values() if signal.name != LINK),
        [
            _panel("timeseries", "Alerts per hour", _TRANSITIONS, "{{robot}} {{signal}} {{to}}", 12, 8),
            _panel("timeseries", "Samples per second", _SAMPLES, "{{robot}} {{quality}}", 12, 8),
        ],
        [
            _panel("timeseries", "Time since the last tick", _SINCE_TICK, "{{instance}}", 12, 6, unit="s"),
            _panel("timeseries", "Notifications waiting", "robot_health_notifications_waiting", "{{instance}}", 12, 6),
        ],
    ]
    source = {"name": "datasource", "label": "Data source", "type": "datasource", "query": "prometheus"}
    robot = {
        "name": "robot", "label": "Robot", "type": "query", "datasource": _DATASOURCE,
        "query": {"query": "label_values(robot_health_level, robot)", "refId": "robots"},
        "refresh": 2,  # at each change of the time range
        "sort": 1, "multi": True, "includeAll": True, "allValue": ".*", "current": {"text": "All", "value": "$__all"},
    }  # fmt: skip
    dashboard = {
        "title": "Robot health", "uid": "robot-health", "tags": ["robots"], "schemaVersion": 36, "refresh": "10s",
        "time": {"from": "now-1h", "to": "now"}, "templating": {"list": [source, robot]}, "panels": _placed(rows),
    }  # fmt: skip
    return json.dumps(dashboard, indent=1) + "\n"


def _worst_level(which: str) -> str:
    """Returns an expression for the worst level: OK < WARN < STALE < ERROR, which is not the order of the numbers."""
    of_these = f"robot_health_level{{{which}}}"
    return " or ".join(f"max by (robot) ({of_these}{condition})" for condition in (" == 2", " == 3", ""))


def _signal_row(signal: SignalConfig) -> List[Dict[str, Any]]:
    """Returns the plot of a signal's value, with its bounds as lines, and the timeline of its levels.

    The plot of a forecast has the latest value beside it.
    """
    selected = f"{{{_ROBOT}, {signal_matcher(signal)}}}"
    legend = "{{robot}} {{signal}}" if signal.is_template else "{{robot}}"
    unit = judged_unit(signal)
    unit = _UNITS.get(unit, f"suffix:{unit}" if unit else "none")
    panel = _panel("timeseries", signal.name, f"robot_health_value{selected}", legend, 16, 8, unit=unit)
    if signal.statistic == "forecast" and signal.forecast_s is not None:
        (value,) = panel["targets"]
        latest = {**value, "refId": "B", "expr": f"robot_health_latest{selected}"}
        panel["targets"] = [latest, {**value, "legendFormat": f"{legend} in {duration_text(signal.forecast_s)}"}]
    defaults = panel["fieldConfig"]["defaults"]
    defaults["thresholds"] = {"mode": "absolute", "steps": _steps(signal)}
    if signal.bounds:
        defaults["custom"] = {"thresholdsStyle": {"mode": "line+area"}}
    levels = f"max by (robot, signal) (robot_health_level{selected})"
    return [panel, _timeline(f"{signal.name}: level", levels, 8, 8, legend=legend)]


def _steps(signal: SignalConfig) -> List[Mapping[str, Any]]:
    """Returns the colours by value: Grafana's thresholds apply from their value upwards."""
    below = [(signal.error_below, "red"), (signal.warn_below, "orange")]
    above = [(signal.warn_above, "orange"), (signal.error_above, "red")]
    steps: List[Mapping[str, Any]] = []
    start = None
    for bound, color in below:
        if bound is not None:
            steps.append({"color": color, "value": start})
            start = bound
    steps.append({"color": "transparent", "value": start})
    return steps + [{"color": color, "value": bound} for bound, color in above if bound is not None]


def _robots_not_ok() -> Dict[str, Any]:
    panel = _panel("stat", "Robots not OK", f"count(({_worst_level('')}) > 0) or vector(0)", _AUTO, 4, 4)
    steps = [{"color": "green", "value": None}, {"color": "red", "value": 1}]
    panel["fieldConfig"]["defaults"]["thresholds"] = {"mode": "absolute", "steps": steps}
    return panel


def _timeline(
    title: str,
    expression: str,
    width: int,
    height: int,
    states: Sequence[Tuple[str, str, str]] = _LEVELS,
    legend: str = "{{robot}}",
) -> Dict[str, Any]:
    panel = _panel("state-timeline", title, expression, legend, width, height)
    options = {value: {"text": text, "color": color} for value, text, color in states}
    panel["fieldConfig"]["defaults"]["mappings"] = [{"type": "value", "options": options}]
    return panel


def _panel(
    kind: str,
    title: str,
    expression: str,
    legend: str,
    width: int,
    height: int,
    *,
    unit: str = "none",
    instant: bool = False,
) -> Dict[str, Any]:
    target: Dict[str, Any] = {"refId": "A", "datasource": _DATASOURCE, "expr": expression, "legendFormat": legend}
    if instant:
        target.update(instant=True, range=False, format="table")
    return {
        "type": kind, "title": title, "datasource": _DATASOURCE, "targets": [target],
        "gridPos": {"w": width, "h": height}, "options": {},
        "fieldConfig": {"defaults": {"unit": unit}, "overrides": []},
    }  # fmt: skip


def _placed(rows: Sequence[Sequence[Dict[str, Any]]]) -> List[Dict[str, Any]]:
    """Gives every panel its number and its place."""
    panels: List[Dict[str, Any]] = []
    top = 0
    for row in rows:
        left = 0
        for panel in row:
            panel["gridPos"].update(x=left, y=top)
            panel["id"] = len(panels) + 1
            panels.append(panel)
            left += panel["gridPos"]["w"]
        assert left <= _COLUMNS
        top += max(panel["gridPos"]["h"] for panel in row)
    return panels
