"""The arguments of `robot-health`, and its help."""

from __future__ import annotations

import argparse
import math
import re
import sys
import time
from datetime import datetime
from typing import Any, Callable, NoReturn, Optional, Sequence

from robot_health_monitor.runtime.tokens import TOKEN_VARIABLE

_UNITS_S = {"s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0, "d": 86_400.0, "w": 604_800.0}


def parse(argv: Optional[Sequence[str]] = None) -> argparse.Namespace:
    """Parses the arguments; `command` is the name of the command.

    Args:
        argv: the arguments; None: those of the process.

    Raises:
        SystemExit: they are wrong (code 2, one line on stderr), or requested help or the version (code 0). No argument
            at all requests help.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    return _parser().parse_args(words or ["--help"])


class _Parser(argparse.ArgumentParser):
    def __init__(self, **options: Any) -> None:
        # Abbreviated options would change their meaning when another option is added.
        super().__init__(allow_abbrev=False, **options)
        self.check: Callable[[argparse.Namespace], str] = _accept
        """Returns what is wrong with the arguments together; empty: nothing."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parses arguments; unknown ones are an error of the command, not of `robot-health`."""
        found, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        problem = self.check(found)
        if problem:
            self.error(problem)
        return found, unknown

    def error(self, message: str) -> NoReturn:
        """Reports an error in one line; argparse itself prints the usage as well."""
        self.exit(2, f"{self.prog}: {message}; see {self.prog} --help\n")

    def exit(self, status: int = 0, message: Optional[str] = None) -> NoReturn:
        """Ends the process; arguments may hold control characters."""
        if message:
            from robot_health_monitor.core.formatting import printable

            message = printable(message[:-1]) + "\n"
        super().exit(status, message)
        raise SystemExit(status)


class _ShowVersion(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from robot_health_monitor.core.version import package_version

        sys.stdout.write(f"robot-health {package_version()}\n")
        parser.exit()
        raise SystemExit(0)


class _RejectToken(argparse.Action):
    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        parser.error(
            f"--token is not supported: every user of this machine can read arguments; use {self.const} or "
            f"{TOKEN_VARIABLE}"
        )


def _accept(arguments: argparse.Namespace) -> str:
    return ""


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="robot-health",
        description="Monitors the health of robots: battery, temperature, CPU and any other signal.",
        epilog="Exit codes: 0 success, 1 alerts were found (replay, --duration), 2 usage or configuration error, "
        "3 the command itself failed.",
    )
    parser.add_argument("--version", action=_ShowVersion, nargs=0, help="show the version and exit")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True, parser_class=_Parser)
    _add_run(commands)
    _add_connect(commands)
    _add_check(commands)
    _add_sources(commands)
    _add_replay(commands)
    _add_suggest(commands)
    _add_test(commands)
    _add_notify(commands)
    _add_export(commands)
    _add_history(commands)
    _add_silence(commands)
    return parser


def _add_run(commands: Any) -> None:
    command = commands.add_parser(
        "run",
        help="monitor this machine or a simulated robot, without ROS",
        description="Runs battery_sensor, aggregator and alert_system in one process, without ROS, and serves them to "
        "rosbridge clients. Shows a live table on a terminal and plain lines in a pipe.",
    )
    command.add_argument("--robot", metavar="NAME", default="", help="name of the robot (default: the host name)")
    command.add_argument(
        "--source",
        choices=("simulated", "host", "none"),
        default="",
        help="source of the metrics: simulated, this machine, or none, if clients publish them "
        "(default: as configured)",
    )
    command.add_argument(
        "--port", type=_port, help="port of the rosbridge server; 0 picks a free one (default: as configured, or 9090)"
    )
    command.add_argument(
        "--host",
        metavar="ADDRESS",
        default="",
        help="address of the rosbridge server (default: as configured, or 127.0.0.1); any other one requires a token",
    )
    command.add_argument("--token-file", metavar="FILE", default="", help=_token_help("that clients must present"))
    _reject_token(command, "--token-file")
    command.add_argument(
        "--origin", action="append", default=[], metavar="URL", help="web page that may connect (repeatable)"
    )
    for verb, noun in (("publish", "publish on topics"), ("call", "call services"), ("offer", "offer services")):
        command.add_argument(
            f"--allow-{verb}",
            action="append",
            default=[],
            metavar="PATTERN",
            help=f"clients may {noun} that match; * and ? as in file names (repeatable; default: none)",
        )
    _add_common(command)


