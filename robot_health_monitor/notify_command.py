"""`robot-health notify`: sends a test notification to every target of an ops.yaml."""

from __future__ import annotations

import argparse
import math
import sys
import threading
from typing import Dict, Iterator, Optional, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.nodes.node import host_name
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import TargetSettings, read_ops
from robot_health_monitor.ops.notifications.trial import ALERTMANAGER_HOLD_S, Trial, try_target
from robot_health_monitor.runtime.interrupts import Interrupts

from .arguments import Parser, duration, number_or_nan
from .exit_codes import ExitCode

_FURTHER_S = 30.0
"""How long a target may take beyond its timeouts, for instance to resolve a host name, in s."""


def add_arguments(parser: Parser) -> None:
    """Adds the arguments of the command."""
    parser.description = (
        "Sends a test alert to every target of an ops.yaml, then resolves it, and reports each response."
    )
    parser.add_argument("file", metavar="FILE", help="an ops.yaml")
    parser.add_argument(
        "--hold",
        metavar="TIME",
        type=_hold,
        help="how long the test alert stays, such as 90s or 0 (default: 60s at alertmanager, which notifies after its "
        "group_wait, and 0 at all other targets)",
    )


def _hold(text: str) -> float:
    number = number_or_nan(text)  # 0, and seconds without their unit
    hold_s = duration(text) if math.isnan(number) else number
    if not 0.0 <= hold_s <= 86_400.0:
        raise argparse.ArgumentTypeError(f"expected a duration of at most a day, such as 90s, got {text!r}")
    return hold_s


def run(arguments: argparse.Namespace, interrupts: Interrupts) -> int:
    """Sends the test notifications; returns the exit code."""
    return ExitCode.SUCCESS if notify(arguments.file, arguments.hold) else ExitCode.FAILED


def notify(file: str, hold_s: Optional[float] = None) -> bool:
    """Sends a test alert to every target at once, resolves it, and writes a line per target in the order of the file.

    Args:
        file: path of an ops.yaml.
        hold_s: for how long the alert stays, in s; None: 60 for Alertmanager, 0 for the others. SIGINT ends it early.

    Returns:
        Whether all targets accepted it.

    Raises:
        ConfigError: the file cannot be used, or has no targets.
    """
    targets = read_ops(read_yaml(file)).notify
    if not targets:
        raise ConfigError("expected targets in the section notify, got none", file=file)
    all_succeeded = True
    for trial in _try_all(targets, hold_s):
        all_succeeded = all_succeeded and trial.succeeded
        _write(f"{trial.name}: {'OK' if trial.succeeded else 'FAILED'}: {trial.text}")
        if trial.warning:
            sys.stderr.write(f"{printable(trial.warning)}\n")
    return all_succeeded


def _write(line: str) -> None:
    sys.stdout.write(f"{printable(line)}\n")
    sys.stdout.flush()


def _try_all(targets: Sequence[TargetSettings], hold_s: Optional[float]) -> Iterator[Trial]:
    robot = host_name() or "robot"
    stop = threading.Event()
    trials: Dict[str, Trial] = {}

    def held_s(target: TargetSettings) -> float:
        by_default_s = ALERTMANAGER_HOLD_S if target.type == "alertmanager" else 0.0
        return by_default_s if hold_s is None else hold_s

    def run(target: TargetSettings) -> None:
        try:
            trials[target.name] = try_target(
                target, robot, held_s(target), stop, lambda text: _write(f"{target.name}: {text}")
            )
        except Exception as error:  # its text may contain a secret
            trials[target.name] = Trial(target.name, False, f"internal error: {type(error).__name__}", "")

    threads = [threading.Thread(target=run, args=(target,), daemon=True) for target in targets]
    for thread in threads:
        thread.start()
    for target, thread in zip(targets, threads):
        limit_s = 3.0 * target.timeout_s + _FURTHER_S
        try:
            thread.join(held_s(target) + limit_s)
        except KeyboardInterrupt:
            stop.set()  # the test alerts are resolved before the end
            thread.join(limit_s)
        yield trials.get(target.name) or Trial(target.name, False, "no response", "")
