"""The exit codes of `robot-health`, and the text of an error that is a bug."""

from __future__ import annotations

import enum
import os
from typing import Mapping


class ExitCode(enum.IntEnum):
    """How a command ended."""

    SUCCESS = 0
    ALERTS = 1
    """Alerts were found, or a test failed: of commands whose job is to judge."""
    USAGE = 2
    """Usage or configuration error."""
    FAILED = 3
    """The command itself failed."""


_ALERTS: Mapping[str, str] = {
    "": "alerts were found (replay, --duration) or a test failed",
    "run": "alerts were found (only with --duration)",
    "connect": "alerts were found (only with --duration)",
    "replay": "alerts were found or differ (--against) or a signal was not judged",
    "test": "a test failed",
}
"""When a command ends with `ALERTS`; the empty name stands for any command."""
_FAILED: Mapping[str, str] = {"notify": "a target or the command itself failed"}


def internal_error_text(error: BaseException) -> str:
    """Returns file, line and text of an error that is a bug, for a report of it."""
    import traceback

    frames = traceback.extract_tb(error.__traceback__)
    place = f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}: " if frames else ""
    return f"internal error: {place}{type(error).__name__}: {error}"


def exit_codes_text(command: str = "") -> str:
    """Returns the line about exit codes in the help of a command, without one that of `robot-health`."""
    meanings = {
        ExitCode.SUCCESS: "success",
        ExitCode.ALERTS: _ALERTS.get(command, ""),
        ExitCode.USAGE: "usage or configuration error",
        ExitCode.FAILED: _FAILED.get(command, "the command itself failed"),
    }
    return "Exit codes: " + ", ".join(f"{int(code)} {meaning}" for code, meaning in meanings.items() if meaning) + "."
