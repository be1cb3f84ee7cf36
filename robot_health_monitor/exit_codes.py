"""The exit codes of `robot-health`."""

from __future__ import annotations

import enum


class ExitCode(enum.IntEnum):
    """How a command ended."""

    SUCCESS = 0
    ALERTS = 1
    """Alerts were found, or a test failed: of commands whose job is to judge."""
    USAGE = 2
    """Usage or configuration error."""
    FAILED = 3
    """The command itself failed."""
