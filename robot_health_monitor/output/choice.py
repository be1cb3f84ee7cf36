"""Chooses the output for this process' stdout."""

from __future__ import annotations

import os
import sys

from robot_health_monitor.runtime.libraries import missing_libraries, missing_text

from .display import Output
from .json_lines import JsonLines
from .plain import PlainLines

__all__ = ["choose_output"]


def choose_output(as_json: bool, name_robots: bool = False) -> Output:
    """Returns the output: JSON if requested, a live table on a terminal, otherwise plain lines.

    Args:
        as_json: one JSON object per transition.
        name_robots: put the robot's name before each transition.
    """
    if as_json:
        return JsonLines(sys.stdout, sys.stderr)
    if not sys.stdout.isatty() or os.environ.get("TERM") in (None, "", "dumb", "unknown"):
        return PlainLines(sys.stdout, name_robots)
    try:
        from .live import LiveView
    except ModuleNotFoundError as error:
        sys.stderr.write(f"{missing_text(missing_libraries(error, 'rich'))} (plain lines instead of the live table)\n")
        return PlainLines(sys.stdout, name_robots)
    return LiveView(sys.stdout, name_robots)
