"""`robot-health connect`: watches robots over their bridges, without ROS on this machine."""

from __future__ import annotations

import argparse
import gc
import time
from functools import partial

from ...core.port import Severity
from ...ops.configuration import ServerOptions
from ...runtime.interrupts import Interrupts
from ...runtime.libraries import ROSBRIDGE, libraries
from ..arguments import Parser, add, add_monitoring_options, add_robot_server, find_installed, port
from ..fleet_configuration import Options, read_addresses, read_robots
from ..monitor_process import MonitorProcess, choose_output

_GC_THRESHOLD = 20_000, 20, 10
"""With a thousand robots, a garbage collection of all objects takes up to a second. Python's defaults cause many."""


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Monitors robots through their rosbridge servers or foxglove_bridges. A link that is down is one alert, and is "
        "re-established automatically. Meanwhile the robot's signals raise no alerts. Nothing is published on the "
        "robots. SIGHUP reads the configuration, ops.yaml and the tokens again and changes only what differs."
    )
    add(
        parser,
        "[URL]...",
        "host:port or ws://host:port (rosbridge), wss://host:port, foxglove://host:port, foxglove+tls://host:port; "
        "NAME=ADDRESS names the robot",
        dest="urls",
    )
    add(
        parser,
        "--fleet FILE",
        "a fleet.yaml with further robots; --thresholds, --namespace, --robot-token-file and --ca apply where it names "
        "none",
        default="",
    )
    add_robot_server(parser, "robots'")
    add(
        parser,
        "--port",
        "serve alerts and /diagnostics of all robots to rosbridge clients on this port; 0 picks a free one "
        "(default: no server)",
        type=port,
    )
    add(parser, "--host ADDRESS", "address of that server (default: 127.0.0.1)", default="")
    add_monitoring_options(parser)
    parser.check = _check


def _check(arguments: argparse.Namespace) -> str:
    return "" if arguments.urls or arguments.fleet else "expected the URL of a robot, or --fleet FILE"


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Watches robots until an interrupt, or for `--duration`; then the exit code says if there were alerts.

    Raises ConfigError if an address or a file cannot be used, or if a robot refuses this client at the end of the
    duration.
    """
    interrupts.take_hangups()
    gc.set_threshold(*_GC_THRESHOLD)
    with libraries(*ROSBRIDGE):
        from ..fleet import Fleet

    addresses = read_addresses(arguments.urls)
    output = choose_output(arguments.json, name_robots=len(addresses) > 1 or bool(arguments.fleet))
    options = Options(
        thresholds=str(arguments.thresholds or find_installed("config/thresholds.yaml") or ""),
        namespace=arguments.namespace,
        token_file=arguments.robot_token_file,
        ca=arguments.ca,
    )
    with MonitorProcess(
        output,
        interrupts,
        ops_file=arguments.ops,
        name="connect",
        least=Severity[arguments.log_level],
        server=ServerOptions(arguments.port, arguments.host),
        serves=arguments.port is not None,
    ) as process:
        read = partial(read_robots, addresses, arguments.fleet, options, process.tokens)
        events = process.events
        fleet = Fleet(read, process.operations, clock=time.monotonic, on_log=events.on_log, outlet=events.outlet)
        code = process.run(fleet, arguments.duration)
    if arguments.duration is not None and not interrupts.came:
        fleet.check_own_faults()
    return code
