"""`robot-health test`: runs unit tests of a thresholds.yaml, or writes the one of a past alert."""

from __future__ import annotations

import argparse
import os
import sys
from typing import Any, Iterator, Sequence

from ...core.config import read_yaml
from ...core.nodes.alert_system import TICK_PERIOD_S
from ...core.values import ConfigError, ServiceError, count_text, printable
from ...ops.configuration import read_ops
from ...runtime.interrupts import Interrupts
from ..arguments import Parser, add, checked, identifier, whole_number
from ..exit_codes import ExitCode
from ..history.history_file import add_history_options, history_file, reading_history
from ..testing.past_alert import PastAlert, alert_test, black_box_alerts, history_alert
from ..testing.threshold_cases import Difference, compare, read_tests, run_test


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Runs tests of a thresholds.yaml in virtual time: series of samples in, expected alerts out. "
        "Shows the differences if a test fails. With --from-alert, writes the test of a past "
        "alert to stdout, after it has run it."
    )
    add(parser, "[FILE]...", "tests; docs/recordings.md describes the format", dest="files")
    meaning = "the alert, as `history` shows it (41 or #41), or the .mcap file of a black box"
    alert = checked("the number of an alert or the .mcap file of a black box", _alert)
    add(parser, "--from-alert ID|FILE", meaning, type=alert)
    number = identifier("the number of an alert in the file")
    add(parser, "--number N", "with --from-alert FILE: number of the alert, of several", type=number)
    add(
        parser,
        "--thresholds FILE",
        "with --from-alert: a thresholds.yaml that the test names in place of the thresholds in force then; save the "
        "test in the current folder, because paths are relative to it",
    )
    add(parser, "--exact", "with --from-alert: exact times and values, in place of a readable period and digits")
    add_history_options(parser)
    parser.check = _check_task


def _check_task(arguments: argparse.Namespace) -> str:
    if bool(arguments.files) is (arguments.from_alert is not None):
        return f"expected either FILE or --from-alert, got {'both' if arguments.files else 'neither'}"
    return ""


def _alert(text: str) -> Any:
    """Returns the path of a black box, or the number of an alert in a history."""
    return text if text.endswith(".mcap") else whole_number(text[text.startswith("#") :])


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Runs all tests of all files, or writes one; returns the worst code: `ALERTS` if a test failed."""
    if arguments.from_alert is None:
        return max(_run_file(file) for file in arguments.files)
    if isinstance(arguments.from_alert, str):
        path, number = arguments.from_alert, arguments.number
        alerts = black_box_alerts(path)
        if number is None and len(alerts) > 1:
            sys.stderr.write(f"{printable(path)}: has {len(alerts)} alerts; choose one with --number N:\n")
            for place, each in enumerate(alerts, 1):
                sys.stderr.write(f"{place:>5}  {printable(each.transition.text)}\n")
            return ExitCode.USAGE
        if number is not None and not 1 <= number <= len(alerts):
            raise ConfigError(f"--number {number}: expected 1 to {len(alerts)}", file=path)
        alert = alerts[(number or 1) - 1]
    else:
        with reading_history(history_file(arguments.history, arguments.ops)) as connection:
            alert = history_alert(connection, arguments.from_alert)
        alert = _in_black_box(alert, arguments.ops) or alert
    test = alert_test(alert, arguments.thresholds, exact=arguments.exact)
    sys.stdout.write(test.text)
    sys.stdout.flush()
    sys.stderr.write(f"{printable(test.verdict)}\n")
    return ExitCode.SUCCESS if test.passes else ExitCode.ALERTS


def _in_black_box(alert: PastAlert, ops: str | None) -> PastAlert | None:
    """Returns an alert of a history as its black box has it; None if there is none, or it cannot be read."""
    settings = read_ops(read_yaml(ops)).black_box if ops and alert.black_box else None
    path = "" if settings is None else os.path.join(settings.folder, os.path.basename(alert.black_box))
    if not os.path.isfile(path):
        return None
    try:
        alerts = black_box_alerts(path)
    except (ConfigError, ServiceError):
        return None
    for each in alerts:
        is_same = (each.signal, each.transition.to_level) == (alert.signal, alert.transition.to_level)
        if is_same and abs(each.wall_s - alert.wall_s) <= TICK_PERIOD_S:
            return each._replace(title=alert.title, transition=alert.transition)
    return None


def _run_file(file: str) -> ExitCode:
    try:
        config, tests = read_tests(file)
    except ConfigError as error:
        for each in dict.fromkeys(map(str, error.all)):
            sys.stderr.write(f"{printable(each)}\n")
        return ExitCode.USAGE
    failed = 0
    lines: list[str] = []
    for test in tests:
        differences = compare(test.alerts, run_test(config, test))
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
