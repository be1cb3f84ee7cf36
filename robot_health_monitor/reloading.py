"""Reads the configuration again while the process runs (SIGHUP).

Each part by itself: a file that is broken keeps only what it configures from changing.
"""

from __future__ import annotations

import asyncio
from typing import Callable, List, Optional, Protocol

from robot_health_monitor.core.errors import ConfigError
from robot_health_monitor.core.formatting import printable
from robot_health_monitor.core.middleware import NOTHING_CHANGED, Severity

__all__ = ["Reloadable", "Reloads"]

_TIMEOUT_S = 15.0
"""Longest time for one part: a file may be on a server that does not answer, or a pipe that nothing is written to."""


class Reloadable(Protocol):
    """A part of the process whose configuration can be read again."""

    async def reload(self) -> str:
        """Reads the configuration again and applies what differs.

        Returns:
            What changed, in one line; `NOTHING_CHANGED`; empty: it has been logged.

        Raises:
            ConfigError: the configuration cannot be used; the old one stays in force.
        """


class Reloads:
    """Reloads the parts of a process, one after the other, whenever it is requested."""

    def __init__(self, log: Callable[[Severity, str], object]) -> None:
        """Starts without parts.

        Args:
            log: writes a line.
        """
        self._log = log
        self._parts: List[Reloadable] = []
        self._wake: Optional[asyncio.Event] = None

    def add(self, part: Reloadable) -> None:
        """Adds a part. Call in the loop or before it runs."""
        self._parts.append(part)

    def request(self) -> None:
        """Reloads soon. Call in the loop."""
        if self._wake is not None:
            self._wake.set()

    async def run(self) -> None:
        """Reloads when it is requested, until it is cancelled."""
        wake = self._wake = asyncio.Event()
        while True:
            await wake.wait()
            wake.clear()
            await self._reload()

    async def _reload(self) -> None:
        texts: List[str] = []
        failed = False
        for part in tuple(self._parts):
            task = asyncio.ensure_future(part.reload())
            try:
                await asyncio.wait({task}, timeout=_TIMEOUT_S)
                if not task.done():
                    raise ConfigError(f"a file could not be read within {_TIMEOUT_S:g} s")
                texts.append(task.result())
            except ConfigError as error:
                failed = True
                more = f" ({len(error.all) - 1} more: robot-health check)" if len(error.all) > 1 else ""
                self._log(Severity.ERROR, f"not reloaded, the old configuration stays in force: {error}{more}")
            except Exception as error:
                failed = True
                self._log(Severity.ERROR, printable(f"not reloaded: internal error: {type(error).__name__}: {error}"))
            finally:
                task.cancel()
        changes = [text for text in texts if text not in ("", NOTHING_CHANGED)]
        if changes:
            self._log(Severity.INFO, f"reloaded: {'; '.join(changes)}")
        elif NOTHING_CHANGED in texts and not failed:
            self._log(Severity.INFO, f"reloaded: {NOTHING_CHANGED}")
