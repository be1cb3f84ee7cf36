"""`robot-health check`: reads configuration files as the nodes would, without starting anything."""

from __future__ import annotations

import sys
from typing import Sequence

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.yaml_file import read_yaml

from .embedded import EmbeddedMonitor


def check(files: Sequence[str]) -> bool:
    """Writes one line per file: what it holds on stdout, or what is wrong with it on stderr.

    Returns:
        Whether all are right.
    """
    fine = True
    for file in files:
        try:
            line, stream = f"{file}: OK: {_summary(file)}", sys.stdout
        except ConfigError as error:
            line, stream, fine = str(error), sys.stderr, False
        one_line = line.replace("\n", "\\n")  # whatever a file's name holds
        stream.write(f"{one_line}\n")
    return fine


def _summary(file: str) -> str:
    """Returns what a configuration file holds, once the nodes have accepted it."""
    monitor = EmbeddedMonitor(read_yaml(file))
    monitor.close()
    signals = monitor.alert_system.monitor.config.signals
    bounds = sum(len(signal.bounds) for signal in signals.values())
    unused = ", ".join(monitor.unused_sections)
    return f"{_count(len(signals), 'signal')} ({', '.join(signals)}), {_count(bounds, 'bound')}" + (
        f"; not used here: {unused}" if unused else ""
    )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