def _add_connect(commands: Any) -> None:
    command = commands.add_parser(
        "connect",
        help="monitor robots over rosbridge, without ROS",
        description="Monitors robots through their rosbridge servers. A link that is down is one alert, and is "
        "re-established automatically; meanwhile the robot's signals raise no alerts. Nothing is published on the "
        "robots. SIGHUP reads the configuration, ops.yaml and the tokens again and changes only what differs.",
    )
    command.add_argument(
        "urls",
        metavar="URL",
        nargs="*",
        help="host:port, ws://host:port, wss://host:port, or NAME=host:port to name the robot",
    )
    command.add_argument(
        "--fleet",
        metavar="FILE",
        default="",
        help="a fleet.yaml with further robots; --thresholds, --namespace, --robot-token-file and --ca apply where "
        "it names none",
    )
    _add_namespace(command, "namespace of the robots' topics")
    command.add_argument(
        "--robot-token-file", metavar="FILE", default="", help=_token_help("to present to the robots' servers")
    )
    command.add_argument("--token-file", dest="old_token_file", metavar="FILE", default="", help=argparse.SUPPRESS)
    _reject_token(command, "--robot-token-file")
    command.add_argument("--ca", metavar="FILE", default="", help="certificate authorities to trust, for wss://")
    command.add_argument(
        "--port",
        type=_port,
        help="serve alerts and /diagnostics of all robots to rosbridge clients on this port; 0 picks a free one "
        "(default: no server)",
    )
    command.add_argument("--host", metavar="ADDRESS", default="", help="address of that server (default: 127.0.0.1)")
    _add_common(command)
    command.check = _check_connect


def _check_connect(arguments: argparse.Namespace) -> str:
    if arguments.robot_token_file and arguments.old_token_file:
        return "argument --token-file: not allowed with argument --robot-token-file"
    return "" if arguments.urls or arguments.fleet else "expected the URL of a robot, or --fleet FILE"


def _token_help(meaning: str) -> str:
    return f"file with the token {meaning} (default: the variable {TOKEN_VARIABLE})"


def _reject_token(command: argparse.ArgumentParser, option: str) -> None:
    command.add_argument("--token", action=_RejectToken, const=option, nargs="?", help=argparse.SUPPRESS)


def _add_namespace(command: argparse.ArgumentParser, meaning: str) -> None:
    command.add_argument("--namespace", metavar="NAME", type=_namespace, default="", help=meaning)


def _add_recordings(command: argparse.ArgumentParser) -> None:
    command.add_argument("recordings", metavar="BAG", nargs="+", help="a recording")
    _add_namespace(command, "namespace of the recorded topics")


def _add_common(command: argparse.ArgumentParser) -> None:
    command.add_argument("--thresholds", metavar="FILE", help="configuration (default: the installed one)")
    command.add_argument(
        "--ops", metavar="FILE", default="", help="an ops.yaml: history, notifications, server (default: none)"
    )
    command.add_argument(
        "--duration", metavar="SECONDS", type=_seconds, help="end after this time, with code 1 if there were alerts"
    )
    command.add_argument("--json", action="store_true", help="one JSON object per alert on stdout, the log on stderr")
    command.add_argument(
        "--log-level",
        choices=("DEBUG", "INFO", "WARN", "ERROR", "FATAL"),
        type=str.upper,
        default="INFO",
        help="hide less severe log lines; alerts are always shown (default: INFO)",
    )


