"""`robot-health test`: runs the unit tests of thresholds files."""

from __future__ import annotations

import argparse
import sys
from typing import List, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import count_text, printable
from robot_health_monitor.runtime.interrupts import Interrupts

from .arguments import Parser
from .exit_codes import ExitCode
from .threshold_tests import Difference, compare, read_tests, run_test


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Runs tests of a thresholds.yaml in virtual time: series of samples in, expected alerts out. "
        "Shows the differences if a test fails."
    )
    parser.add_argument("files", metavar="FILE", nargs="+", help="tests; docs/recordings.md describes the format")


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Runs every test of every file; writes results on stdout and mistakes in the files on stderr.

    Returns:
        The exit code of the worst file: `ALERTS` for a test that failed, `USAGE` for a file that cannot be used.
    """
    return max(_run_file(file) for file in arguments.files)


def _run_file(file: str) -> ExitCode:
    try:
        config, tests = read_tests(file)
    except ConfigError as error:
        for each in dict.fromkeys(map(str, error.all)):
            sys.stderr.write(f"{printable(each)}\n")
        return ExitCode.USAGE
    failed = 0
    for test in tests:
        differences = compare(test.expected, run_test(config, test))
        if any(difference.mark != " " for difference in differences):
            failed += 1
            _write([f"{file}: FAILED: {test.name}", *_diff(differences)])
    if failed:
        _write([f"{file}: {failed} of {count_text(len(tests), 'test')} failed"])
        return ExitCode.ALERTS
    _write([f"{file}: OK: {count_text(len(tests), 'test')}"])
    return ExitCode.SUCCESS


def _diff(differences: Sequence[Difference]) -> List[str]:
    width = max(len(str(difference.alert)) for difference in differences)
    lines = ["  - expected, did not occur", "  + occurred, not expected"]
    for mark, alert in differences:
        comment = f"{alert!s:<{width}}  # {alert.text}" if alert.text else str(alert)
        lines.append(f"  {mark} {comment}")
    return lines


def _write(lines: Sequence[str]) -> None:
    for line in lines:
        sys.stdout.write(f"{printable(line)}\n")
