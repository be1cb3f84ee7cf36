"""Where monitors show themselves: a live table on a terminal, plain lines in a pipe, JSON for programs."""

from __future__ import annotations

import asyncio
import os
import sys
from typing import Optional, Protocol, Sequence

from robot_health_monitor.core.monitor import Monitor

from .lines import Event, JsonOutput, PlainOutput


class Shown(Protocol):
    """What there is to show: one robot or several."""

    @property
    def monitors(self) -> Sequence[Monitor]:
        """One monitor per robot."""

    @property
    def now_s(self) -> float:
        """The time in seconds, on the monitors' clock."""

    @property
    def system_health(self) -> Optional[float]:
        """The latest system_health, None while it is not known or not one number."""


class Output(Protocol):
    """Where monitors show themselves."""

    def attach(self, loop: asyncio.AbstractEventLoop, shown: Shown) -> None:
        """Makes ready for what may happen between two calls of `show`, such as a window that changes its size."""

    def show(self, events: Sequence[Event], shown: Shown) -> None:
        """Shows what has happened since the last call, and the state now.

        Raises:
            BrokenPipeError: nobody looks any more.
        """

    def close(self) -> None:
        """Leaves the output as others expect it."""


def choose_output(as_json: bool, name_robots: bool = False) -> Output:
    """Returns the output for this process' stdout.

    Args:
        as_json: one JSON object per transition instead of what people read.
        name_robots: write the robot's name before each transition, for there may be several.
    """
    if as_json:
        return JsonOutput(sys.stdout, sys.stderr)
    if not sys.stdout.isatty() or os.environ.get("TERM") in (None, "", "dumb", "unknown"):
        return PlainOutput(sys.stdout, name_robots)
    try:
        from .live import LiveView
    except ModuleNotFoundError:
        sys.stderr.write("rich is not installed, which draws the live table (pip install rich): plain lines instead\n")
        return PlainOutput(sys.stdout, name_robots)
    return LiveView(sys.stdout, name_robots)
