"""`robot-health notify`: sends a test notification to every target of an ops.yaml."""

from __future__ import annotations

import sys
import threading
from typing import Dict, Iterator, Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.nodes.identity import host_name
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import TargetSettings, read_ops
from robot_health_monitor.ops.notifications.trial import Trial, try_target

_FURTHER_S = 30.0
"""How long a target may take beyond its timeouts, for instance to resolve a host name, in s."""


def notify(file: str) -> bool:
    """Sends a test and its end to every target at once, and writes a line per target in the order of the file.

    Args:
        file: path of an ops.yaml.

    Returns:
        Whether all targets accepted it.

    Raises:
        ConfigError: the file cannot be used, or has no targets.
    """
    targets = read_ops(read_yaml(file)).notify
    if not targets:
        raise ConfigError("expected targets in the section notify, got none", file=file)
    all_succeeded = True
    for trial in _try_all(targets):
        all_succeeded = all_succeeded and trial.succeeded
        line = f"{trial.name}: {'OK' if trial.succeeded else 'FAILED'}: {trial.text}"
        sys.stdout.write(f"{printable(line)}\n")
        sys.stdout.flush()
        if trial.warning:
            sys.stderr.write(f"{printable(trial.warning)}\n")
    return all_succeeded


def _try_all(targets: Sequence[TargetSettings]) -> Iterator[Trial]:
    robot = host_name() or "robot"
    trials: Dict[str, Trial] = {}

    def run(target: TargetSettings) -> None:
        try:
            trials[target.name] = try_target(target, robot)
        except Exception as error:  # its text may contain a secret
            trials[target.name] = Trial(target.name, False, f"internal error: {type(error).__name__}", "")

    threads = [threading.Thread(target=run, args=(target,), daemon=True) for target in targets]
    for thread in threads:
        thread.start()
    for target, thread in zip(targets, threads):
        thread.join(3.0 * target.timeout_s + _FURTHER_S)
        yield trials.get(target.name) or Trial(target.name, False, "no response", "")