def _add_check(commands: Any) -> None:
    command = commands.add_parser(
        "check",
        help="check configuration files, without starting anything",
        description="Checks configuration files as the nodes do, and reports mistakes with file, line and key.",
    )
    command.add_argument("files", metavar="FILE", nargs="+", help="a thresholds.yaml, ops.yaml or fleet.yaml")


def _add_sources(commands: Any) -> None:
    command = commands.add_parser(
        "sources",
        help="list the metrics available on this machine",
        description="Lists every source for the section `host` of battery_sensor: its configuration, its present "
        "value, or why it is not available. Shows a table on a terminal and plain lines in a pipe.",
    )
    command.add_argument("--json", action="store_true", help="one JSON object per source")


def _add_replay(commands: Any) -> None:
    command = commands.add_parser(
        "replay",
        help="show the alerts that recordings would have raised",
        description="Judges recordings as the live monitor would have done: .bag files, .mcap files, and folders of "
        "rosbag2. Several recordings are read together, in the order of their log times.",
    )
    _add_recordings(command)
    command.add_argument("--thresholds", metavar="FILE", help="configuration (default: the installed one)")
    command.add_argument(
        "--against", metavar="FILE", help="a second configuration; only the alerts in which the two differ are shown"
    )
    command.add_argument("--report", metavar="FILE", help="write a page with plots, one HTML file")
    command.add_argument(
        "--force",
        action="store_true",
        help="let --report replace a file that is not a report; never a file that is read",
    )
    command.add_argument("--json", action="store_true", help="one JSON object per alert on stdout, the table on stderr")
    command.add_argument(
        "--fail-on",
        choices=("warn", "error", "never"),
        default="warn",
        help="end with code 1 if there was an alert of this level or worse (OK < WARN < STALE < ERROR); with "
        "--against: if the alerts differ, unless never (default: warn)",
    )
    command.add_argument(
        "--allow-missing",
        action="store_true",
        help="do not fail because a signal is not recorded; otherwise that ends with code 1",
    )
    command.add_argument(
        "--from", dest="from_s", metavar="SECONDS", type=_offset, default=0.0, help="begin this long after the start"
    )
    command.add_argument(
        "--to", dest="to_s", metavar="SECONDS", type=_offset, default=math.inf, help="end this long after the start"
    )
    command.add_argument("--use-sim-time", action="store_true", help="take the time from the recorded topic /clock")


def _add_suggest(commands: Any) -> None:
    command = commands.add_parser(
        "suggest",
        help="write thresholds from recordings of healthy robots",
        description="Writes a thresholds.yaml to stdout, with the evidence for each value: for every number of the "
        "standard messages (std_msgs, sensor_msgs), or for the signals of --thresholds.",
    )
    _add_recordings(command)
    command.add_argument("--thresholds", metavar="FILE", help="suggest for the signals of this configuration")


def _add_test(commands: Any) -> None:
    command = commands.add_parser(
        "test",
        help="run unit tests of a thresholds.yaml",
        description="Runs tests of a thresholds.yaml in virtual time: series of samples in, expected alerts out. "
        "Ends with code 1 if a test fails, and shows the differences.",
    )
    command.add_argument("files", metavar="FILE", nargs="+", help="tests; docs/recordings.md describes the format")


