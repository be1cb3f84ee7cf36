"""Alerting rules for Prometheus and vmalert, over the levels that monitors announce. They judge nothing themselves.

The rules are template files with named fields, `@FIELD@`, as are the other files of a fleet.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Mapping, Sequence

from ...core.values import ConfigError, duration_text

FILES = Path(__file__).parent / "files"
"""The templates."""
EXPECTED_S = 86_400.0
"""How long a robot is expected after it last reported, without a fleet.yaml."""
_LEAST_SHARE = 0.6
"""Share of the time of silence during which the centre must have run."""
_FIELD = re.compile("@([A-Z_]+)@")
_ESCAPED = re.compile(r"[^\w\x80-\U0010ffff]", re.ASCII)
_INTERVALS_S = 0.1, 120.0
"""For Prometheus, a series has ended 5 minutes after its last sample: a scrape or two may fail."""

_OF_FILE = "A robot of fleet.yaml must report; one that is taken out of it, and exported again, is decommissioned."
_OF_REPORTS = "A robot is expected for 24 h after it last reported: one that is decommissioned is no alert after that."
_EXPECTED = "      - record: robot_health:expected\n"
_LATELY = f"max by (robot) (last_over_time(robot_health:last_tick[1h]) > time() - {EXPECTED_S:.0f})"


def filled(name: str, fields: Mapping[str, str]) -> str:
    """Returns a template with its fields; a line that consists of one may become several."""
    text = (FILES / name).read_text(encoding="utf-8")
    return _FIELD.sub(lambda field: fields[field[1]].rstrip("\n"), text)


def export_rules(*, robots: Sequence[str] = (), interval_s: float = 15.0) -> str:
    """Returns the rules for robots of these names (all if empty), which Prometheus scrapes every `interval_s`.

    Raises ConfigError if Prometheus cannot evaluate rules at this interval.
    """
    fields = _level_fields(interval_s, _selector(robots))
    return filled("scraped_rules.yaml", {**fields, "LATE_S": f"{max(30.0, 4.0 * interval_s):g}"})


def export_fleet_rules(expected: Sequence[str] | None, *, interval_s: float, silent_after_s: float) -> str:
    """Returns the rules for robots that push, and an alert for each that has not reported for `silent_after_s`.

    `expected` are the robots that must report; None stands for those that reported in the last 24 h. Raises ConfigError
    as `export_rules`.
    """
    every_s = max(interval_s, min(60.0, silent_after_s / 10.0))
    robots = [f"        labels: {{robot: {_quoted(robot)}}}\n        expr: vector(1)\n" for robot in expected or ()]
    records = [f"        expr: {_LATELY}\n"] if expected is None else robots
    return filled(
        "centre/rules.yaml",
        {
            **_level_fields(interval_s),
            "EXPECTATION": _OF_REPORTS if expected is None else _OF_FILE,
            "EXPECTED": "".join(_EXPECTED + record for record in records),
            "SILENCE_INTERVAL": duration(every_s),
            "SILENT_AFTER": duration(silent_after_s),
            "SILENT_AFTER_S": f"{silent_after_s:g}",
            "SILENT_AFTER_TEXT": duration_text(silent_after_s),
            "LEAST_EVALUATIONS": f"{int(_LEAST_SHARE * silent_after_s / every_s)}",
        },
    )


def _level_fields(interval_s: float, robots: str = "") -> Mapping[str, str]:
    least_s, most_s = _INTERVALS_S
    if not least_s <= interval_s <= most_s:
        raise ConfigError(f"expected an interval from {least_s:g} to {most_s:g} s, got {interval_s:g} s")
    fields = {
        "INTERVAL": duration(interval_s),
        "INTERVAL_S": f"{interval_s:g}",
        "TWO_INTERVALS": duration(2.0 * interval_s),
        "ROBOTS": robots,
    }
    return {**fields, "LEVELS": filled("level_rules.yaml", fields)}


def _selector(robots: Sequence[str]) -> str:
    """Returns the matcher of these robots, in braces; without any, nothing."""
    # Names match as they are. RE2 lets ASCII be escaped, and no other character.
    pattern = "|".join(_ESCAPED.sub(r"\\\g<0>", name) for name in robots)
    return f"{{robot=~{_quoted(pattern)}}}" if robots else ""


def _quoted(text: str) -> str:
    """Returns a string of PromQL, which is one of YAML too: unquoted, `on` and `null` are no texts there."""
    return json.dumps(text, ensure_ascii=False)


def duration(seconds: float) -> str:
    """Returns a duration as Prometheus reads it, in the largest unit of which it is a whole number.

    >>> [duration(seconds) for seconds in (86_400.0, 90.0, 1.5)]
    ['24h', '90s', '1500ms']
    """
    milliseconds = round(seconds * 1000.0)
    for unit, size in (("h", 3_600_000), ("m", 60_000), ("s", 1000)):
        if milliseconds % size == 0:
            return f"{milliseconds // size}{unit}"
    return f"{milliseconds}ms"
