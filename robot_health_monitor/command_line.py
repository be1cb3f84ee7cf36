"""The commands of `robot-health`, and its help.

A command is a module `<name>_command.py` with two functions:

    def add_arguments(parser: Parser) -> None: ...      # the description, arguments and options
    def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int: ...      # returns the exit code

It is imported when it is used, and imports libraries that may be missing only in `run`.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from typing import Any, Optional, Sequence

from .arguments import Parser, ShowVersion
from .exit_codes import exit_codes_text

COMMANDS = {
    "run": "monitor this machine or a simulated robot, without ROS",
    "connect": "monitor robots over rosbridge, without ROS",
    "check": "check configuration files, without starting anything",
    "sources": "list the metrics available on this machine",
    "replay": "show the alerts that recordings would have raised",
    "suggest": "write thresholds from recordings of healthy robots",
    "test": "run unit tests of a thresholds.yaml",
    "notify": "send a test notification to every target of an ops.yaml",
    "export": "write alerting rules for Prometheus or a dashboard for Grafana",
    "history": "show past alerts, from a history file",
    "silence": "suppress notifications, for a time or until an alert resolves",
}
"""Each command with its line in `robot-health --help`."""


def parse(argv: Optional[Sequence[str]] = None) -> argparse.Namespace:
    """Parses the arguments; `command` is the name of the command, `run` its function.

    Args:
        argv: the arguments; None: those of the process.

    Raises:
        SystemExit: they are wrong (code 2, one line on stderr), or requested help or the version (code 0). No argument
            at all requests help.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    parser = Parser(
        prog="robot-health",
        description="Monitors the health of robots: battery, temperature, CPU and any other signal.",
        epilog=exit_codes_text(),
    )
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_CommandParser)
    for name, summary in COMMANDS.items():
        commands.add_parser(name, help=summary, command=name, epilog=exit_codes_text(name))
    return parser.parse_args(words or ["--help"])


class _CommandParser(Parser):
    """The parser of one command, which gets its arguments from the command's module once it is used."""

    def __init__(self, command: str, **options: Any) -> None:
        super().__init__(**options)
        self._command = command

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._command:
            module = importlib.import_module(f".{self._command}_command", __package__)
            module.add_arguments(self)
            self.set_defaults(run=module.run)
            self._command = ""
        return super().parse_known_args(args, namespace)