def _add_export(commands: Any) -> None:
    command = commands.add_parser(
        "export",
        help="write alerting rules for Prometheus or a dashboard for Grafana",
        description="Writes the thresholds of a file for other systems, on stdout. They read the metrics that a "
        "monitor serves at /metrics.",
    )
    targets = command.add_subparsers(dest="target", metavar="TARGET", required=True, parser_class=_Parser)
    prometheus = targets.add_parser(
        "prometheus",
        help="alerting rules",
        description="Writes a rule file for Prometheus 2.42 or newer. What PromQL cannot express is a comment at its "
        "rule and a line on stderr.",
    )
    prometheus.add_argument(
        "--robot",
        metavar="NAME",
        action="append",
        default=[],
        help="robot that the rules apply to (repeatable; default: all)",
    )
    prometheus.add_argument(
        "--interval",
        metavar="SECONDS",
        type=_seconds,
        default=15.0,
        help="interval of scrapes and evaluations; durations are rounded up to it (default: 15)",
    )
    grafana = targets.add_parser(
        "grafana", help="a dashboard", description="Writes a dashboard in JSON, to import into Grafana 9 or newer."
    )
    for target in (prometheus, grafana):
        target.add_argument("file", metavar="FILE", help="a thresholds.yaml")


def _add_notify(commands: Any) -> None:
    command = commands.add_parser(
        "notify",
        help="send a test notification to every target of an ops.yaml",
        description="Sends a test alert to every target of an ops.yaml, then resolves it, and reports each response. "
        "Ends with code 3 if a target failed.",
    )
    command.add_argument("file", metavar="FILE", help="an ops.yaml")
    command.add_argument(
        "--hold",
        metavar="TIME",
        type=_hold,
        help="how long the test alert stays, such as 90s or 0 (default: 60s at alertmanager, which notifies after its "
        "group_wait, and 0 at all other targets)",
    )


def _add_history(commands: Any) -> None:
    command = commands.add_parser(
        "history",
        help="show past alerts, from a history file",
        description="Shows the alerts in a history file, with starts and stops of the monitor, resets and changes of "
        "the configuration. The monitor may be running.",
    )
    command.add_argument(
        "file",
        metavar="FILE",
        nargs="?",
        help="the history (default: that of --ops, else /var/lib/robot-health/history.db)",
    )
    command.add_argument("--ops", metavar="FILE", help="an ops.yaml that names the history")
    command.add_argument(
        "--since",
        dest="since_s",
        metavar="TIME",
        type=_moment,
        help="only what is newer: 90s, 1h30m, 24h, 7d, or a local time such as 2026-11-22T08:00",
    )
    command.add_argument("--robot", metavar="R", help="only this robot; * and ? as in file names")
    command.add_argument("--signal", metavar="S", help="only this signal; * and ? as in file names")
    command.add_argument(
        "--level", metavar="L", type=_level, help="only transitions to this level: OK, WARN, ERROR or STALE"
    )
    content = command.add_mutually_exclusive_group()
    content.add_argument(
        "--summary",
        action="store_true",
        help="per signal: share of time per level, alerts, longest time not OK",
    )
    content.add_argument("--alert", metavar="ID", type=_number, help="one transition, with a plot of its samples")
    form = command.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="one JSON object per line")
    form.add_argument("--csv", action="store_true", help="comma-separated values")


