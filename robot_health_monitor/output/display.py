"""The interface between monitors that run and the output that shows them."""

from __future__ import annotations

import asyncio
from typing import Optional, Protocol, Sequence

from robot_health_monitor.core.errors import ServiceError
from robot_health_monitor.core.nodes import AlertSystem

from .events import Entry

__all__ = ["Output", "OutputError", "Shown", "ShownRobot"]


class OutputError(ServiceError):
    """The output could not be written completely. `str()` says why."""


class ShownRobot(Protocol):
    """One robot."""

    alert_system: AlertSystem
    """Judges the robot's signals."""

    @property
    def now_s(self) -> float:
        """Seconds on the monitor's clock."""


class Shown(Protocol):
    """One robot or several."""

    @property
    def robots(self) -> Sequence[ShownRobot]:
        """The robots that are watched now."""

    @property
    def system_health(self) -> Optional[float]:
        """The latest system_health; None: not published, or several robots."""


class Output(Protocol):
    """Shows monitors. Writing has its own thread: no method waits for a reader, except `close`, for 1 s."""

    @property
    def reader_is_gone(self) -> bool:
        """Whether nothing reads the output any more: the pipe's reader has exited, the terminal is closed."""

    @property
    def problem(self) -> str:
        """Why the output is not written, or was not until `close`; empty: it is."""

    def start(self, loop: asyncio.AbstractEventLoop, shown: Shown) -> None:
        """Begins writing what was added before and after. Called in the loop's thread."""

    def add(self, entry: Entry) -> None:
        """Writes an event; never blocks. While the output is not read, the oldest entries are dropped and counted."""

    def show(self, shown: Shown) -> None:
        """Shows the current state; called several times a second, in the loop's thread."""

    def close(self) -> None:
        """Writes what is left and restores the terminal, unless the output is not read."""
