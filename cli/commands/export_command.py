"""`robot-health export`: thresholds for Prometheus and Grafana, the files of a fleet, a policy for SROS2."""

from __future__ import annotations

import argparse
import os
import sys

from ...core.config import load_config, read_yaml
from ...core.values import printable
from ...ops.export.fleet import FleetSettings, export_fleet, require_address, require_receiver, write_files
from ...ops.export.grafana import export_dashboard
from ...ops.export.prometheus import export_rules
from ...runtime.interrupts import Interrupts
from ..arguments import Parser, add, add_namespace, checked, duration, robot_name, seconds
from ..fleet_configuration import read_entries


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Writes rules and dashboards over the metrics of a monitor, and configuration of other systems."
    )
    targets = parser.add_subparsers(dest="target", metavar="TARGET", required=True, parser_class=Parser)
    prometheus = targets.add_parser(
        "prometheus",
        help="alerting rules",
        description="Writes a rule file for Prometheus 2.42 or vmalert 1.79, or newer: an alert for each level that a "
        "monitor announces, and one for a monitor that does not run. It is the same for all thresholds.",
    )
    add(
        prometheus,
        "--robot NAME...",
        "robot that the rules apply to (repeatable; default: all)",
        type=robot_name,
    )
    meaning = "interval of scrapes and evaluations, at most 120 (default: 15)"
    add(prometheus, "--interval SECONDS", meaning, type=seconds, default=15.0)
    add(prometheus, "[FILE]", "a thresholds.yaml to check as well")
    grafana = targets.add_parser(
        "grafana", help="a dashboard", description="Writes a dashboard in JSON, to import into Grafana 9 or newer."
    )
    add(grafana, "FILE", "a thresholds.yaml")
    fleet = targets.add_parser(
        "fleet",
        help="the files of a fleet whose robots push",
        description="Writes the configuration of an agent for the robots, and of the centre that they push to: "
        "Prometheus or VictoriaMetrics, with Alertmanager. README.md in the folder says what to do with them.",
    )
    add(fleet, "FILE", "a thresholds.yaml, for the dashboard")
    add(fleet, "[FLEET]", "a fleet.yaml: its robots must report (default: those that reported in the last 24 h)")
    add(fleet, "--receiver URL", "full URL of the centre's remote write", required=True)
    add(fleet, "--to FOLDER", "folder to write the files to", required=True)
    meaning = "longest outage in which no data are lost (default: 24h)"
    add(fleet, "--outage TIME", meaning, type=duration, default=86_400.0)
    add(fleet, "--interval SECONDS", "scrape interval, at most 120 (default: 15)", type=seconds, default=15.0)
    meaning = "time without a report after which a robot is an alert (default: 15m)"
    add(fleet, "--silent-after TIME", meaning, type=duration, default=900.0)
    add(fleet, "--monitor HOST:PORT...", "monitor that an agent scrapes (repeatable; default: 127.0.0.1:9090)")
    sros2 = targets.add_parser(
        "sros2",
        help="a policy for SROS2",
        description="Writes the access control policy of the nodes with this configuration, for "
        "`ros2 security generate_artifacts`. The nodes share one enclave.",
    )
    add(sros2, "FILE", "a thresholds.yaml")
    add_namespace(sros2, "namespace of the nodes, the launch argument robot_name (default: none)")
    sensors = ("simulated", "host", "none")
    add(sros2, "--sensors", "the launch argument sensors (default: simulated)", choices=sensors, default="simulated")
    remapping = checked("FROM:=TO, such as battery_level:=/bms/level", _remapping, all)
    add(sros2, "--remap FROM:=TO...", "name that the launch file remaps (repeatable)", type=remapping)
    add(sros2, "--ops FILE", "an ops.yaml: its black box and its server")
    add(sros2, "--enclave PATH", "the enclave (default: health_monitor in the namespace)", default="")


def _remapping(text: str) -> tuple[str, str]:
    """Returns the two names of a remapping, of which one may be empty."""
    name, _, to = text.partition(":=")
    return name, to


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> None:
    """Writes rules, a dashboard or a policy on stdout, the files of a fleet to a folder."""
    exports = {"prometheus": _rules, "grafana": _dashboard, "fleet": _fleet, "sros2": _policy}
    sys.stdout.write(exports[arguments.target](arguments))


def _rules(arguments: argparse.Namespace) -> str:
    if arguments.file:
        load_config(arguments.file)
    return export_rules(robots=arguments.robot, interval_s=arguments.interval)


def _dashboard(arguments: argparse.Namespace) -> str:
    return export_dashboard(load_config(arguments.file))


def _fleet(arguments: argparse.Namespace) -> str:
    """Writes the files; returns their names, one per line."""
    settings = FleetSettings(
        require_receiver(arguments.receiver),
        arguments.outage,
        arguments.interval,
        arguments.silent_after,
        [require_address(address) for address in arguments.monitor] or FleetSettings._field_defaults["monitors"],
    )
    expected = None
    if arguments.fleet:
        expected = [entry.name for entry in read_entries(read_yaml(arguments.fleet), needs_url=False)]
    files = export_fleet(settings, load_config(arguments.file), expected)
    write_files(arguments.to, files)
    return "".join(f"{printable(os.path.join(arguments.to, name))}\n" for name in files)


def _policy(arguments: argparse.Namespace) -> str:
    from ...ops.configuration import OpsConfig, read_ops
    from ...ops.export.sros2 import Robot, export_policy

    ops = read_ops(read_yaml(arguments.ops)) if arguments.ops else OpsConfig()
    robot = Robot(arguments.namespace, arguments.sensors, dict(arguments.remap), ops)
    read = read_yaml(arguments.file)
    with read.located():
        return export_policy(read.tree, robot, arguments.enclave)
