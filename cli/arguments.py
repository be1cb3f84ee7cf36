"""The commands of `robot-health`, its help, and what the arguments of several commands share.

A command is a module `<name>_command.py` with two functions:

    def add_arguments(parser: Parser) -> None: ...      # the description, arguments and options
    def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int: ...      # returns the exit code

It is imported when it is used, and imports libraries that may be missing only in `run`.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import textwrap
from pathlib import Path
from typing import Any, Callable, Mapping, NoReturn, Optional, Sequence, Tuple

from ..runtime.tokens import TOKEN_VARIABLE
from .exit_codes import ExitCode, exit_codes_text

_GROUPS: Mapping[str, Mapping[str, str]] = {
    "Set up": {
        "init": "write a first thresholds.yaml from a live robot",
        "sources": "list the metrics available on this machine",
        "check": "check configuration files, without starting anything",
    },
    "Watch": {
        "run": "monitor this machine or a simulated robot, without ROS",
        "connect": "monitor robots over rosbridge, without ROS",
    },
    "Tune": {
        "replay": "show the alerts that recordings would have raised",
        "suggest": "write thresholds from recordings of healthy robots",
        "test": "run unit tests of a thresholds.yaml",
    },
    "Operate": {
        "history": "show past alerts, from a history file",
        "note": "write a note on a past alert",
        "silence": "suppress notifications, for a time or until an alert resolves",
        "notify": "send a test notification to every target of an ops.yaml",
        "export": "write files for Prometheus, Grafana, a fleet or SROS2",
    },
}
"""Each command with its line in `robot-health --help`, by what users do with it."""
COMMANDS: Mapping[str, str] = {name: line for group in _GROUPS.values() for name, line in group.items()}
"""Each command with its line in `robot-health --help`."""

_FOLDER = Path(__file__).resolve().parent
"""Resolved, because `--symlink-install` and a catkin devel space link to the source tree."""

_HELP_COLUMNS = 79
INTERRUPTED = "interrupted before the end of the recordings"


class Parser(argparse.ArgumentParser):
    """Reports errors in one line."""

    def __init__(self, **options: Any) -> None:
        """Creates a parser without abbreviated options: they would change their meaning when one is added."""
        super().__init__(allow_abbrev=False, **options)
        self.check: Callable[[argparse.Namespace], str] = lambda arguments: ""
        """Returns what is wrong with the arguments together, an empty text if nothing is."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parses arguments; unknown ones are an error of the command, not of `robot-health`."""
        arguments, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        problem = self.check(arguments)
        if problem:
            self.error(problem)
        return arguments, unknown

    def error(self, message: str) -> NoReturn:
        """Reports an error in one line; argparse itself prints the usage as well."""
        self.exit(ExitCode.USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")

    def exit(self, status: int = 0, message: Optional[str] = None) -> NoReturn:
        """Ends the process; arguments may hold control characters."""
        if message:
            from ..core.values.formatting import printable

            message = printable(message[:-1]) + "\n"
        super().exit(status, message)
        raise SystemExit(status)


class ShowVersion(argparse.Action):
    """Prints the version of the package, and ends the process."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """Prints the version."""
        from ..core.values.version import package_version

        sys.stdout.write(f"robot-health {package_version()}\n")
        parser.exit()
        raise SystemExit(0)


class _RejectToken(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        parser.error(
            f"--token is not supported: every user of this machine can read arguments; use {self.const} or "
            f"{TOKEN_VARIABLE}"
        )


def parse(argv: Optional[Sequence[str]] = None) -> argparse.Namespace:
    """Parses arguments, by default those of the process; `command` is the name of the command, `run` its function.

    Raises:
        SystemExit: they are wrong (code 2, one line on stderr), or requested help or the version (code 0). No argument
            at all requests help.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    return _parser()[0].parse_args(words or ["--help"])


def complete_parser() -> argparse.ArgumentParser:
    """Returns the parser with the arguments of every command, for completion in a shell: shtab reads it."""
    parser, commands = _parser()
    commands.help = "command"
    for name, command in commands.choices.items():
        command.add_arguments()
        command.description = COMMANDS[name]
        for action in command._actions:
            if action.metavar in ("BAG", "FILE", "FOLDER", "PATH", "RECORDING"):
                vars(action)["complete"] = {"bash": "_shtab_compgen_files", "zsh": "_files"}  # as shtab.FILE
    return parser


def _parser() -> Tuple[Parser, Any]:
    """Returns the parser, and argparse's action with those of the commands."""
    parser = Parser(
        prog="robot-health",
        usage="robot-health [-h] [--version] COMMAND ...",
        description="Monitors the health of robots: battery, temperature, CPU and any other signal.\n\n"
        + _groups_text(),
        epilog=textwrap.fill(exit_codes_text(), _HELP_COLUMNS),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action=ShowVersion, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(
        prog="robot-health",
        dest="command",
        metavar="COMMAND",
        required=True,
        help=argparse.SUPPRESS,
        parser_class=_CommandParser,
    )
    for name, line in COMMANDS.items():
        commands.add_parser(name, command=name, help=line, epilog=exit_codes_text(name))
    return parser, commands


def _groups_text() -> str:
    """Returns the commands, in groups; `robot-health COMMAND --help` describes each."""
    groups = (
        [f"{title}:", *(f"  {name:<9}{line}" for name, line in group.items())] for title, group in _GROUPS.items()
    )
    return "\n\n".join("\n".join(lines) for lines in groups)


class _CommandParser(Parser):
    """The parser of one command, which gets its arguments from the command's module once it is used."""

    def __init__(self, command: str, **options: Any) -> None:
        super().__init__(**options)
        self._command = command

    def add_arguments(self) -> None:
        """Adds the arguments, once."""
        if self._command:
            module = importlib.import_module(f".commands.{self._command}_command", __package__)
            module.add_arguments(self)
            self.set_defaults(run=module.run)
            self._command = ""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        self.add_arguments()
        return super().parse_known_args(args, namespace)


def add_monitoring_options(parser: argparse.ArgumentParser) -> None:
    """Adds the options of commands that monitor live: the configuration, the duration, the output."""
    parser.add_argument("--thresholds", metavar="FILE", help="configuration (default: the installed one)")
    parser.add_argument(
        "--ops", metavar="FILE", default="", help="an ops.yaml: history, notifications, server (default: none)"
    )
    parser.add_argument(
        "--duration", metavar="SECONDS", type=seconds, help="end after this time, with code 1 if there were alerts"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per alert on stdout, the log on stderr")
    parser.add_argument(
        "--log-level",
        choices=("DEBUG", "INFO", "WARN", "ERROR", "FATAL"),
        type=str.upper,
        default="INFO",
        help="hide less severe log lines; alerts are always shown (default: INFO)",
    )


def add_token_file(parser: argparse.ArgumentParser, option: str, meaning: str) -> None:
    """Adds the option for a file with a token; a token as an argument is an error."""
    parser.add_argument(
        option,
        metavar="FILE",
        default="",
        help=f"file with the token {meaning} (default: the variable {TOKEN_VARIABLE})",
    )
    parser.add_argument("--token", action=_RejectToken, const=option, nargs="?", help=argparse.SUPPRESS)


def add_namespace(parser: argparse.ArgumentParser, meaning: str) -> None:
    """Adds the option for a namespace of topics."""
    parser.add_argument("--namespace", metavar="NAME", type=namespace, default="", help=meaning)


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of commands that read recordings."""
    parser.add_argument("recordings", metavar="BAG", nargs="+", help="a recording")
    add_namespace(parser, "namespace of the recorded topics")


def namespace(text: str) -> str:
    """Accepts a namespace."""
    from ..core.values.names import is_namespace

    if not is_namespace(text):
        raise argparse.ArgumentTypeError(f"expected a namespace such as carter or fleet/carter, got {text!r}")
    return text


def duration(text: str) -> float:
    """Returns a duration in s: `90s`, `1h30m`, `7d`."""
    from ..core.values.errors import ConfigError
    from ..ops.store.silences import parse_duration_s

    try:
        return parse_duration_s(text)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def robot_name(text: str) -> str:
    """Accepts the name of a robot."""
    if not text.isprintable():
        raise argparse.ArgumentTypeError(f"expected printable text, got {text!r}")
    return text


def port(text: str) -> int:
    """Returns the number of a port; 0 is one too."""
    if not (text.isascii() and text.isdigit()) or len(text) > 5 or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 to 65535, got {text!r}")
    return int(text)


def identifier(text: str, meaning: str) -> int:
    """Returns the number of a row in a history file."""
    if not (text.isascii() and text.isdigit()) or len(text) > 18:
        raise argparse.ArgumentTypeError(f"expected {meaning}, got {text!r}")
    return int(text)


def alert_id(text: str) -> int:
    """Returns the number of an alert in a history: `41` or `#41`."""
    return identifier(text[text.startswith("#") :], "the number of an alert")


def seconds(text: str) -> float:
    """Returns a number of seconds above 0."""
    number = number_or_nan(text)
    if not 0.0 < number < 1e9:
        raise argparse.ArgumentTypeError(f"expected a number of seconds above 0, got {text!r}")
    return number


def number_or_nan(text: str) -> float:
    """Returns a number, or NaN for a text that is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def find_installed(name: str) -> Optional[Path]:
    """Returns the path of `config/thresholds.yaml` or another installed file, None if it is not installed.

    The source tree has it beside the package; pip, colcon and catkin install it in
    `<prefix>/share/robot_health_monitor`.
    """
    places = [_FOLDER.parent, *(above / "share" / "robot_health_monitor" for above in _FOLDER.parents)]
    return next((place / name for place in places if (place / name).is_file()), None)
