"""The commands of `robot-health`, its help, and what the arguments of several commands share.

A command is a module `<name>_command.py` with two functions:

    def add_arguments(parser: Parser) -> None: ...      # the description, arguments and options
    def run(arguments: argparse.Namespace, interrupts: Interrupts) -> Optional[int]: ...      # exit code; None means 0

It is imported when it is used, and imports libraries that may be missing only in `run`.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import textwrap
from pathlib import Path
from typing import Any, Callable, Collection, Mapping, NoReturn, Sequence

from ..core.values import is_namespace, package_version
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
        "connect": "monitor robots over rosbridge or foxglove_bridge, without ROS",
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

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        """Ends the process; arguments may hold control characters."""
        if message:
            from ..core.values.formatting import printable

            message = printable(message[:-1]) + "\n"
        super().exit(status, message)
        raise SystemExit(status)


class _RejectToken(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        parser.error(
            f"--token is not supported: every user of this machine can read arguments; use {self.const} or "
            f"{TOKEN_VARIABLE}"
        )


def parse(argv: Sequence[str] | None = None) -> argparse.Namespace:
    """Parses arguments, by default those of the process; `command` is the name of the command, `run` its function.

    Raises:
        SystemExit: they are wrong (code 2, one line on stderr), or requested help or the version (code 0). No argument
            at all requests help.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    return _parser(words)[0].parse_args(words or ["--help"])


def complete_parser() -> argparse.ArgumentParser:
    """Returns the parser with the arguments of every command, for completion in a shell: shtab reads it."""
    parser, commands = _parser(COMMANDS)
    commands.help = "command"
    for name, command in commands.choices.items():
        command.description = COMMANDS[name]
        for action in command._actions:
            if action.metavar in ("BAG", "FILE", "FOLDER", "PATH", "RECORDING"):
                vars(action)["complete"] = {"bash": "_shtab_compgen_files", "zsh": "_files"}  # as shtab.FILE
    return parser


