"""`robot-health replay`: the alerts that recordings would have raised."""

from __future__ import annotations

import argparse
import math

from ...core.values.errors import ServiceError
from ...runtime.interrupts import Interrupts
from ..arguments import INTERRUPTED, Parser, add, add_recordings, checked
from ..exit_codes import ExitCode


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Judges recordings as the live monitor would have done: .bag files, .mcap files, and folders of "
        "rosbag2. Several recordings are read together, in the order of their log times."
    )
    add_recordings(parser)
    add(parser, "--thresholds FILE", "configuration (default: the installed one)")
    add(parser, "--against FILE", "show only the alerts in which this second configuration differs")
    add(parser, "--report FILE", "write a page with plots, one HTML file")
    add(parser, "--force", "let --report replace any file, except those that are read")
    add(parser, "--json", "one JSON object per alert on stdout, the table on stderr")
    add(
        parser,
        "--fail-on",
        "end with code 1 if there was an alert of this level or worse (OK < WARN < STALE < ERROR); with --against: if "
        "the alerts differ, unless never (default: warn)",
        choices=("warn", "error", "never"),
        default="warn",
    )
    add(parser, "--allow-missing", "do not end with code 1 because a signal is not recorded")
    offset = checked("a number of seconds, 0 or more", float, lambda number: 0.0 <= number < 1e9)
    add(parser, "--from SECONDS", "begin this long after the start", type=offset, dest="from_s", default=0.0)
    add(parser, "--to SECONDS", "end this long after the start", type=offset, dest="to_s", default=math.inf)
    add(parser, "--use-sim-time", "take the time from the recorded topic /clock")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Judges recordings, and shows the alerts; returns the exit code."""
    try:
        from ..replay import replay

        return ExitCode.ALERTS if replay(arguments) else ExitCode.SUCCESS
    except KeyboardInterrupt:  # half a result must not look like success
        raise ServiceError(INTERRUPTED) from None
