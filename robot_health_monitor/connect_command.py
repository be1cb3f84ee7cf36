"""`robot-health connect`: watches robots over rosbridge, without ROS on this machine."""

from __future__ import annotations

import argparse
import gc
import time
from functools import partial
from typing import TYPE_CHECKING, Optional, Sequence

from robot_health_monitor.core.local import LogLine
from robot_health_monitor.core.middleware import Severity
from robot_health_monitor.ops.configuration import ServerOptions
from robot_health_monitor.runtime.interrupts import Interrupts
from robot_health_monitor.runtime.libraries import ROSBRIDGE, libraries
from robot_health_monitor.runtime.tokens import TokenFiles

from .arguments import Parser, add_monitoring_options, add_namespace, add_token_file, find_installed, port
from .exit_codes import ExitCode
from .fleet_configuration import FleetReader, Options, read_addresses
from .live_session import choose_output, run_session, served
from .operations import Operations, open_operations
from .output.events import Events
from .reloading import Reloads
from .serving import ServerSettings, settings_of

if TYPE_CHECKING:
    from .fleet import Fleet, Robot


_GC_THRESHOLD = 20_000, 20, 10
"""With a thousand robots, a garbage collection of all objects takes up to a second. Python's defaults cause many."""


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Monitors robots through their rosbridge servers. A link that is down is one alert, and is "
        "re-established automatically. Meanwhile the robot's signals raise no alerts. Nothing is published on the "
        "robots. SIGHUP reads the configuration, ops.yaml and the tokens again and changes only what differs."
    )
    parser.add_argument(
        "urls",
        metavar="URL",
        nargs="*",
        help="host:port, ws://host:port, wss://host:port, or NAME=host:port to name the robot",
    )
    parser.add_argument(
        "--fleet",
        metavar="FILE",
        default="",
        help="a fleet.yaml with further robots; --thresholds, --namespace, --robot-token-file and --ca apply where "
        "it names none",
    )
    add_namespace(parser, "namespace of the robots' topics")
    add_token_file(parser, "--robot-token-file", "to present to the robots' servers")
    parser.add_argument("--token-file", dest="old_token_file", metavar="FILE", default="", help=argparse.SUPPRESS)
    parser.add_argument("--ca", metavar="FILE", default="", help="certificate authorities to trust, for wss://")
    parser.add_argument(
        "--port",
        type=port,
        help="serve alerts and /diagnostics of all robots to rosbridge clients on this port; 0 picks a free one "
        "(default: no server)",
    )
    parser.add_argument("--host", metavar="ADDRESS", default="", help="address of that server (default: 127.0.0.1)")
    add_monitoring_options(parser)
    parser.check = _check


def _check(arguments: argparse.Namespace) -> str:
    if arguments.robot_token_file and arguments.old_token_file:
        return "argument --token-file: not allowed with argument --robot-token-file"
    return "" if arguments.urls or arguments.fleet else "expected the URL of a robot, or --fleet FILE"


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Watches robots until an interrupt, or for `--duration`; then the exit code says if there were alerts.

    ConfigError: an address or a file cannot be used; or, at the end of the duration, a robot refuses this client.
    """
    interrupts.take_hangups()
    gc.set_threshold(*_GC_THRESHOLD)
    with libraries(*ROSBRIDGE):
        from .fleet import Fleet

    addresses = read_addresses(arguments.urls)
    output = choose_output(arguments.json, name_robots=len(addresses) > 1 or bool(arguments.fleet))
    options = Options(
        thresholds=str(arguments.thresholds or find_installed("config/thresholds.yaml") or ""),
        namespace=arguments.namespace,
        token_file=arguments.robot_token_file or arguments.old_token_file,
        ca=arguments.ca,
    )
    with open_operations(arguments.ops, always_history=True) as operations:
        events = Events(output.put, Severity[arguments.log_level], silence_of=operations.silence_text)

        def warn(text: str) -> None:
            events.on_log(LogLine(time.monotonic(), "connect", Severity.WARN, text))

        if arguments.old_token_file:
            warn("--token-file is deprecated for the robots' token: use --robot-token-file")
        read_settings = partial(_server_settings, arguments, TokenFiles(warn))
        settings = read_settings(operations.config.server)
        fleet = Fleet(
            FleetReader(addresses, arguments.fleet, options, warn),
            clock=time.monotonic,
            on_log=events.on_log,
            outlet=events.outlet,
            start=operations.start,
            self_report=operations.self_report(),
        )
        _attach(operations, fleet)
        reloads = Reloads(fleet.log)
        reloads.add(fleet.reload)
        required = arguments.port is not None
        work = served(fleet, settings, operations, reloads, arguments.ops, read_settings, required=required)
        alerts_found = run_session(fleet, work, events, output, interrupts, reloads, arguments.duration)
    if arguments.duration is not None and not interrupts.came:
        fleet.check_own_faults()
    return ExitCode.ALERTS if alerts_found else ExitCode.SUCCESS


def _server_settings(
    arguments: argparse.Namespace, tokens: TokenFiles, options: Optional[ServerOptions]
) -> Optional[ServerSettings]:
    """Returns the settings of the server for the whole fleet, the command line first; None: not requested.

    The robots' token is never the one that this server requires: that comes from the ops.yaml alone.
    """
    if arguments.port is None and options is None:
        return None
    token = tokens.find_own(options.token_file) if options and options.token_file else ""
    return settings_of(options, token, port=arguments.port, address=arguments.host)


def _attach(operations: Operations, fleet: Fleet) -> None:
    """Ends the operations of robots that are removed, and shows their faults in the status of the process."""

    def end_removed(added: Sequence[Robot], ended: Sequence[Robot]) -> None:
        for robot in {each.name for each in ended} - {each.name for each in added}:
            operations.end_robot(robot)
        operations.note_robots()

    fleet.on_change.append(end_removed)
    operations.faults.add(fleet.faults)
    operations.log_summary(fleet.log)
    operations.note_robots()
