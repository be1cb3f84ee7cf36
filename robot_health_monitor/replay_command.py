"""`robot-health replay`: the alerts that recordings would have raised."""

from __future__ import annotations

import argparse
import math

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.runtime.interrupts import Interrupts
from robot_health_monitor.runtime.libraries import RECORDINGS, libraries

from .arguments import INTERRUPTED, Parser, add_recordings, number_or_nan
from .exit_codes import ExitCode


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Judges recordings as the live monitor would have done: .bag files, .mcap files, and folders of "
        "rosbag2. Several recordings are read together, in the order of their log times."
    )
    add_recordings(parser)
    parser.add_argument("--thresholds", metavar="FILE", help="configuration (default: the installed one)")
    parser.add_argument(
        "--against", metavar="FILE", help="show only the alerts in which this second configuration differs"
    )
    parser.add_argument("--report", metavar="FILE", help="write a page with plots, one HTML file")
    parser.add_argument(
        "--force", action="store_true", help="let --report replace any file, except those that are read"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object per alert on stdout, the table on stderr")
    parser.add_argument(
        "--fail-on",
        choices=("warn", "error", "never"),
        default="warn",
        help="end with code 1 if there was an alert of this level or worse (OK < WARN < STALE < ERROR); with "
        "--against: if the alerts differ, unless never (default: warn)",
    )
    parser.add_argument(
        "--allow-missing", action="store_true", help="do not end with code 1 because a signal is not recorded"
    )
    parser.add_argument(
        "--from", dest="from_s", metavar="SECONDS", type=_offset, default=0.0, help="begin this long after the start"
    )
    parser.add_argument(
        "--to", dest="to_s", metavar="SECONDS", type=_offset, default=math.inf, help="end this long after the start"
    )
    parser.add_argument("--use-sim-time", action="store_true", help="take the time from the recorded topic /clock")


def _offset(text: str) -> float:
    number = number_or_nan(text)
    if not 0.0 <= number < 1e9:
        raise argparse.ArgumentTypeError(f"expected a number of seconds, 0 or more, got {text!r}")
    return number


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Judges recordings, and shows the alerts; returns the exit code."""
    try:
        with libraries(*RECORDINGS):
            from .replay import replay

        return ExitCode.ALERTS if replay(arguments) else ExitCode.SUCCESS
    except KeyboardInterrupt:  # half a result must not look like success
        raise ServiceError(INTERRUPTED) from None
