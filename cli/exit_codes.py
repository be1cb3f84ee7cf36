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


_MEANINGS: Mapping[ExitCode, str] = {
    ExitCode.SUCCESS: "success",
    ExitCode.ALERTS: "alerts were found (replay, --duration) or a test failed",
    ExitCode.USAGE: "usage or configuration error",
    ExitCode.FAILED: "the command itself failed, or a target of notify",
}
_JUDGING = ("", "run", "connect", "replay", "test")
"""Commands that can end with `ALERTS`; the empty name stands for any command."""


def internal_error_text(error: BaseException) -> str:
    """Returns file, line and text of an error that is a bug, for a report of it."""
    import traceback

    frames = traceback.extract_tb(error.__traceback__)
    place = f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}: " if frames else ""
    return f"internal error: {place}{type(error).__name__}: {error}"


def exit_codes_text(command: str = "") -> str:
    """Returns the line about exit codes in the help of a command, without one that of `robot-health`."""
    codes = [code for code in ExitCode if code is not ExitCode.ALERTS or command in _JUDGING]
    return "Exit codes: " + ", ".join(f"{int(code)} {_MEANINGS[code]}" for code in codes) + "."
