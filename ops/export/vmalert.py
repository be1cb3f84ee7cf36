"""Rules for vmalert 1.79 over VictoriaMetrics, made of the same rules for Prometheus.

It refuses `keep_firing_for`. In PromQL: an alert that fires goes on while its condition held within that time.
The condition is recorded, and that the alert fires is read from vmalert's own `ALERTS`, which it writes to
VictoriaMetrics. Both are seen one evaluation later than by Prometheus.
"""

from __future__ import annotations

import re
from typing import Any, Dict, List, Mapping

import yaml

from ..notifications.alertmanager import ALERT

ACTIVE = "robot_health:active"
"""Recorded series: the condition of an alert with `keep_firing_for`, while it holds."""

_HEADER = """\
# The rules of rules.yaml for vmalert 1.79 or newer, which has no keep_firing_for: PromQL says the same.
# What a rule records, the next one reads one evaluation later. That is the only difference.
"""
_WRITTEN_S = 10.0
"""Time until what vmalert writes can be read: it is sent every 5 s."""
_UNITS = {"ms": 0.001, "s": 1.0, "m": 60.0, "h": 3600.0}


def for_vmalert(rules: str) -> str:
    """Returns a rule file of vmalert that says the same as one of Prometheus."""
    groups = yaml.safe_load(rules)["groups"]
    for index, group in enumerate(groups):
        interval_s = _seconds(group["interval"])
        numbered = [(f"{index}.{number}", rule) for number, rule in enumerate(group["rules"])]
        group["rules"] = [made for number, rule in numbered for made in _without_keep(rule, number, interval_s)]
    text: str = yaml.dump({"groups": groups}, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1_000_000)
    return _HEADER + text


def _without_keep(rule: Mapping[str, Any], number: str, interval_s: float) -> List[Dict[str, Any]]:
    """Returns the rule as it is, or a recorded condition and the alert that reads it."""
    found = dict(rule)
    if "keep_firing_for" not in found:
        return [found]
    keep_s = _seconds(found.pop("keep_firing_for"))
    level = found["labels"]["level"]
    # Prometheus counts from the first evaluation at which the condition no longer holds.
    held = f'{ACTIVE}{{rule="{number}", level="{level}"}}[{keep_s + interval_s:g}s]'
    active = f"max by (robot, signal) (last_over_time({held}))"
    firing = f'ALERTS{{alertname="{ALERT}", alertstate="firing", level="{level}"}}'
    lately = f"last_over_time({firing}[{2.0 * interval_s + _WRITTEN_S:g}s])"
    condition = {"record": ACTIVE, "labels": {"rule": number, "level": level}, "expr": found["expr"]}
    found["expr"] = f"({found['expr']})\nor on (robot, signal) (\n  {active}\n  and on (robot, signal) {lately}\n)"
    return [condition, found]


def _seconds(duration: str) -> float:
    """Returns the seconds of a duration of Prometheus."""
    return sum(float(number) * _UNITS[unit] for number, unit in re.findall(r"(\d+)(ms|s|m|h)", duration))


class _Dumper(yaml.SafeDumper):
    """Writes expressions of several lines as they are."""


def _text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(str, _text)
