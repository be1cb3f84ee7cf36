"""`robot-health run`: the monitor in this process, without ROS."""

from __future__ import annotations

import argparse
from typing import Optional

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import ServerOptions
from robot_health_monitor.runtime.interrupts import Interrupts
from robot_health_monitor.runtime.tokens import TokenFiles

from .arguments import Parser, add_monitoring_options, add_token_file, find_installed, port, robot_name
from .embedded import EmbeddedMonitor, sections_of_nodes
from .exit_codes import ExitCode
from .live_session import choose_output, run_session, served
from .operations import configured_ops, open_operations
from .output.events import Events
from .reloading import Reloads
from .serving import ServerSettings, server_settings


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Runs battery_sensor, aggregator and alert_system in one process, without ROS, and serves them to "
        "rosbridge clients. Shows a live table on a terminal and plain lines in a pipe."
    )
    parser.add_argument(
        "--robot", metavar="NAME", type=robot_name, default="", help="name of the robot (default: the host name)"
    )
    parser.add_argument(
        "--source",
        choices=("simulated", "host", "none"),
        default="",
        help="source of the metrics: simulated, this machine, or none, if clients publish them "
        "(default: as configured)",
    )
    parser.add_argument(
        "--port", type=port, help="port of the rosbridge server; 0 picks a free one (default: as configured, or 9090)"
    )
    parser.add_argument(
        "--host",
        metavar="ADDRESS",
        default="",
        help="address of the rosbridge server (default: as configured, or 127.0.0.1); any other one requires a token",
    )
    add_token_file(parser, "--token-file", "that clients must present")
    parser.add_argument(
        "--origin", action="append", default=[], metavar="URL", help="web page that may connect (repeatable)"
    )
    for verb, noun in (("publish", "publish on topics"), ("call", "call services"), ("offer", "offer services")):
        parser.add_argument(
            f"--allow-{verb}",
            action="append",
            default=[],
            metavar="PATTERN",
            help=f"clients may {noun} that match; * and ? as in file names (repeatable; default: none)",
        )
    add_monitoring_options(parser)


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Runs the monitor until an interrupt, or for `--duration`; then the exit code says if there were alerts."""
    interrupts.take_hangups()
    file = arguments.thresholds or find_installed("config/thresholds.yaml")
    output = choose_output(arguments.json)
    thresholds = read_yaml(file) if file else None
    parameters = {} if thresholds is None else sections_of_nodes(thresholds)["alert_system"].tree
    ops_file = arguments.ops or configured_ops(parameters)
    with open_operations(ops_file, always_history=True) as operations:
        events = Events(output.put, Severity[arguments.log_level], silence_of=operations.silence_text)
        monitor = EmbeddedMonitor(
            thresholds,
            robot=arguments.robot,
            source=arguments.source,
            on_log=events.on_log,
            outlet=events.outlet("alert_system"),
            start_alert_system=operations.start_only,
        )
        tokens = TokenFiles(lambda text: events.on_log(LogLine(monitor.now_s, "rosbridge", Severity.WARN, text)))

        def read_settings(options: Optional[ServerOptions]) -> ServerSettings:
            return server_settings(monitor.alert_system.monitor.config, options, arguments, tokens=tokens)

        try:
            settings = read_settings(operations.config.server)
        except ConfigError:
            monitor.close()
            raise
        reloads = Reloads(monitor.log)
        reloads.add(monitor.reload)
        required = arguments.port is not None
        work = served(monitor, settings, operations, reloads, ops_file, read_settings, required=required)
        alerts_found = run_session(monitor, work, events, output, interrupts, reloads, arguments.duration)
    return ExitCode.ALERTS if alerts_found else ExitCode.SUCCESS
