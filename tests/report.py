"""Prints the table at the end of `make test`: what passed, what did not run and why, what failed, and the totals.

Reads nox's report and the JUnit files of pytest, whose folder is the only argument.
"""

from __future__ import annotations

import ast
import json
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

MOST_LINES = 30
"""Of tests that failed."""


class Counts(NamedTuple):
    """The results of one session."""

    passed: int
    failed: list[str]
    """A line for each test that failed."""
    skipped: dict[str, int]
    """The number of skipped tests by reason."""


def read_junit(file: Path) -> Counts:
    """Counts the tests of a session that ran pytest."""
    passed = 0
    failed: list[str] = []
    skipped: dict[str, int] = Counter()
    for case in ElementTree.parse(file).iter("testcase"):
        skip = case.find("skipped")
        problem = next((child for child in case if child.tag in ("failure", "error")), None)
        if problem is not None:
            why = (problem.get("message") or problem.tag).splitlines()[0]
            failed.append(f"{case.get('classname')}::{case.get('name')}: {why[:200]}")
        elif skip is not None:
            skipped[skip_reason(skip)] += 1
        else:
            passed += 1
    return Counts(passed, failed, skipped)


def skip_reason(skip: ElementTree.Element) -> str:
    """Returns why a test was skipped. For a whole module pytest gives "(file, line, reason)" as the text."""
    message = skip.get("message", "")
    if message != "collection skipped":
        return message
    file, _, reason = ast.literal_eval(skip.text or "('', 0, '')")
    return f"{os.path.relpath(file)}: {reason.replace('Skipped: ', '')}"


def count(session: dict[str, Any], junit: Path) -> Counts:
    """Counts a session; one without pytest, or that failed outside its tests, counts as one test."""
    counts = read_junit(junit) if junit.exists() else Counts(0, [], {})
    if session["result"] == "success":
        return counts if junit.exists() else Counts(1, [], {})
    exit_code = junit.with_suffix(".exit_code")
    ended = f": pytest ended with {exit_code.read_text()}" if exit_code.exists() else ""
    return counts._replace(failed=counts.failed or [f"outside its tests{ended}; its output is above"])


def main(results: Path) -> int:
    """Prints the report; returns 1 unless some tests ran and none failed."""
    report = results / "nox.json"
    if not report.exists():
        return 1
    print(f"\n{'session':<14}{'passed':>8}{'failed':>8}{'skipped':>9}{'seconds':>9}")
    passed = skipped = 0
    not_run, failed = [], []
    for session in json.loads(report.read_text())["sessions"]:
        name = session["signatures"][0]
        if session["result"] == "skipped":
            print(f"{name:<14}  not run")
            not_run.append(f"{name}: {session['reason']}")
        elif name.partition("-")[0] not in ("apt", "python"):  # which only prepare others
            counts = count(session, results / f"{name}.xml")
            of_session = sum(counts.skipped.values())
            seconds = session.get("duration", 0.0)
            print(f"{name:<14}{counts.passed:>8}{len(counts.failed):>8}{of_session:>9}{seconds:>9.0f}")
            not_run += [f"{name}: {number} skipped: {reason}" for reason, number in counts.skipped.items()]
            failed += [f"{name}: {line}" for line in counts.failed]
            passed, skipped = passed + counts.passed, skipped + of_session
    if not_run:
        print("\nNot run on this machine:", *not_run, sep="\n  ")
    if failed:
        print("\nFailed:", *failed[:MOST_LINES], *(["..."] if failed[MOST_LINES:] else []), sep="\n  ")
    print(f"\n{passed} passed, {len(failed)} failed, {skipped} skipped")
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
