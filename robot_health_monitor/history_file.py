"""Which history file a command means, how commands read it, and how they write its times in JSON and CSV."""

from __future__ import annotations

import contextlib
import os
import sys
from typing import Iterator, Optional

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.yaml_file import read_yaml
from robot_health_monitor.ops.configuration import read_ops
from robot_health_monitor.ops.history.database_file import reading
from robot_health_monitor.ops.history.rows import CheckedConnection
from robot_health_monitor.runtime import times

DEFAULT_FILE = "/var/lib/robot-health/history.db"
"""Where a monitor that runs as a service has its history."""


def history_file(file: Optional[str], ops: Optional[str]) -> str:
    """Returns the path of the history: `file` or that of an ops.yaml, if one of them was given.

    Raises:
        ConfigError: both were given, or the ops.yaml cannot be used or has no history.
    """
    if file is not None and ops is not None:
        raise ConfigError("expected either a history file or --ops, got both")
    if file is not None:
        return file
    if ops is None:
        if not os.path.exists(DEFAULT_FILE):
            raise ConfigError(f"no history file is given, and there is no {DEFAULT_FILE}")
        return DEFAULT_FILE
    history = read_ops(read_yaml(ops)).history
    if history is None:
        raise ConfigError("expected a section history, got none", file=ops)
    return history.file


@contextlib.contextmanager
def reading_history(file: str) -> Iterator[CheckedConnection]:
    """Opens a history file, as `reading`, and reports the rows that were skipped."""
    with reading(file) as connection:
        yield connection
        if connection.skipped:
            sys.stderr.write(f"{printable(file)}: {connection.skipped_text}\n")


def iso_time(wall_s: float) -> str:
    """Returns a wall time in UTC, by ISO 8601; empty where there is no such date."""
    return (times.iso_time(wall_s) or "").replace("Z", "+00:00")
