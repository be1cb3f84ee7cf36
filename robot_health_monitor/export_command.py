"""`robot-health export`: the thresholds of a file for Prometheus and Grafana."""

from __future__ import annotations

import argparse
import sys

from robot_health_monitor.core.config import load_config
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.ops.export.grafana import export_dashboard
from robot_health_monitor.ops.export.prometheus import Export, export_rules
from robot_health_monitor.runtime.interrupts import Interrupts

from .arguments import Parser, seconds
from .exit_codes import ExitCode


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Writes the thresholds of a file for other systems, on stdout. They read the metrics that a "
        "monitor serves at /metrics."
    )
    targets = parser.add_subparsers(dest="target", metavar="TARGET", required=True, parser_class=Parser)
    prometheus = targets.add_parser(
        "prometheus",
        help="alerting rules",
        description="Writes a rule file for Prometheus 2.42 or newer. What PromQL cannot express is a comment at its "
        "rule and a line on stderr.",
    )
    prometheus.add_argument(
        "--robot",
        metavar="NAME",
        action="append",
        default=[],
        help="robot that the rules apply to (repeatable; default: all)",
    )
    prometheus.add_argument(
        "--interval",
        metavar="SECONDS",
        type=seconds,
        default=15.0,
        help="interval of scrapes and evaluations; durations are rounded up to it (default: 15)",
    )
    grafana = targets.add_parser(
        "grafana", help="a dashboard", description="Writes a dashboard in JSON, to import into Grafana 9 or newer."
    )
    for target in (prometheus, grafana):
        target.add_argument("file", metavar="FILE", help="a thresholds.yaml")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Writes alerting rules or a dashboard on stdout, and what they cannot express on stderr; returns the exit code."""
    config = load_config(arguments.file)
    if arguments.target == "prometheus":
        exported = export_rules(config, robots=arguments.robot, interval_s=arguments.interval)
    else:
        exported = Export(export_dashboard(config), ())
    for problem in exported.problems:
        sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
    sys.stdout.write(exported.text)
    return ExitCode.SUCCESS
