"""`robot-health run`: the monitor in this process, without ROS."""

from __future__ import annotations

import argparse

from ...core.config import read_yaml
from ...core.port import Severity
from ...ops.configuration import ServerOptions
from ...runtime.interrupts import Interrupts
from ..arguments import Parser, add, add_monitoring_options, add_token_file, find_installed, port, robot_name
from ..embedded import EmbeddedMonitor, sections_of_nodes
from ..monitor_process import MonitorProcess, choose_output
from ..operations import configured_ops


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Runs battery_sensor, aggregator and alert_system in one process, without ROS, and serves them to "
        "rosbridge clients. Shows a live table on a terminal and plain lines in a pipe."
    )
    add(parser, "--robot NAME", "name of the robot (default: the host name)", type=robot_name, default="")
    add(
        parser,
        "--source",
        "source of the metrics: simulated, this machine, or none, if clients publish them (default: as configured)",
        choices=("simulated", "host", "none"),
        default="",
    )
    meaning = "port of the rosbridge server; 0 picks a free one (default: as configured, or 9090)"
    add(parser, "--port", meaning, type=port)
    meaning = "address of the rosbridge server (default: as configured, or 127.0.0.1); any other one requires a token"
    add(parser, "--host ADDRESS", meaning, default="")
    add_token_file(parser, "--token-file", "that clients must present")
    add(parser, "--origin URL...", "web page that may connect (repeatable)")
    for verb, noun in (("publish", "publish on topics"), ("call", "call services"), ("offer", "offer services")):
        meaning = f"clients may {noun} that match; * and ? as in file names (repeatable; default: none)"
        add(parser, f"--allow-{verb} PATTERN...", meaning)
    add_monitoring_options(parser)


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Runs the monitor until an interrupt, or for `--duration`; then the exit code says if there were alerts."""
    interrupts.take_hangups()
    file = arguments.thresholds or find_installed("config/thresholds.yaml")
    output = choose_output(arguments.json)
    thresholds = read_yaml(file) if file else None
    parameters = {} if thresholds is None else sections_of_nodes(thresholds)["alert_system"].tree
    options = ServerOptions(
        arguments.port,
        arguments.host,
        arguments.token_file,
        allow_publish=tuple(arguments.allow_publish),
        allow_call=tuple(arguments.allow_call),
        allow_offer=tuple(arguments.allow_offer),
    )
    with MonitorProcess(
        output,
        interrupts,
        ops_file=arguments.ops or configured_ops(parameters),
        name="rosbridge",
        least=Severity[arguments.log_level],
        server=options,
        origins=arguments.origin,
    ) as process:
        monitor = EmbeddedMonitor(
            thresholds,
            robot=arguments.robot,
            source=arguments.source,
            on_log=process.events.on_log,
            outlet=process.events.outlet("alert_system"),
            start_alert_system=process.operations.start_only,
        )

        return process.run(monitor, arguments.duration)
