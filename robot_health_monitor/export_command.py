"""`robot-health export`: thresholds for Prometheus and Grafana, the files of a fleet, a policy for SROS2."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Sequence, Tuple

from robot_health_monitor.core.config import load_config
from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.ops.export.grafana import export_dashboard
from robot_health_monitor.ops.export.prometheus import Export, export_rules
from robot_health_monitor.runtime.interrupts import Interrupts

from .arguments import Parser, add_namespace, duration, robot_name, seconds
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
        type=robot_name,
        action="append",
        default=[],
        help="robot that the rules apply to (repeatable; default: all)",
    )
    prometheus.add_argument(
        "--interval",
        metavar="SECONDS",
        type=seconds,
        default=15.0,
        help="interval of scrapes and evaluations, at most 120; durations are rounded up to it (default: 15)",
    )
    grafana = targets.add_parser(
        "grafana", help="a dashboard", description="Writes a dashboard in JSON, to import into Grafana 9 or newer."
    )
    fleet = targets.add_parser(
        "fleet",
        help="the files of a fleet whose robots push",
        description="Writes the configuration of an agent for the robots, and of the centre that they push to: "
        "Prometheus or VictoriaMetrics, with Alertmanager. README.md in the folder says what to do with them.",
    )
    sros2 = targets.add_parser(
        "sros2",
        help="a policy for SROS2",
        description="Writes the access control policy of the nodes with this configuration, for "
        "`ros2 security generate_artifacts`. The nodes share one enclave.",
    )
    for target in (prometheus, grafana, fleet, sros2):
        target.add_argument("file", metavar="FILE", help="a thresholds.yaml")
    _add_fleet_arguments(fleet)
    _add_policy_arguments(sros2)


def _add_fleet_arguments(fleet: Parser) -> None:
    fleet.add_argument(
        "fleet",
        metavar="FLEET",
        nargs="?",
        default="",
        help="a fleet.yaml: its robots must report (default: those that reported in the last 24 h)",
    )
    fleet.add_argument("--receiver", metavar="URL", required=True, help="full URL of the centre's remote write")
    fleet.add_argument("--to", metavar="FOLDER", required=True, help="folder to write the files to")
    fleet.add_argument(
        "--outage",
        metavar="TIME",
        type=duration,
        default=86_400.0,
        help="longest outage in which no data are lost (default: 24h)",
    )
    fleet.add_argument(
        "--interval", metavar="SECONDS", type=seconds, default=15.0, help="scrape interval, at most 120 (default: 15)"
    )
    fleet.add_argument(
        "--silent-after",
        metavar="TIME",
        type=duration,
        default=900.0,
        help="time without a report after which a robot is an alert (default: 15m)",
    )
    fleet.add_argument(
        "--monitor",
        metavar="HOST:PORT",
        action="append",
        default=[],
        help="monitor that an agent scrapes (repeatable; default: 127.0.0.1:9090)",
    )


def _add_policy_arguments(sros2: Parser) -> None:
    add_namespace(sros2, "namespace of the nodes, the launch argument robot_name (default: none)")
    sros2.add_argument(
        "--sensors",
        choices=("simulated", "host", "none"),
        default="simulated",
        help="the launch argument sensors (default: simulated)",
    )
    sros2.add_argument(
        "--remap",
        metavar="FROM:=TO",
        type=_remapping,
        action="append",
        default=[],
        help="name that the launch file remaps (repeatable)",
    )
    sros2.add_argument("--ops", metavar="FILE", default="", help="an ops.yaml: its black box and its server")
    sros2.add_argument(
        "--enclave", metavar="PATH", default="", help="the enclave (default: health_monitor in the namespace)"
    )


def _remapping(text: str) -> Tuple[str, str]:
    """Returns the two names of a remapping."""
    name, separator, to = text.partition(":=")
    if not (name and separator and to):
        raise argparse.ArgumentTypeError(f"expected FROM:=TO, such as battery_level:=/bms/level, got {text!r}")
    return name, to


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Writes rules, a dashboard or a policy on stdout, and what they cannot express on stderr; returns the exit code.

    The files of a fleet are written to a folder.
    """
    if arguments.target == "fleet":
        return _export_fleet(arguments)
    if arguments.target == "sros2":
        return _export_policy(arguments)
    config = load_config(arguments.file)
    if arguments.target == "prometheus":
        exported = export_rules(config, robots=arguments.robot, interval_s=arguments.interval)
    else:
        exported = Export(export_dashboard(config), ())
    _warn(exported.problems)
    sys.stdout.write(exported.text)
    return ExitCode.SUCCESS


def _export_fleet(arguments: argparse.Namespace) -> int:
    # They need PyYAML, and the help of this command does not.
    from robot_health_monitor.ops.export.fleet import FleetSettings, export_fleet, require_address, require_receiver

    from .fleet_export import read_fleet, write_files

    settings = FleetSettings(
        require_receiver(arguments.receiver),
        arguments.outage,
        arguments.interval,
        arguments.silent_after,
        [require_address(address) for address in arguments.monitor] or FleetSettings._field_defaults["monitors"],
    )
    exported = export_fleet(settings, *read_fleet(arguments.file, arguments.fleet))
    write_files(arguments.to, exported.files)
    _warn(exported.problems)
    for name in exported.files:
        sys.stdout.write(f"{printable(os.path.join(arguments.to, name))}\n")
    return ExitCode.SUCCESS


def _export_policy(arguments: argparse.Namespace) -> int:
    from robot_health_monitor.core.yaml_file import read_yaml
    from robot_health_monitor.ops.configuration import OpsConfig, read_ops
    from robot_health_monitor.ops.export.sros2 import Robot, export_policy

    ops = read_ops(read_yaml(arguments.ops)) if arguments.ops else OpsConfig()
    robot = Robot(arguments.namespace, arguments.sensors, dict(arguments.remap), ops)
    read = read_yaml(arguments.file)
    try:
        sys.stdout.write(export_policy(read.tree, robot, arguments.enclave))
    except ConfigError as error:
        raise read.locate(error) from None
    return ExitCode.SUCCESS


def _warn(problems: Sequence[str]) -> None:
    for problem in problems:
        sys.stderr.write(f"{printable(f'WARN: {problem}')}\n")
