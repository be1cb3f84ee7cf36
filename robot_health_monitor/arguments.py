"""What `robot-health` understands, and what its --help says."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any, NoReturn, Optional, Sequence

_TOKEN_VARIABLE = "ROBOT_HEALTH_TOKEN"
"""Environment variable for the token, which on the command line everybody on the machine can see."""


def parse(argv: Optional[Sequence[str]] = None) -> argparse.Namespace:
    """Reads the arguments; `command` is the name of the command.

    Args:
        argv: the arguments; None: those of the process.

    Raises:
        SystemExit: they are wrong (code 2, one line on stderr), or asked for help or the version (code 0).
    """
    return _parser().parse_args(argv)


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        """Says in one line what is wrong; argparse itself prints the usage as well."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")


class _ShowVersion(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from .installed_files import version

        sys.stdout.write(f"robot-health {version()}\n")
        parser.exit()


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="robot-health",
        description="Watches the health of a robot: battery, temperature, CPU and any other signal.",
        epilog="Exit codes: 0 fine, 1 there were alerts (with --duration), 2 usage or configuration.",
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    _add_run(commands)
    _add_connect(commands)
    _add_check(commands)
    _add_sources(commands)
    return parser


def _add_run(commands: Any) -> None:
    command = commands.add_parser(
        "run",
        help="monitor in this one process, without ROS",
        description="Runs battery_sensor, aggregator and alert_system in this one process, without ROS. "
        "A terminal shows a live table, a pipe plain lines.",
    )
    command.add_argument("--robot", metavar="NAME", default="", help="the robot's name (default: this host's)")
    command.add_argument(
        "--source",
        choices=("simulated", "host"),
        default="",
        help="where the metrics come from (default: as configured)",
    )
    command.add_argument(
        "--port", type=_port, help="port of the rosbridge server (default: 9090 if it is free; 0: a free one)"
    )
    command.add_argument("--host", default="127.0.0.1", help="its address; others than 127.0.0.1 need a token")
    command.add_argument(
        "--token", default=_token(), help=f"what its clients have to show (default: ${_TOKEN_VARIABLE})"
    )
    command.add_argument(
        "--origin", action="append", default=[], metavar="URL", help="web page that may connect to it (may be repeated)"
    )
    _add_what_all_monitors_take(command)


def _add_connect(commands: Any) -> None:
    command = commands.add_parser(
        "connect",
        help="monitor robots over rosbridge, without ROS",
        description="Watches robots through their rosbridge servers. Each has a link that comes back by itself; "
        "while it is down, that is one alert and the robot's signals keep quiet. Nothing is published on the robots.",
    )
    command.add_argument(
        "urls", metavar="URL", nargs="+", help="ws://host:port, wss://host:port, or NAME=ws://... to call the robot so"
    )
    command.add_argument("--namespace", metavar="NAME", default="", help="namespace of the robots' topics")
    command.add_argument("--token", default=_token(), help=f"shown to the servers (default: ${_TOKEN_VARIABLE})")
    command.add_argument("--ca", metavar="FILE", help="trust the certificate authorities in FILE, for wss://")
    _add_what_all_monitors_take(command)


def _add_what_all_monitors_take(command: argparse.ArgumentParser) -> None:
    command.add_argument("--thresholds", metavar="FILE", help="configuration (default: the one that is installed)")
    command.add_argument(
        "--duration",
        metavar="SECONDS",
        type=_positive_seconds,
        help="end after this time, with exit code 1 if there were alerts",
    )
    command.add_argument("--json", action="store_true", help="one JSON object per alert on stdout, the log on stderr")
    command.add_argument(
        "--log-level",
        choices=("DEBUG", "INFO", "WARN", "ERROR", "FATAL"),
        default="INFO",
        help="least severe log lines to show; alerts are always shown (default: INFO)",
    )


def _add_check(commands: Any) -> None:
    command = commands.add_parser(
        "check",
        help="say whether a thresholds.yaml is right, without starting anything",
        description="Reads configuration files as the nodes would, and says what is wrong with the first wrong key.",
    )
    command.add_argument("files", metavar="FILE", nargs="+", help="a thresholds.yaml")


def _add_sources(commands: Any) -> None:
    command = commands.add_parser(
        "sources",
        help="list what this machine can measure of itself, with the values it has now",
        description="Lists every source that battery_sensor can publish in its section `host`: what to configure, the "
        "value now, and what is missing. A terminal shows a table, a pipe plain lines.",
    )
    command.add_argument("--json", action="store_true", help="one JSON object per source")


def _token() -> str:
    return os.environ.get(_TOKEN_VARIABLE, "")


def _port(text: str) -> int:
    if not text.isdigit() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"found {text!r}, allowed is a whole number from 0 to 65535")
    return int(text)


def _positive_seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < 1e9:
        raise argparse.ArgumentTypeError(f"found {text!r}, allowed is a number of seconds above 0")
    return seconds