def _parser(used: Collection[str]) -> tuple[Parser, Any]:
    """Returns the parser, and argparse's action with those of the commands; only the `used` ones have arguments."""
    parser = Parser(
        prog="robot-health",
        usage="robot-health [-h] [--version] COMMAND ...",
        description="Monitors the health of robots: battery, temperature, CPU and any other signal.\n\n"
        + _groups_text(),
        epilog=textwrap.fill(exit_codes_text(), _HELP_COLUMNS),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    version = f"robot-health {package_version()}"
    add(parser, "--version", "show the version and exit", action="version", version=version)
    commands = parser.add_subparsers(
        prog="robot-health",
        dest="command",
        metavar="COMMAND",
        required=True,
        help=argparse.SUPPRESS,
        parser_class=Parser,
    )
    for name, line in COMMANDS.items():
        command = commands.add_parser(name, help=line, epilog=exit_codes_text(name))
        if name in used:
            module = importlib.import_module(f".commands.{name}_command", __package__)
            module.add_arguments(command)
            command.set_defaults(run=module.run)
    return parser, commands


def _groups_text() -> str:
    """Returns the commands, in groups; `robot-health COMMAND --help` describes each."""
    groups = (
        [f"{title}:", *(f"  {name:<9}{line}" for name, line in group.items())] for title, group in _GROUPS.items()
    )
    return "\n\n".join("\n".join(lines) for lines in groups)


def add(parser: Any, usage: str, meaning: str, **details: Any) -> None:
    """Adds an argument by its usage: `--json`, `--ops FILE`, `--origin URL...` (repeatable), `[FILE]`, `BAG...`.

    `details` are further ones of argparse; the `dest` of an argument without an option is its usage in lower case.
    """
    name, _, value = usage.partition(" ")
    shown = (value or name).strip("[].")
    if not name.startswith("--"):
        name = details.pop("dest", shown.lower())
        details.update(metavar=shown, nargs=_COUNTS[usage.replace(shown, "")])
    elif value:
        details["metavar"] = shown
        if value != shown:
            details.update(action="append", default=[])
    elif not details:
        details["action"] = "store_true"
    parser.add_argument(name, help=meaning, **details)


_COUNTS = {"": None, "[]": "?", "...": "+", "[]...": "*"}


def add_monitoring_options(parser: Parser) -> None:
    """Adds the options of commands that monitor live: the configuration, the duration, the output."""
    add(parser, "--thresholds FILE", "configuration (default: the installed one)")
    add(parser, "--ops FILE", "an ops.yaml: history, notifications, server (default: none)", default="")
    add(parser, "--duration SECONDS", "end after this time, with code 1 if there were alerts", type=seconds)
    add(parser, "--json", "one JSON object per alert on stdout, the log on stderr")
    levels = ("DEBUG", "INFO", "WARN", "ERROR", "FATAL")
    meaning = "hide less severe log lines; alerts are always shown (default: INFO)"
    add(parser, "--log-level", meaning, choices=levels, type=str.upper, default="INFO")


def add_token_file(parser: Parser, option: str, meaning: str) -> None:
    """Adds the option for a file with a token; a token as an argument is an error."""
    add(parser, f"{option} FILE", f"file with the token {meaning} (default: the variable {TOKEN_VARIABLE})", default="")
    add(parser, "--token", argparse.SUPPRESS, action=_RejectToken, const=option, nargs="?")


def add_robot_server(parser: Parser, of_robots: str) -> None:
    """Adds the options of commands that connect to the servers `of_robots`: namespace, token, certificates."""
    add_namespace(parser, f"namespace of the {of_robots} topics")
    server = "servers" if of_robots.endswith("s'") else "server"
    add_token_file(parser, "--robot-token-file", f"to present to the {of_robots} {server}")
    add(parser, "--ca FILE", "certificate authorities to trust, for wss:// and foxglove+tls://", default="")


def add_namespace(parser: Parser, meaning: str) -> None:
    """Adds the option for a namespace of topics."""
    add(parser, "--namespace NAME", meaning, type=namespace, default="")


def add_recordings(parser: Parser) -> None:
    """Adds the arguments of commands that read recordings."""
    add(parser, "BAG...", "a recording", dest="recordings")
    add_namespace(parser, "namespace of the recorded topics")


def checked(
    expected: str, read: Callable[[str], Any], is_valid: Callable[[Any], object] = lambda value: True
) -> Callable[[str], Any]:
    """Returns the type of an argument: `read` makes its value of a text. A text that has none is an error."""

    def read_argument(text: str) -> Any:
        try:
            value = read(text)
            if is_valid(value):
                return value
        except (LookupError, ValueError, OverflowError, OSError):
            pass
        raise argparse.ArgumentTypeError(f"expected {expected}, got {text!r}")

    return read_argument


def whole_number(text: str) -> int:
    """Returns a whole number of at most 18 digits; raises ValueError for another text."""
    if not (text.isascii() and text.isdigit()) or len(text) > 18:
        raise ValueError(text)
    return int(text)


def identifier(meaning: str) -> Callable[[str], Any]:
    """Returns the type of an argument that is the number of a row in a history file, also `#41`."""
    return checked(meaning, lambda text: whole_number(text[text.startswith("#") :]))


namespace = checked("a namespace such as carter or fleet/carter", str, is_namespace)
robot_name = checked("printable text", str, str.isprintable)
port = checked("a whole number from 0 to 65535", whole_number, lambda number: number <= 65_535)
alert_id = identifier("the number of an alert")
seconds = checked("a number of seconds above 0", float, lambda number: 0.0 < number < 1e9)


def _duration_s(text: str) -> float:
    from ..ops.store.silences import parse_duration_s

    return parse_duration_s(text)


duration = checked("a duration such as 30m, 1h30m or 7d", _duration_s)
"""In s."""


def find_installed(name: str) -> Path | None:
    """Returns the path of `config/thresholds.yaml` or another installed file, None if it is not installed.

    The source tree has it beside the package; pip, colcon and catkin install it in
    `<prefix>/share/robot_health_monitor`.
    """
    places = [_FOLDER.parent, *(above / "share" / "robot_health_monitor" for above in _FOLDER.parents)]
    return next((place / name for place in places if (place / name).is_file()), None)
