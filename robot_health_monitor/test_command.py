"""`robot-health test`: runs unit tests of a thresholds.yaml, or writes the one of a past alert."""

from __future__ import annotations

import argparse
import sys
from typing import Iterator, List, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import count_text, printable
from robot_health_monitor.runtime.interrupts import Interrupts

from .alert_test import alert_test
from .arguments import Parser, alert_id
from .exit_codes import ExitCode
from .history_file import add_history_options, history_file, reading_history
from .threshold_tests import Difference, compare, read_tests, run_test


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Runs tests of a thresholds.yaml in virtual time: series of samples in, expected alerts out. "
        "Shows the differences if a test fails. With --from-alert, writes the test of a past alert to stdout."
    )
    parser.add_argument("files", metavar="FILE", nargs="*", help="tests; docs/recordings.md describes the format")
    parser.add_argument("--from-alert", metavar="ID", type=alert_id, help="the alert, as `history` shows it: 41 or #41")
    parser.add_argument(
        "--thresholds",
        metavar="FILE",
        help="with --from-alert: the path that the test names (default: it contains the thresholds in force then)",
    )
    add_history_options(parser)
    parser.check = _check_task


def _check_task(arguments: argparse.Namespace) -> str:
    if bool(arguments.files) is (arguments.from_alert is not None):
        return f"expected either FILE or --from-alert, got {'both' if arguments.files else 'neither'}"
    for option in ("thresholds", "history", "ops"):
        if arguments.files and getattr(arguments, option) is not None:
            return f"--{option}: only with --from-alert"
    return ""


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Runs all tests of all files, or writes one; returns the worst code: `ALERTS` if a test failed."""
    if arguments.from_alert is None:
        return max(_run_file(file) for file in arguments.files)
    with reading_history(history_file(arguments.history, arguments.ops)) as connection:
        text = alert_test(connection, arguments.from_alert, arguments.thresholds)
    sys.stdout.write(text)
    sys.stdout.flush()
    return ExitCode.SUCCESS


def _run_file(file: str) -> ExitCode:
    try:
        config, tests = read_tests(file)
    except ConfigError as error:
        for each in dict.fromkeys(map(str, error.all)):
            sys.stderr.write(f"{printable(each)}\n")
        return ExitCode.USAGE
    failed = 0
    lines: List[str] = []
    for test in tests:
        differences = compare(test.expected, run_test(config, test))
        if any(mark != " " for mark, _ in differences):
            failed += 1
            lines += [f"{file}: FAILED: {test.name}", *_diff(differences)]
    tests_text = count_text(len(tests), "test")
    lines.append(f"{file}: {failed} of {tests_text} failed" if failed else f"{file}: OK: {tests_text}")
    sys.stdout.write("".join(f"{printable(line)}\n" for line in lines))
    return ExitCode.ALERTS if failed else ExitCode.SUCCESS


def _diff(differences: Sequence[Difference]) -> Iterator[str]:
    yield "  - expected, did not occur"
    yield "  + occurred, not expected"
    width = max(len(str(alert)) for _, alert in differences)
    for mark, alert in differences:
        yield f"  {mark} {alert!s:<{width}}  # {alert.text}" if alert.text else f"  {mark} {alert}"
