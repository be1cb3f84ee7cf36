"""`robot-health export`: the thresholds of a file for Prometheus and Grafana."""

from __future__ import annotations

import argparse
import sys

from robot_health_monitor.core.config import load_config
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.ops.export.grafana import export_dashboard
from robot_health_monitor.ops.export.prometheus import Export, export_rules


def export(arguments: argparse.Namespace) -> None:
    """Writes alerting rules or a dashboard on stdout, and what they cannot express on stderr.

    Raises:
        ConfigError: the file cannot be used.
    """
    config = load_config(arguments.file)
    if arguments.target == "prometheus":
        exported = export_rules(config, robots=arguments.robot, interval_s=arguments.interval)
    else:
        exported = Export(export_dashboard(config), ())
    for problem in exported.problems:
        sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
    sys.stdout.write(exported.text)