def _add_silence(commands: Any) -> None:
    command = commands.add_parser(
        "silence",
        help="suppress notifications, for a time or until an alert resolves",
        description="Silences suppress notifications only: silenced alerts stay visible, marked as silenced. They are "
        "stored in the history file, where a running monitor finds them within about a second.",
    )
    actions = command.add_subparsers(dest="action", metavar="ACTION", required=True, parser_class=_Parser)
    add = actions.add_parser(
        "add",
        help="add a silence",
        description="Adds a silence. With --for and --until-resolved it ends with whichever comes first.",
    )
    add.add_argument(
        "matchers",
        metavar="MATCHERS",
        help="which alerts, such as robot=r3,signal=battery*; labels robot and signal; = and !=; * and ? as in file "
        "names",
    )
    add.add_argument("--for", dest="for_s", metavar="TIME", type=_duration, help="how long: 30m, 1h30m, 7d")
    add.add_argument(
        "--until-resolved",
        action="store_true",
        help="acknowledge: only the alerts that are open now, each until it resolves",
    )
    add.check = _check_silence
    lists = actions.add_parser(
        "list",
        help="list silences, and how many alerts each silences",
        description="Lists the active silences and those that ended within a day. `open`: alerts that it silences now; "
        "`alerts`: changes to WARN, ERROR or STALE that it has silenced.",
    )
    lists.add_argument("--all", action="store_true", help="also those that ended earlier")
    lists.add_argument("--json", action="store_true", help="one JSON object per silence")
    expire = actions.add_parser("expire", help="end silences now", description="Ends silences now.")
    expire.add_argument("ids", metavar="ID", type=_silence_id, nargs="+", help="as shown by `list`")
    for change, why in ((add, "why; shown with the alerts"), (expire, "why; shown in the history")):
        change.add_argument("--reason", metavar="TEXT", default="", help=why)
        change.add_argument("--author", metavar="NAME", help="who (default: the login name)")
    for action in (add, lists, expire):
        action.add_argument(
            "--history",
            metavar="FILE",
            help="the history file (default: that of --ops, else /var/lib/robot-health/history.db)",
        )
        action.add_argument("--ops", metavar="FILE", help="an ops.yaml that names the history")


def _check_silence(arguments: argparse.Namespace) -> str:
    is_ended = arguments.for_s is not None or arguments.until_resolved
    return "" if is_ended else "expected --for TIME or --until-resolved, got neither"


def _namespace(text: str) -> str:
    from robot_health_monitor.core.middleware import is_namespace

    if not is_namespace(text):
        raise argparse.ArgumentTypeError(f"expected a namespace such as carter or fleet/carter, got {text!r}")
    return text


def _silence_id(text: str) -> int:
    if not re.match(r"\d{1,18}\Z", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"expected the id of a silence, got {text!r}")
    return int(text)


def _duration(text: str) -> float:
    from robot_health_monitor.core.errors import ConfigError
    from robot_health_monitor.ops.silences import parse_duration_s

    try:
        return parse_duration_s(text)
    except ConfigError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _hold(text: str) -> float:
    try:
        seconds = float(text)  # 0, and seconds without their unit
    except ValueError:
        seconds = _duration(text)
    if not 0.0 <= seconds <= 86_400.0:
        raise argparse.ArgumentTypeError(f"expected a duration of at most a day, such as 90s, got {text!r}")
    return seconds


def _moment(text: str) -> float:
    """Returns a time in s since 1970: so long ago, or a date and time by ISO 8601."""
    parts = re.findall(r"(\d{1,9}(?:\.\d{1,9})?)(min|[smhdw])", text, re.ASCII)
    if parts and "".join(number + unit for number, unit in parts) == text:
        return time.time() - sum(float(number) * _UNITS_S[unit] for number, unit in parts)
    try:
        return datetime.fromisoformat(text).timestamp()
    except (ValueError, OverflowError, OSError):
        raise argparse.ArgumentTypeError(
            f"expected a duration such as 24h or a time such as 2026-11-22T08:00, got {text!r}"
        ) from None


def _level(text: str) -> str:
    if text.upper() not in ("OK", "WARN", "ERROR", "STALE"):
        raise argparse.ArgumentTypeError(f"expected OK, WARN, ERROR or STALE, got {text!r}")
    return text.upper()


def _number(text: str) -> int:
    if not re.match(r"#?\d{1,18}\Z", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"expected the number of a transition, got {text!r}")
    return int(text.lstrip("#"))


def _port(text: str) -> int:
    if not (text.isascii() and text.isdigit()) or len(text) > 5 or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"expected a whole number from 0 to 65535, got {text!r}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < 1e9:
        raise argparse.ArgumentTypeError(f"expected a number of seconds above 0, got {text!r}")
    return seconds


def _offset(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds < 1e9:
        raise argparse.ArgumentTypeError(f"expected a number of seconds, 0 or more, got {text!r}")
    return seconds
