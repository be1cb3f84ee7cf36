"""`robot-health replay`: the alerts that recordings would have raised."""

from __future__ import annotations

import argparse
import functools
import math

from ...core.values.errors import ServiceError
from ...runtime.interrupts import Interrupts
from ...runtime.libraries import RECORDINGS, libraries
from ..arguments import INTERRUPTED, Parser, add_recordings, number_or_nan
from ..exit_codes import ExitCode


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Judges recordings as the live monitor would have done: .bag files, .mcap files, and folders of "
        "rosbag2. Several recordings are read together, in the order of their log times."
    )
    add_recordings(parser)
    add = parser.add_argument
    add("--thresholds", metavar="FILE", help="configuration (default: the installed one)")
    add("--against", metavar="FILE", help="show only the alerts in which this second configuration differs")
    add("--report", metavar="FILE", help="write a page with plots, one HTML file")
    add("--force", action="store_true", help="let --report replace any file, except those that are read")
    add("--json", action="store_true", help="one JSON object per alert on stdout, the table on stderr")
    add(
        "--fail-on",
        choices=("warn", "error", "never"),
        default="warn",
        help="end with code 1 if there was an alert of this level or worse (OK < WARN < STALE < ERROR); with "
        "--against: if the alerts differ, unless never (default: warn)",
    )
    add("--allow-missing", action="store_true", help="do not end with code 1 because a signal is not recorded")
    add_time = functools.partial(add, metavar="SECONDS", type=_offset)
    add_time("--from", dest="from_s", default=0.0, help="begin this long after the start")
    add_time("--to", dest="to_s", default=math.inf, help="end this long after the start")
    add("--use-sim-time", action="store_true", help="take the time from the recorded topic /clock")


def _offset(text: str) -> float:
    number = number_or_nan(text)
    if not 0.0 <= number < 1e9:
        raise argparse.ArgumentTypeError(f"expected a number of seconds, 0 or more, got {text!r}")
    return number


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Judges recordings, and shows the alerts; returns the exit code."""
    try:
        with libraries(*RECORDINGS):
            from ..replay import replay

        return ExitCode.ALERTS if replay(arguments) else ExitCode.SUCCESS
    except KeyboardInterrupt:  # half a result must not look like success
        raise ServiceError(INTERRUPTED) from None
