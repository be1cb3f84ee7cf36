"""`robot-health test`: runs the unit tests of thresholds files."""

from __future__ import annotations

import sys
from typing import List, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import count_text, printable

from .threshold_tests import Difference, compare, read_tests, run_test

PASSED, FAILED, INVALID = 0, 1, 2
"""Results of a run, the worst is the largest."""


def run_tests(files: Sequence[str]) -> int:
    """Runs every test of every file; writes results on stdout and mistakes in the files on stderr.

    Returns:
        `PASSED`, `FAILED` (a test failed) or `INVALID` (a file cannot be used).
    """
    return max(_run_file(file) for file in files)


def _run_file(file: str) -> int:
    try:
        config, tests = read_tests(file)
    except ConfigError as error:
        for each in dict.fromkeys(map(str, error.all)):
            sys.stderr.write(f"{printable(each)}\n")
        return INVALID
    failed = 0
    for test in tests:
        differences = compare(test.expected, run_test(config, test))
        if any(difference.mark != " " for difference in differences):
            failed += 1
            _write([f"{file}: FAILED: {test.name}", *_diff(differences)])
    if failed:
        _write([f"{file}: {failed} of {count_text(len(tests), 'test')} failed"])
        return FAILED
    _write([f"{file}: OK: {count_text(len(tests), 'test')}"])
    return PASSED


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
