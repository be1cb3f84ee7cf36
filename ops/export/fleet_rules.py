"""Rules for a fleet whose robots push: every robot by its label `robot`, and an alert for each that is silent for long.

The monitors serve the profile `fleet` of their metrics. What Prometheus knows of a scrape (`up`, `instance`) is not
used: an agent on the robot scrapes, and may deliver hours later.
"""

from __future__ import annotations

from typing import List, NamedTuple, Optional, Sequence

from robot_health_monitor.core.config import MonitorConfig
from robot_health_monitor.core.formatting import duration_text

from .prometheus import Export, alert, duration, group_head, quoted, record, rule_groups

LAST_TICK = "robot_health:last_tick"
"""Recorded series: the last tick of a robot's monitor, also while the robot is silent, as long as it is expected."""
EXPECTED = "robot_health:expected"
"""Recorded series: 1 for each robot of fleet.yaml."""
_EVALUATED = "robot_health:evaluated"
"""Recorded series: 1 at each evaluation. Without it, every robot would seem silent after an outage of the centre."""
EXPECTED_S = 86_400.0
"""How long a robot is expected after it last reported, without a fleet.yaml."""
_MEMORY = "1h"
"""How long the centre may have been stopped and still knows which robots were silent."""
_LEAST_SHARE = 0.6
"""Share of `silent_after_s` during which the centre must have run."""

_HEADER = """\
# Alerting rules of Robot Health Monitor for a fleet, made by `robot-health export fleet`.
# They need the metrics that each monitor serves at /metrics?profile=fleet, every {interval}. Robots differ by the label
# robot. Durations are rounded up to the interval, and what happens between two scrapes is not seen.
# - Rules judge the present. Samples that arrive late are stored with their time and not evaluated: no alert hours late.
# - While a robot is silent, its alerts resolve 5 minutes after its last sample; the alert of its monitor remains.
# - {expected}
"""
_OF_FILE = "A robot of fleet.yaml must report; one that is taken out of it, and exported again, is decommissioned."
_OF_REPORTS = "A robot is expected for 24 h after it last reported: one that is decommissioned is no alert after that."


class Judged(NamedTuple):
    """Robots with the same thresholds."""

    name: str  # of the group of rules
    config: MonitorConfig
    robots: Sequence[str]  # empty: all


def export_fleet_rules(
    judged: Sequence[Judged], expected: Optional[Sequence[str]], *, interval_s: float, silent_after_s: float
) -> Export:
    """Returns a rule file for Prometheus.

    `expected` are the robots that must report; None: those that reported in the last 24 h.
    """
    problems: List[str] = []
    known = _OF_REPORTS if expected is None else _OF_FILE
    lines = _HEADER.format(interval=duration(interval_s), expected=known).splitlines()
    lines.append("groups:")
    for name, config, robots in judged:
        lines += [*rule_groups(name, config, robots, interval_s, problems), ""]
    lines += _silent_group(expected, interval_s, silent_after_s)
    return Export("\n".join(lines) + "\n", problems)


def _silent_group(expected: Optional[Sequence[str]], interval_s: float, silent_after_s: float) -> List[str]:
    """Returns the rules for robots that have not reported for long."""
    every_s = max(interval_s, min(60.0, silent_after_s / 10.0))
    ticked = "max by (robot) (robot_health_last_tick_timestamp_seconds)"
    before = f"last_over_time({LAST_TICK}[{_MEMORY}])"
    still = f"{before} > time() - {EXPECTED_S:.0f}" if expected is None else f"({before} and on (robot) {EXPECTED})"
    lines = group_head("robot_health silent robots", every_s)
    lines += record(_EVALUATED, "vector(1)")
    for robot in expected or ():
        lines += record(EXPECTED, "vector(1)", f"robot: {quoted(robot)}")
    lines += record(LAST_TICK, f"{ticked}\nor on (robot) max by (robot) ({still})")
    silent = f"time() - {LAST_TICK} > {silent_after_s:g}"
    reason = "has not reported for {{ $value | humanizeDuration }}"
    if expected is not None:
        silent = f"({silent} and on (robot) {EXPECTED})\nor on (robot) ({EXPECTED} unless on (robot) {LAST_TICK}) + Inf"
        never = f"has not reported for more than {duration_text(silent_after_s)}"
        reason = f"{{{{ if gt $value 1e300 }}}}{never}{{{{ else }}}}{reason}{{{{ end }}}}"
    least = int(_LEAST_SHARE * silent_after_s / every_s)
    ran = f"count_over_time({_EVALUATED}[{duration(silent_after_s)}]) >= {least}"
    silent = f"max by (robot) (\n{silent}\n)\nand on () {ran}"
    comment = f"      # Silent for longer than {duration(silent_after_s)}, while the centre itself was running."
    return [*lines, "", comment, *alert("monitor", "ERROR", silent, reason, for_s=2.0 * interval_s)]
